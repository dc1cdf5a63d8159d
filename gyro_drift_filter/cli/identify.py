# Copyright 2026 gyro_drift_filter maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""`gyro_drift identify`: a parameter file from a motionless recording."""

import argparse
import math
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from gyro_drift_filter.cli.bag_options import add_bag_argument, add_topic_option
from gyro_drift_filter.cli.packages import needing
from gyro_drift_filter.cli.printing import tell
from gyro_drift_filter.cli.progress import Progress
from gyro_drift_filter.cli.result_files import add_json_option, check_targets, saying
from gyro_drift_filter.cli.time_options import add_time_options, between
from gyro_drift_filter.errors import printable
from gyro_drift_filter.whole_file import write_whole

if TYPE_CHECKING:
    from gyro_drift_filter.identify.identification import Identification


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Find the motionless spans of a recording, identify bias and noise of each '
        'axis, and write a parameter file that the node and replay read.'
    )
    add_bag_argument(command)
    command.add_argument('-o', '--output', type=Path, required=True, help='parameter file to write')
    add_json_option(command, 'all results')
    command.add_argument(
        '--plot',
        type=Path,
        metavar='FOLDER',
        help='draw recording, Allan deviation, autocorrelation and spectrum as PNG files',
    )
    command.add_argument(
        '--kalibr', type=Path, metavar='FILE', help='write the noise for Kalibr and OpenVINS, too'
    )
    add_topic_option(command)
    add_time_options(command)
    command.add_argument(
        '--sample-rate',
        type=_rate,
        metavar='HZ',
        help='for a recording whose stamps are zero; without it the log times of the bag count',
    )
    command.add_argument(
        '--order',
        type=_order,
        action='append',
        default=[],
        metavar='P,Q',
        help='fit ARMA(P, Q), too, up to 5,3; may be given several times',
    )
    command.add_argument(
        '--noise',
        choices=('likelihood', 'paper'),
        default='likelihood',
        help='how to find Q and R of kalman and sage_husa: likelihood takes the likeliest ones for '
        'the model of these filters, paper does what the paper does (default %(default)s)',
    )


def _rate(text: str) -> float:
    """Return a sample rate in Hz."""
    rate = math.nan
    with suppress(ValueError):
        rate = float(text)
    if not 0.1 <= rate <= 1e5:
        raise argparse.ArgumentTypeError(
            f'a sample rate lies between 0.1 and 100000 Hz, not {text}'
        )
    return rate


def _order(text: str) -> tuple[int, int]:
    """Return (p, q) of "p,q"."""
    with suppress(ValueError):
        p, q = (int(part) for part in text.split(','))
        if 0 <= p <= 5 and 0 <= q <= 3:
            return p, q
    raise argparse.ArgumentTypeError(f'an order is two numbers from 0,0 to 5,3, not {text}')


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    with needing('identification', 'scipy', 'statsmodels', 'allantools'):
        from gyro_drift_filter.calibrate.exchange import lacking, to_kalibr
        from gyro_drift_filter.cli.identification_report import noise_of, parameter_file, report
        from gyro_drift_filter.identify.identification import identify
        from gyro_drift_filter.identify.models import ORDERS
        from gyro_drift_filter.recordings.samples import read_samples
    if options.plot:
        with needing('--plot', 'matplotlib'):
            from gyro_drift_filter.cli.identification_figures import draw
    check_targets(
        {'-o': options.output, '--json': options.json, '--kalibr': options.kalibr},
        {'--plot': options.plot},
    )
    with Progress(enabled=True) as progress:
        samples = read_samples(
            options.bag, options.topic, between(options), progress, options.sample_rate
        )
    for note in samples.notes():
        tell(f'note: {note}')
    if options.sample_rate is not None and not samples.clock:
        tell('note: --sample-rate is not used, as the messages have stamps')
    result = identify(
        samples.stamps,
        samples.rates,
        samples.accelerations,
        log_times=samples.log_times,
        orders=tuple(dict.fromkeys((*ORDERS, *options.order))),
        paper=options.noise == 'paper',
    )
    source = printable(f'{options.bag.absolute().name}, topic {samples.topic}')
    warnings = (f'warning: {warning}' for warning in _warnings(result))
    with saying(report(result), options.json, result, warnings) as written:
        write_whole(options.output, parameter_file(result, source, options.noise))
        written.append(options.output)
        if options.kalibr:
            write_whole(options.kalibr, to_kalibr(noise_of(result), samples.topic))
            written.append(options.kalibr)
        if options.plot:
            written += draw(options.plot, result, samples.stamps, samples.rates)
    if options.kalibr and (text := lacking(noise_of(result))):
        tell(f'note: {text}')


def _warnings(result: 'Identification') -> list[str]:
    """Return what is doubtful about a result."""
    from gyro_drift_filter.core import Parameters
    from gyro_drift_filter.core.parameters import AXES
    from gyro_drift_filter.identify.identification import DeadAxis
    from gyro_drift_filter.messages.input_rules import IN_DEGREES, LARGEST_NOISE

    warnings, limit = list(result.warnings), Parameters().bias_max
    alive = {n: a for n, a in zip(AXES, result.axes, strict=True) if not isinstance(a, DeadAxis)}
    least = min(axis.deviation for axis in alive.values())
    if least > LARGEST_NOISE:
        warnings.append(
            f'the noise at rest is {least:.2g} rad/s or more on each axis: {IN_DEGREES}'
        )
        return warnings
    for name, axis in alive.items():
        if abs(axis.preprocessed.bias) > limit:
            warnings.append(
                f'the bias about {name}, {math.degrees(axis.preprocessed.bias):.3g} deg/s, is '
                f'beyond the default of bias.max, {math.degrees(limit):g} deg/s: the parameter '
                'file raises that, and without the file this bias is not subtracted'
            )
    return warnings
