"""`gyro_drift replay`: filter a recorded bag."""

import argparse
import sys
from pathlib import Path
from typing import Any

from gyro_drift_filter.accelerate.kernels import spare_linear_algebra
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.cli.progress import Progress
from gyro_drift_filter.cli.table import table
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.errors import printable


def add_parser(subcommands: Any) -> None:
    """Add the subcommand to the parser of `gyro_drift`."""
    command = subcommands.add_parser(
        'replay',
        help='filter a recorded bag',
        description='Filter the Imu topic of a bag, exactly as the live node would, and write a '
        "new bag with the input's topics and the filtered one beside them.",
    )
    command.add_argument('bag', type=Path, help='rosbag2 folder, or a bare .mcap or .db3 file')
    command.add_argument('-o', '--output', type=Path, required=True, help='folder to be made')
    command.add_argument('--params', type=Path, help='ROS 2 parameter file of the filter')
    command.add_argument('--topic', help='Imu topic, needed where the bag has several')
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
    command.add_argument('--force', action='store_true', help='replace a bag at OUTPUT')
    command.add_argument('--quiet', action='store_true', help='no progress, no table')
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    from gyro_drift_filter.bags.replay import replay

    spare_linear_algebra()
    parameters = read_parameters(options.params) if options.params else Parameters()
    if options.method:
        parameters = parameters.with_names({'method': options.method})
    if parameters.motion_hint != 'none' and options.motion_hint is None:
        print(
            f'warning: motion_hint is {parameters.motion_hint}, but no topic is named by '
            '--motion-hint: a node that hears such hints filters otherwise',
            file=sys.stderr,
        )
    progress = Progress(enabled=not options.quiet and sys.stderr.isatty())
    try:
        summary = replay(
            options.bag,
            options.output,
            parameters=parameters,
            topic=options.topic,
            diagnostics=options.diagnostics,
            hint=options.motion_hint,
            force=options.force,
            progress=progress,
        )
    finally:
        progress.finish()
    for status in summary.status:
        if status.level:
            print(f'warning: {status.message}', file=sys.stderr)
    for topic, reason in summary.left_out.items():
        print(f'note: left out {printable(topic)}: {reason}', file=sys.stderr)
    if not options.quiet:
        print(describe(summary, parameters.method))
        print(f'wrote {options.output}')


def describe(summary: Any, method: str) -> str:
    """Return the table of a replay: mean and standard deviation per axis, raw and filtered."""
    rows = [['rad/s', 'mean raw', method, 'std raw', method, 'ratio', 'outliers']]
    for i, axis in enumerate(AXES):
        raw, filtered = summary.raw, summary.filtered
        ratio = filtered.deviation[i] / raw.deviation[i] if raw.deviation[i] > 0 else float('nan')
        rows.append(
            [
                axis,
                f'{raw.mean[i]:.6f}',
                f'{filtered.mean[i]:.6f}',
                f'{raw.deviation[i]:.6f}',
                f'{filtered.deviation[i]:.6f}',
                f'{ratio:.3f}',
                str(summary.outliers[i]),
            ]
        )
    passed_on = f' ({summary.not_reported} of them unfiltered)' if summary.not_reported else ''
    head = (
        f'{printable(summary.topic)} -> {printable(summary.output_topic)}: '
        f'{summary.received} messages, '
        f'{summary.written} written{passed_on}, {1.0 / summary.period:.4g} Hz'
    )
    return f'{head}\n{table(rows)}'
