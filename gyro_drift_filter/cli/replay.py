"""`gyro_drift replay`: filter a recorded bag."""

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gyro_drift_filter.accelerate.kernels import spare_linear_algebra
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.cli.printing import is_terminal, say, tell
from gyro_drift_filter.cli.progress import Progress, compile_first
from gyro_drift_filter.cli.table import table
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.errors import GyroDriftFilterError, printable

if TYPE_CHECKING:
    from gyro_drift_filter.bags.replay_run import Summary


def add_parser(subcommands: Any) -> None:
    """Add the subcommand to the parser of `gyro_drift`."""
    command = subcommands.add_parser(
        'replay',
        help='filter a recorded bag',
        description='Filter the Imu topic of a bag, exactly as the live node would, and write a '
        "new bag with the input's topics and the filtered one beside them.",
    )
    command.add_argument(
        'bag', type=Path, help='rosbag2 folder, a bare .mcap or .db3 file, or a .bag file of ROS 1'
    )
    command.add_argument('-o', '--output', type=Path, required=True, help='folder to be made')
    command.add_argument('--params', type=Path, help='ROS 2 parameter file of the filter')
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
        help='copy these topics alone; none: write what the filter makes, and nothing else',
    )
    command.add_argument(
        '--start', type=float, default=0.0, help='s from the begin of the recording on'
    )
    command.add_argument(
        '--end', type=float, default=math.inf, help='s from the begin of the recording on'
    )
    command.add_argument('--method', choices=METHOD_NAMES, help='overrides the parameter file')
    command.add_argument(
        '--diagnostics',
        action='store_true',
        help='write innovation, Q, R, bias and outlier flags of every sample, too',
    )
    command.add_argument(
        '--motion-hint',
        metavar='TOPIC',
        help='Twist, TwistStamped or Odometry topic that tells whether the robot moves',
    )
    command.add_argument(
        '--bias-memory',
        type=Path,
        metavar='FILE',
        help='start with the bias that the recording before has left in this file, as a node does '
        'with its own, and write it for the next one',
    )
    command.add_argument('--force', action='store_true', help='replace a bag at OUTPUT')
    command.add_argument(
        '--quiet', action='store_true', help='no progress, no table; warnings are told'
    )
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    from gyro_drift_filter.bags.replay import replay
    from gyro_drift_filter.bags.selection import Selection

    spare_linear_algebra()
    if not options.start < options.end:
        raise GyroDriftFilterError(f'--start {options.start:g} is not before --end {options.end:g}')
    parameters = read_parameters(options.params) if options.params else Parameters()
    if options.method:
        parameters = parameters.with_names({'method': options.method})
    if parameters.motion_hint != 'none' and options.motion_hint is None:
        tell(
            f'warning: motion_hint is {parameters.motion_hint}, but no topic is named by '
            '--motion-hint: a node that hears such hints filters otherwise'
        )
    if not options.quiet:
        compile_first()
    progress = Progress(enabled=not options.quiet and is_terminal())
    try:
        summaries = replay(
            options.bag,
            options.output,
            parameters=parameters,
            selection=Selection(
                imu_topics=tuple(options.topic),
                all_imu=options.all_imu,
                output_topic=options.output_topic,
                kept=None if options.topics is None else tuple(options.topics),
                start=options.start,
                end=options.end,
                hint=options.motion_hint,
            ),
            diagnostics=options.diagnostics,
            memory=options.bias_memory,
            force=options.force,
            progress=progress,
        )
    finally:
        progress.finish()
    for summary in summaries:
        of_topic = f'{printable(summary.topic)}: ' if len(summaries) > 1 else ''
        for status in summary.status:
            if status.level:
                tell(f'warning: {of_topic}{status.message}')
    for topic, reason in summaries[0].left_out.items():
        tell(f'note: left out {printable(topic)}: {reason}')
    if not options.quiet:
        tables = [describe(summary, parameters) for summary in summaries]
        say('\n\n'.join(tables) + f'\nwrote {options.output}')


def describe(summary: 'Summary', parameters: Parameters) -> str:
    """Return what a replay did: the bias, and mean and deviation of each axis at rest."""
    passed_on = f' ({summary.not_reported} of them unfiltered)' if summary.not_reported else ''
    head = (
        f'{printable(summary.topic)} -> {printable(summary.output_topic)}: '
        f'{summary.received} messages, '
        f'{summary.written} written{passed_on}, {1.0 / summary.period:.4g} Hz'
    )
    resting = summary.rest_raw.count > 0
    raw, filtered = summary.raw, summary.filtered
    if resting:
        raw, filtered = summary.rest_raw, summary.rest_filtered
    method = parameters.method
    rows = [['deg/s', 'bias', 'mean raw', method, 'std raw', method, 'ratio', 'outliers']]
    for axis, name in enumerate(AXES):
        cells = [_dead(summary, axis)] + 5 * ['-']
        if not cells[0]:
            cells = ['-' if summary.bias_known is None else _degrees(summary.bias[axis])]
            for before, after in ((raw.mean, filtered.mean), (raw.deviation, filtered.deviation)):
                cells += [_degrees(before[axis]), _degrees(after[axis])]
            before, after = raw.deviation[axis], filtered.deviation[axis]
            cells.append(f'{after / before:.3f}' if before > 0.0 else '-')
        rows.append([name, *cells, str(summary.outliers[axis])])
    return f'{head}\n{_about_bias(summary, parameters)}\n{table(rows)}'


def _dead(summary: 'Summary', axis: int) -> str:
    """Return in words why an axis has no figures; empty where it has."""
    if summary.raw.count == 0:
        if summary.unusable[axis] > 0:
            return 'no usable rate'
        return 'not reported' if summary.not_reported else '-'
    if summary.raw.count > 1 and summary.raw.deviation[axis] == 0.0:
        return f'dead, always {_degrees(summary.raw.mean[axis])}'
    return ''


def _about_bias(summary: 'Summary', parameters: Parameters) -> str:
    """Return when the bias was known, and what mean and deviation are those of."""
    if summary.raw.count == 0:
        return 'no figures: no message had a usable rate on all axes'
    known = 'no bias known: the sensor never stood still for some three seconds'
    if summary.bias_known is not None:
        known = f'bias known after {summary.bias_known:.1f} s'
    if not parameters.bias_enabled:
        known += ', left in, as bias.enabled is false'
    rest = summary.rest_raw.count
    over = f'the {rest} messages at rest since then' if rest else 'all messages, with motion'
    return f'{known}; mean and std of {over}'


def _degrees(rate: float) -> str:
    """Return a rate in rad/s as text in deg/s."""
    return f'{math.degrees(rate):.4f}'
