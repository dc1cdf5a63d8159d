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

"""`gyro_drift tune`: a parameter file with the settings worth changing for one robot."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.cli.bag_options import add_bag_argument, add_topic_option
from gyro_drift_filter.cli.filter_options import add_params_option, chosen_parameters
from gyro_drift_filter.cli.packages import needing
from gyro_drift_filter.cli.parameter_text import parameter_text, today
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.cli.progress import Progress, prepare_kernels
from gyro_drift_filter.cli.result_files import add_json_option, check_targets, saying
from gyro_drift_filter.cli.time_options import add_time_options, between
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.errors import GyroDriftFilterError, printable
from gyro_drift_filter.phrases import counted
from gyro_drift_filter.tune.ranges import RANGES
from gyro_drift_filter.whole_file import write_whole

if TYPE_CHECKING:
    from gyro_drift_filter.tune.tuning import Tuning


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Search for the parameters with which the filter predicts a recording best, '
        'judge them on stretches held back, and write a parameter file that the node and replay '
        'read. Where the default is as good, it is kept.'
    )
    add_bag_argument(command)
    command.add_argument('-o', '--output', type=Path, required=True, help='parameter file to write')
    add_json_option(command, 'all results')
    add_params_option(command, 'to start from; what is not tuned stays')
    command.add_argument(
        '--method',
        choices=tuple(RANGES),
        help='method to tune; without it that of --params, or adaptive',
    )
    command.add_argument(
        '--truth',
        nargs='?',
        const='',
        metavar='SOURCE',
        help='tune by the error itself: the truth is in an .npz file, as simulate writes it, or '
        'on another Imu topic of the bag; without a SOURCE it is the file that simulate has '
        'written beside the bag',
    )
    add_topic_option(command)
    add_time_options(command)
    command.add_argument(
        '--seconds', type=float, default=300.0, help='time limit in s, default %(default)g'
    )
    command.add_argument(
        '--seed', type=int, default=0, help='of the random numbers, default %(default)s'
    )
    command.add_argument('--quiet', action='store_true', help='no progress, no table')


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    if not options.seconds > 0.0:
        raise GyroDriftFilterError(f'--seconds must be greater than 0, not {options.seconds:g}')
    if options.seed < 0:
        raise GyroDriftFilterError(f'--seed must not be negative, not {options.seed}')
    check_targets({'-o': options.output, '--json': options.json})
    with needing('tuning', 'scipy'):
        from gyro_drift_filter.tune.objective import Material
        from gyro_drift_filter.tune.tuning import tune
    from gyro_drift_filter.identify.series import stacked
    from gyro_drift_filter.recordings.samples import read_samples

    parameters = chosen_parameters(options)
    prepare_kernels(quiet=options.quiet)
    with Progress(enabled=not options.quiet) as progress:
        samples = read_samples(options.bag, options.topic, between(options), progress)
    for note in samples.notes():
        tell(f'note: {note}')
    _warn_of_units(options, samples.topic)
    stamps = np.asarray(samples.stamps)
    material = Material(
        stamps,
        stacked(samples.rates),
        stacked(samples.accelerations),
        None if options.truth is None else _truth(options, samples.topic, stamps),
    )
    with Progress(enabled=not options.quiet, unit='runs of the filter') as progress:
        tuning = tune(
            material, parameters, seconds=options.seconds, seed=options.seed, on_evaluation=progress
        )
    source = printable(f'{options.bag.absolute().name}, topic {samples.topic}')
    text = '' if options.quiet else report(tuning, by_truth=options.truth is not None)
    with saying(text, options.json, tuning) as written:
        write_whole(options.output, parameter_file(tuning, source))
        written.append(options.output)


def _warn_of_units(options: argparse.Namespace, topic: str) -> None:
    """Tell what the doctor says of the units of a topic, which no setting makes up for."""
    from gyro_drift_filter.doctor.examination import OF_UNITS, examine
    from gyro_drift_filter.recordings.examined import read_recording

    with Progress(enabled=not options.quiet) as progress:
        _, examined = read_recording(options.bag, topic, between(options), progress)
    for finding in examine(examined):
        if finding.is_fault and finding.name in OF_UNITS:
            tell(f'warning: {finding.text}: {finding.advice}')


def _truth(options: argparse.Namespace, topic: str, stamps: Integers) -> Floats:
    """Return the true rates (n, 3) at these stamps of a topic, NaN where they are not known.

    Raises:
        GyroDriftFilterError: There are none.
    """
    from gyro_drift_filter.bags.imu_arrays import read_imu_arrays, usable
    from gyro_drift_filter.bags.topics import absolute_name
    from gyro_drift_filter.simulation.bag import read_truth, truth_path

    source = options.truth
    path = Path(source) if source else truth_path(options.bag.absolute())
    if source and path.suffix != '.npz':
        if absolute_name(source) == absolute_name(topic):
            raise GyroDriftFilterError(
                f'--truth {source} is the topic that is tuned: name the one that holds the truth'
            )
        imu = read_imu_arrays(options.bag, source)
        times, rates = imu.stamps, usable(imu.angular_velocity)
    else:
        times, rates = read_truth(path)
    order = np.argsort(times, kind='stable')
    origin = stamps[0]
    out = np.column_stack(
        [
            np.interp(stamps - origin, (times - origin)[order], column[order], np.nan, np.nan)
            for column in rates.T
        ]
    )
    known = np.isfinite(out).all(axis=1)
    if not known.any():
        raise GyroDriftFilterError('the truth is of another time than the samples')
    if not known.all():
        # What measures the truth often begins later, or loses sight of the body.
        first, last = 1e-9 * (stamps[known][[0, -1]] - origin)
        tell(
            f'warning: the truth is known at {known.sum()} of {len(known)} samples, from '
            f'{first:.3f} to {last:.3f} s, and only these are judged: is it the truth of this '
            'recording?'
        )
    return out


def report(tuning: 'Tuning', *, by_truth: bool) -> str:
    """Return what was found, in words and as a table."""
    rows = [['', 'before', 'now', 'as good from', 'to', 'loss at worst (nats)']]
    for one in tuning.sensitivities:
        looked = one.low is not None and one.high is not None and one.loss is not None
        rows.append(
            [
                one.name,
                _shown(one.before),
                _shown(one.chosen),
                *((f'{one.low:g}', f'{one.high:g}', f'{one.loss:.4f}') if looked else 3 * ('-',)),
            ]
        )
    advice = _advice(tuning, by_truth=by_truth)
    lines = [advice, '', table(rows), '', f'{counted(tuning.evaluations, "run")} of the filter']
    if tuning.out_of_time:
        lines.append('The time limit has cut it short: --seconds gives it more.')
    return '\n'.join(lines)


def _advice(tuning: 'Tuning', *, by_truth: bool) -> str:
    """Return which settings are worth changing, if any are, and why."""
    from gyro_drift_filter.tune.tuning import LEAST_GAIN

    gain = tuning.gain
    if tuning.chosen != tuning.before:
        names = [one.name for one in tuning.sensitivities if one.chosen != one.before]
        worth = f'Worth changing: {", ".join(names)}. On the stretches held back'
        if by_truth:
            return (
                f'{worth} the error falls from {tuning.cost_before:.6f} to '
                f'{tuning.cost_best:.6f} rad/s.'
            )
        return (
            f'{worth} they predict the samples better, by {gain.mean:.3f} +- '
            f'{gain.deviation:.3f} nats a sample.'
        )
    if tuning.evaluations == 1:
        return 'Nothing was tried: the time limit was up after the first run, so the settings stay.'
    least = f'{100.0 * LEAST_GAIN:g} %'
    if tuning.best == tuning.before:
        return (
            f'Keep the settings: no change that was tried gains as much as {least} on the '
            'stretches of the search.'
        )
    percent = f'{100.0 * gain.mean:.2f} +- {100.0 * gain.deviation:.2f} %'
    return (
        'Keep the settings: on the stretches held back, the best that was found gains '
        f'{percent}: that may be by chance, or is below {least}.'
    )


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        values = [f'{v:g}' for v in value]
        return values[0] if len(set(values)) == 1 else ' '.join(values)
    return f'{value:g}'


def parameter_file(tuning: 'Tuning', source: str) -> str:
    """Return the text of a ROS 2 parameter file: what was tuned, and what differs from defaults."""
    remarks = {one.name: [_remark(one)] for one in tuning.sensitivities}
    default = Parameters().names()
    head = [
        'Settings of the filter, for the node and `gyro_drift replay --params`.',
        'SI units; per axis x, y, z.',
        f'Tuned on {source}, on {today()}.',
    ]
    values = {
        name: value
        for name, value in tuning.chosen.names().items()
        if name == 'method' or name in remarks or value != default[name]
    }
    return parameter_text(head, values, remarks)


def _remark(one: Any) -> str:
    kept = 'kept' if one.chosen == one.before else f'was {_shown(one.before)}'
    if one.loss is None:
        return kept
    return f'{kept}; as good from {one.low:g} to {one.high:g}, at worst {one.loss:.4f} nats lost'
