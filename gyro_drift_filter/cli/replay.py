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

"""`gyro_drift replay`: filter a recorded bag."""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gyro_drift_filter.cli.bag_options import add_bag_argument
from gyro_drift_filter.cli.filter_options import (
    add_hint_option,
    add_method_option,
    add_params_option,
    chosen_parameters,
)
from gyro_drift_filter.cli.printing import in_colour, table, tell
from gyro_drift_filter.cli.progress import Progress, prepare_kernels
from gyro_drift_filter.cli.result_files import add_json_option, check_targets, saying, verdicts_of
from gyro_drift_filter.cli.time_options import add_time_options, between
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.errors import printable
from gyro_drift_filter.phrases import counted

if TYPE_CHECKING:
    from gyro_drift_filter.core import Filter
    from gyro_drift_filter.messages.summary import Summary
    from gyro_drift_filter.report.verdict import RunWatch, Verdict


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Filter the Imu topic of a bag, exactly as the live node would, and write a '
        "new bag with the input's topics and the filtered one beside them."
    )
    add_bag_argument(command)
    command.add_argument('-o', '--output', type=Path, required=True, help='folder to be made')
    add_params_option(command)
    imus = command.add_mutually_exclusive_group()
    imus.add_argument(
        '--topic',
        action='append',
        default=[],
        help='Imu topic, needed where the bag has several; given several times, each topic has a '
        'filter of its own',
    )
    imus.add_argument('--all-imu', action='store_true', help='filter all Imu topics')
    command.add_argument('--output-topic', metavar='NAME', help='what the filtered topic is called')
    command.add_argument(
        '--topics',
        nargs='*',
        metavar='TOPIC',
        help='copy only these topics of the input; without a TOPIC copy none of them',
    )
    add_time_options(command)
    add_method_option(command)
    command.add_argument(
        '--diagnostics',
        action='store_true',
        help='write innovation, Q, R, bias and outlier flags of every sample, too',
    )
    add_hint_option(command)
    command.add_argument(
        '--bias-memory',
        type=Path,
        metavar='FILE',
        help='start with the bias in this file, if the previous recording has left one, and write '
        'the bias at the end into it, as the node does from run to run',
    )
    add_json_option(command, 'the figures of the verdict')
    command.add_argument('--force', action='store_true', help='replace a bag at OUTPUT')
    command.add_argument(
        '--quiet', action='store_true', help='no progress and no verdict, but warnings'
    )


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    from gyro_drift_filter.bags.replay import replay
    from gyro_drift_filter.bags.replay_run import Watch
    from gyro_drift_filter.bags.selection import Selection

    start, end = between(options)
    check_targets(
        {'--json': options.json},
        others={'-o': options.output, '--bias-memory': options.bias_memory},
    )
    parameters = chosen_parameters(options)
    prepare_kernels(quiet=options.quiet)
    progress = Progress(enabled=not options.quiet)
    # A verdict that nobody sees is not made, as its sums take time.
    is_shown = not options.quiet or options.json is not None
    watches: dict[str, RunWatch] = {}

    def watched(topic: str, filter_: 'Filter') -> 'RunWatch':
        from gyro_drift_filter.report.verdict import RunWatch

        watches[topic] = RunWatch(filter_)
        return watches[topic]

    with progress:
        summaries = replay(
            options.bag,
            options.output,
            parameters=parameters,
            selection=Selection(
                imu_topics=tuple(options.topic),
                all_imu=options.all_imu,
                output_topic=options.output_topic,
                kept=None if options.topics is None else tuple(options.topics),
                start=start,
                end=end,
                hint=options.motion_hint,
            ),
            diagnostics=options.diagnostics,
            memory=options.bias_memory,
            force=options.force,
            watch=Watch(progress, watched) if is_shown else Watch(progress),
        )
    _tell_remarks(summaries)
    if not is_shown:
        return
    verdicts = [watches[summary.topic].verdict(summary) for summary in summaries]
    text = '' if options.quiet else '\n\n'.join(map(describe, verdicts))
    results = verdicts_of([(options.bag, verdicts)])
    with saying(text, options.json, results) as written:
        written.append(options.output)


def _tell_remarks(summaries: Sequence['Summary']) -> None:
    """Tell what is wrong with the input or the filter of each topic, and what was not copied."""
    for summary in summaries:
        of_topic = f'{printable(summary.topic)}: ' if len(summaries) > 1 else ''
        for status in summary.status:
            if status.level:
                tell(f'warning: {of_topic}{status.message}')
    for topic, reason in summaries[0].left_out.items():
        tell(f'note: left out {printable(topic)}: {reason}')


def describe(verdict: 'Verdict') -> str:
    """Return what a replay did and whether that helped, with the figures of each axis."""
    from gyro_drift_filter.report.wording import as_text

    passed_on = f' ({verdict.not_reported} of them unfiltered)' if verdict.not_reported else ''
    # As the doctor says of it.
    rate = (
        f'{1.0 / verdict.period:.4g} Hz' if verdict.received > 1 else 'too short to know the rate'
    )
    head = (
        f'{printable(verdict.topic)} -> {printable(verdict.output_topic)}: '
        f'{counted(verdict.received, "message")}, '
        f'{verdict.written} written{passed_on}, {rate}'
    )
    return f'{head}\n\n{as_text(verdict, in_colour)}\n\n{_table(verdict)}'


def _table(verdict: 'Verdict') -> str:
    """Return the figures of each axis: bias, and noise at rest."""
    bias, rests = verdict.bias, verdict.rests
    rows = [['deg/s', 'bias', '+-', 'std raw', verdict.method, 'ratio', 'outliers']]
    for axis, name in enumerate(AXES):
        if verdict.silent[axis]:
            cells = [verdict.silent[axis]] + 4 * ['-']
        else:
            known = bias.source != 'unknown'
            cells = [_degrees(bias.rates[axis]) if known else '-', _degrees(bias.deviations[axis])]
            cells += [
                _degrees(values[axis]) for values in (rests.raw_deviation, rests.filtered_deviation)
            ]
            cells.append(f'{rests.ratio[axis]:.3f}' if math.isfinite(rests.ratio[axis]) else '-')
        outliers = verdict.outliers
        rows.append([name, *cells, str(outliers.axes[axis]) if outliers.looked_for else '-'])
    return table(rows)


def _degrees(rate: float) -> str:
    """Return a rate in rad/s as text in deg/s."""
    return f'{math.degrees(rate):.4f}' if math.isfinite(rate) else '-'
