"""`gyro_drift identify`: a parameter file from a motionless recording."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from gyro_drift_filter.cli.progress import Progress
from gyro_drift_filter.core import GyroDriftFilterError
from gyro_drift_filter.errors import printable

_NEEDED = (
    'identification needs the Python packages scipy, statsmodels and allantools ({}): install them '
    "with 'pip install scipy statsmodels allantools'"
)


def add_parser(subcommands: Any) -> None:
    """Add the subcommand to the parser of `gyro_drift`."""
    command = subcommands.add_parser(
        'identify',
        help='find the noise model of a gyroscope from a motionless recording',
        description='Find the motionless spans of a recording, identify bias and noise of each '
        'axis, and write a parameter file that the node and replay read.',
    )
    command.add_argument('bag', type=Path, help='rosbag2 folder, or a bare .mcap or .db3 file')
    command.add_argument('-o', '--output', type=Path, required=True, help='parameter file to write')
    command.add_argument('--json', type=Path, help='write all results, for programs')
    command.add_argument(
        '--plot',
        type=Path,
        metavar='FOLDER',
        help='draw recording, Allan deviation, autocorrelation and spectrum as PNG files',
    )
    command.add_argument('--topic', help='Imu topic, needed where the bag has several')
    command.add_argument('--start', type=float, default=0.0, help='s from the first sample on')
    command.add_argument('--end', type=float, help='s from the first sample on')
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
        help="Q and R of the filters: likeliest for the filter's own model, or as the paper takes "
        'them (default %(default)s)',
    )
    command.set_defaults(run=run)


def _order(text: str) -> tuple[int, int]:
    """Return (p, q) of "p,q"."""
    p, q = (int(part) for part in text.split(','))
    if not (0 <= p <= 5 and 0 <= q <= 3):
        raise argparse.ArgumentTypeError(f'orders go from 0,0 to 5,3, not {text}')
    return p, q


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    from gyro_drift_filter.bags.imu_arrays import read_imu_arrays

    try:
        from gyro_drift_filter.cli.identification_report import as_plain, parameter_file, report
        from gyro_drift_filter.identify.identification import identify
        from gyro_drift_filter.identify.models import MATERIAL, ORDERS
    except ImportError as error:
        raise GyroDriftFilterError(_NEEDED.format(error)) from error
    if options.plot:
        try:
            from gyro_drift_filter.cli.identification_figures import draw
        except ImportError as error:
            raise GyroDriftFilterError(
                f"--plot needs the Python package matplotlib ({error}): install it with 'pip "
                "install matplotlib'"
            ) from error
    for path in (options.output, options.json):
        if path is not None and path.exists():
            raise GyroDriftFilterError(f'{path} exists already: remove it or choose another name')
    progress = Progress(enabled=sys.stderr.isatty())
    try:
        data = read_imu_arrays(options.bag, options.topic, progress)
    finally:
        progress.finish()
    seconds = (data.stamps - data.stamps[0]) * 1e-9
    end = seconds.max() if options.end is None else options.end
    chosen = (seconds >= options.start) & (seconds <= end)
    if not chosen.any():
        raise GyroDriftFilterError(
            f'no sample between --start {options.start:g} and --end {end:g} s: the recording has '
            f'{seconds.max():.1f} s'
        )
    stamps, rates = data.stamps[chosen], data.angular_velocity[chosen]
    result = identify(
        stamps,
        rates,
        data.linear_acceleration[chosen],
        orders=tuple(dict.fromkeys((*ORDERS, *options.order))),
        paper=options.noise == 'paper',
    )
    print(report(result, MATERIAL))
    for warning in result.warnings:
        print(f'warning: {warning}', file=sys.stderr)
    if data.refused:
        print(
            f'note: {data.refused} messages left out, which are damaged or report no angular '
            'velocity',
            file=sys.stderr,
        )
    source = printable(f'{options.bag.absolute().name}, topic {data.topic}')
    options.output.write_text(parameter_file(result, source, options.noise))
    written = [options.output]
    if options.json:
        options.json.write_text(json.dumps(as_plain(result), indent=1) + '\n')
        written.append(options.json)
    if options.plot:
        written += draw(options.plot, result, stamps, rates)
    print('\nwrote ' + '\n      '.join(map(str, written)))
