"""`gyro_drift identify`: a parameter file from a motionless recording."""

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from gyro_drift_filter.cli.progress import Progress
from gyro_drift_filter.cli.table import table
from gyro_drift_filter.core import GyroDriftFilterError
from gyro_drift_filter.core.parameters import AXES

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
    command.add_argument('--topic', help='Imu topic, needed where the bag has several')
    command.add_argument('--start', type=float, default=0.0, help='s from the first sample on')
    command.add_argument('--end', type=float, help='s from the first sample on')
    command.add_argument(
        '--noise',
        choices=('likelihood', 'paper'),
        default='likelihood',
        help="Q and R of the filters: likeliest for the filter's own model, or as the paper takes "
        'them (default %(default)s)',
    )
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    from gyro_drift_filter.bags.imu_arrays import read_imu_arrays

    try:
        from gyro_drift_filter.identify.identification import identify
    except ImportError as error:
        raise GyroDriftFilterError(_NEEDED.format(error)) from error
    for path in (options.output, options.json):
        if path is not None and path.exists():
            raise GyroDriftFilterError(f'{path} exists already: remove it or choose another name')
    progress = Progress(enabled=sys.stderr.isatty())
    try:
        data = read_imu_arrays(options.bag, options.topic, progress)
    finally:
        progress.finish()
    seconds = (data.stamps - data.stamps[0]) * 1e-9
    end = seconds[-1] if options.end is None else options.end
    chosen = (seconds >= options.start) & (seconds <= end)
    if not chosen.any():
        raise GyroDriftFilterError(
            f'no sample between --start {options.start:g} and --end {end:g} s: the recording has '
            f'{seconds[-1]:.1f} s'
        )
    result = identify(
        data.stamps[chosen],
        data.angular_velocity[chosen],
        data.linear_acceleration[chosen],
        paper=options.noise == 'paper',
    )
    print(describe(result))
    for warning in result.warnings:
        print(f'warning: {warning}', file=sys.stderr)
    options.output.write_text(parameter_file(result, options.bag, data.topic, options.noise))
    if options.json is not None:
        options.json.write_text(json.dumps(as_plain(result), indent=1) + '\n')
    print(f'wrote {options.output}' + (f' and {options.json}' if options.json else ''))


def describe(result: Any) -> str:
    """Return the tables of an identification."""
    spans = ', '.join(
        f'{begin:.1f} to {begin + (span.stop - span.first) / result.sample_rate:.1f} s'
        for begin, span in zip(result.begins, result.quiet.spans, strict=True)
    )
    head = (
        f'{result.sample_rate:.4g} Hz; {result.seconds:.1f} s of rest in '
        f'{len(result.quiet.spans)} spans: {spans}'
    )
    degrees = np.degrees
    lines: tuple[tuple[str, Callable[[Any], str]], ...] = (
        ('bias (deg/s)', lambda a: f'{degrees(a.preprocessed.bias):.4f}'),
        ('  standard error', lambda a: f'{degrees(a.preprocessed.bias_deviation):.4f}'),
        ('trend order', lambda a: str(a.preprocessed.trend_order)),
        ('outliers', lambda a: str(a.preprocessed.outliers)),
        ('noise at rest (rad/s)', lambda a: f'{a.deviation:.6f}'),
        ('AR(1) phi', lambda a: f'{a.phi:.4f}'),
        ('Q for the filters', lambda a: f'{a.noise.process_noise:.4g}'),
        ('R for the filters', lambda a: f'{a.noise.measurement_noise:.4g}'),
        ('model chosen', lambda a: 'ARMA({}, {})'.format(*a.chosen.order)),
        ('angle random walk (deg/sqrt(h))', _angle_random_walk),
        ('bias instability (deg/h)', _bias_instability),
    )
    rows = [['', *AXES]]
    rows += [[title, *(value(axis) for axis in result.axes)] for title, value in lines]
    parts = [head, table(rows)]
    for name, axis in zip(AXES, result.axes, strict=True):
        parts.append(_models(name, axis))
    return '\n\n'.join(parts)


def _angle_random_walk(axis: Any) -> str:
    reading = axis.allan.angle_random_walk
    return '-' if reading is None else f'{60 * np.degrees(reading.value):.3f}'


def _bias_instability(axis: Any) -> str:
    return f'{3600 * np.degrees(axis.allan.bias_instability.value):.1f}'


def _models(name: str, axis: Any) -> str:
    rows = [[f'axis {name}', 'phi', 'theta', 'AIC', 'BIC', 'Ljung-Box p']]
    for fitted in axis.fits:
        mark = ' *' if fitted is axis.chosen else ''
        rows.append(
            [
                'ARMA({}, {}){}'.format(*fitted.order, mark),
                _with_errors(fitted.phi, fitted.phi_deviation),
                _with_errors(fitted.theta, fitted.theta_deviation),
                f'{fitted.aic:.1f}',
                f'{fitted.bic:.1f}',
                f'{fitted.ljung_box:.2g}',
            ]
        )
    return table(rows)


def _with_errors(values: Any, deviations: Any) -> str:
    return ', '.join(f'{v:.4f}±{d:.4f}' for v, d in zip(values, deviations, strict=True)) or '-'


def parameter_file(result: Any, source: Path, topic: str, noise: str) -> str:
    """Return the text of a ROS 2 parameter file."""

    def row(values: list[float]) -> str:
        # rcl takes a list of one type only, so every number has a point or an exponent.
        return '[' + ', '.join(f'{v:.9e}' for v in values) + ']'

    bias = row([axis.preprocessed.bias for axis in result.axes])
    day = datetime.now(UTC).strftime('%Y-%m-%d')
    name = ''.join(c if c.isprintable() else '?' for c in f'{source.name}, topic {topic}')
    return f"""\
# Noise model of a gyroscope, for the node and `gyro_drift replay --params`. SI units.
# Identified from {name}, {result.seconds:.0f} s of rest, on {day}.
# Bias at that time (rad/s): {bias}
gyro_drift_filter:
  ros__parameters:
    # Hz
    sample_rate: {result.sample_rate:.6f}
    model:
      # AR(1) coefficient of the drift per axis x, y, z
      phi: {row([axis.phi for axis in result.axes])}
      # Q and R of kalman and sage_husa, by {noise}, (rad/s)^2
      process_noise: {row([axis.noise.process_noise for axis in result.axes])}
      measurement_noise: {row([axis.noise.measurement_noise for axis in result.axes])}
      # Noise at rest, for adaptive, rad/s
      noise_deviation: {row([axis.deviation for axis in result.axes])}
"""


def as_plain(value: Any) -> Any:
    """Return dataclasses and arrays as what JSON knows; the residuals, being the data, left out."""
    if dataclasses.is_dataclass(value):
        return {
            field.name: as_plain(getattr(value, field.name))
            for field in dataclasses.fields(value)
            if field.name not in ('residuals', 'cleaned')
        }
    if isinstance(value, (list, tuple)):
        return [as_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return as_plain(value.tolist())
    if isinstance(value, np.generic):
        return as_plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
