"""What `gyro_drift identify` prints and writes: tables, the parameter file, JSON."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.cli.table import table
from gyro_drift_filter.core.parameters import AXES

if TYPE_CHECKING:  # needs scipy and statsmodels, which only `identify` does
    from gyro_drift_filter.identify.allan import Reading
    from gyro_drift_filter.identify.identification import AxisModel, Identification
    from gyro_drift_filter.identify.models import DriftAndWhite

_CHOICE = (
    '* the smallest model whose AIC is no more than {:g} above that of the best. The filters take '
    'ARMA(1, 0).'
)
# Arrays as long as the recording are left out of the JSON.
_LONG = ('residuals', 'cleaned')


def report(result: 'Identification', material: float) -> str:
    """Return all tables of an identification.

    Args:
        result: To be shown.
        material: Difference in AIC that counts.
    """
    parts = [_head(result), _overview(result), _checks(result)]
    parts += [_models(name, axis) for name, axis in zip(AXES, result.axes, strict=True)]
    parts.append(_CHOICE.format(material))
    return '\n\n'.join(parts)


def _head(result: 'Identification') -> str:
    timing, quiet = result.timing, result.quiet
    spans = ', '.join(
        f'{begin:.1f} to {begin + len(span) * timing.period:.1f} s'
        for begin, span in zip(result.begins, quiet.spans, strict=True)
    )
    count = f'{len(quiet.spans)} span{"s" if len(quiet.spans) > 1 else ""}'
    sensors = 'gyroscope and accelerometer' if quiet.accelerometer else 'the gyroscope alone'
    lines = [
        f'rest: {result.seconds:.1f} s in {count}, by {sensors}: {spans}',
        f'time: {1.0 / timing.period:.4g} Hz, samples taken as evenly spaced',
    ]
    if timing.uneven > 0.01:
        lines[-1] += f', though {100 * timing.uneven:.0f} % of the stamps come in bursts or late'
    if cuts := len(timing.breaks):
        lines[-1] += f'; cut at {cuts} gap{"s" if cuts > 1 else ""}'
    if quiet.missing:
        lines.append(f'missing: {quiet.missing} samples are not finite')
    return '\n'.join(lines)


def _overview(result: 'Identification') -> str:
    degrees = math.degrees
    lines: tuple[tuple[str, Callable[[AxisModel], str]], ...] = (
        ('bias (deg/s)', lambda a: f'{degrees(a.preprocessed.bias):.4f}'),
        ('  standard error', lambda a: f'{degrees(a.preprocessed.bias_deviation):.4f}'),
        ('trend taken out, order', lambda a: str(a.preprocessed.trend_order)),
        ('outliers taken out', lambda a: str(a.preprocessed.outliers)),
        ('noise at rest (rad/s)', lambda a: f'{a.deviation:.6f}'),
        ('AR(1) plus white noise: phi', lambda a: _phi(a.description)),
        ('  95 % interval', lambda a: _interval(a.description.phi_interval, a.description, '.4f')),
        ('  drift (rad/s)', lambda a: _deviation(a.description.drift_variance, a.description)),
        (
            '  95 % interval',
            lambda a: _interval(_roots(a.description.drift_variance_interval), a.description),
        ),
        (
            '  white noise (rad/s)',
            lambda a: _deviation(a.description.white_variance, a.description),
        ),
        (
            '  95 % interval',
            lambda a: _interval(_roots(a.description.white_variance_interval), a.description),
        ),
        ('for the filters: phi', lambda a: f'{a.phi:.4f}'),
        ('  Q (rad/s)^2', lambda a: f'{a.noise.process_noise:.4g}'),
        ('  R (rad/s)^2', lambda a: f'{a.noise.measurement_noise:.4g}'),
        (
            'angle random walk (deg/sqrt(h))',
            lambda a: _read(a.allan.angle_random_walk, 60.0),
        ),
        ('  read at tau (s)', lambda a: _taus(a.allan.angle_random_walk)),
        ('bias instability (deg/h)', lambda a: _read(a.allan.bias_instability, 3600.0)),
        ('  read at tau (s)', lambda a: _taus(a.allan.bias_instability)),
        (
            'rate random walk (deg/h/sqrt(h))',
            lambda a: _read(a.allan.rate_random_walk, 3600.0 * 60.0),
        ),
        ('  read at tau (s)', lambda a: _taus(a.allan.rate_random_walk)),
    )
    rows = [['', *AXES]]
    rows += [[title, *(value(axis) for axis in result.axes)] for title, value in lines]
    return table(rows)


def _phi(description: 'DriftAndWhite') -> str:
    return f'{description.phi:.4f}' if description.identifiable else 'not identifiable'


def _deviation(variance: float, description: 'DriftAndWhite') -> str:
    return f'{math.sqrt(max(variance, 0.0)):.3g}' if description.identifiable else '-'


def _roots(interval: tuple[float, float]) -> tuple[float, float]:
    return math.sqrt(max(interval[0], 0.0)), math.sqrt(max(interval[1], 0.0))


def _interval(
    interval: tuple[float, float], description: 'DriftAndWhite', form: str = '.3g'
) -> str:
    # In as many digits as the estimate, so that it lies within as printed, too.
    return f'{interval[0]:{form}} to {interval[1]:{form}}' if description.identifiable else '-'


def _read(reading: 'Reading | None', factor: float) -> str:
    return '-' if reading is None else f'{factor * math.degrees(reading.value):.3g}'


def _taus(reading: 'Reading | None') -> str:
    if reading is None:
        return '-'
    if reading.shortest == reading.longest:
        return f'{reading.shortest:.2g}'
    return f'{reading.shortest:.2g} to {reading.longest:.2g}'


def _checks(result: 'Identification') -> str:
    lines = ['what the model assumes:']
    for name, axis in zip(AXES, result.axes, strict=True):
        for check in axis.checks:
            verdict = 'holds' if check.passed else 'FAILS'
            lines.append(f'  {name}  {check.name:<12}  {verdict}  {check.detail}')
    return '\n'.join(lines)


def _models(name: str, axis: 'AxisModel') -> str:
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


def _with_errors(values: NDArray[np.float64], deviations: NDArray[np.float64]) -> str:
    return ', '.join(f'{v:.4f}±{d:.4f}' for v, d in zip(values, deviations, strict=True)) or '-'


def parameter_file(result: 'Identification', source: str, noise: str) -> str:
    """Return the text of a ROS 2 parameter file.

    Args:
        result: To be written.
        source: Name of the recording, for a comment.
        noise: How Q and R were found, for a comment.
    """

    def row(values: Sequence[float]) -> str:
        # rcl takes a list of one type only, so every number has a point or an exponent.
        return '[' + ', '.join(f'{v:.9e}' for v in values) + ']'

    axes = result.axes
    day = datetime.now(UTC).strftime('%Y-%m-%d')
    name = ''.join(c if c.isprintable() else '?' for c in source)
    return f"""\
# Noise model of a gyroscope, for the node and `gyro_drift replay --params`. SI units; per axis
# x, y, z. Identified from {name}, {result.seconds:.0f} s of rest, on {day}.
gyro_drift_filter:
  ros__parameters:
    # Hz
    sample_rate: {1.0 / result.timing.period:.6f}
    bias:
      # At that time, rad/s. It holds until the first rest; standard error:
      # {row([axis.preprocessed.bias_deviation for axis in axes])}
      initial: {row([axis.preprocessed.bias for axis in axes])}
    model:
      # AR(1) coefficient of the drift
      phi: {row([axis.phi for axis in axes])}
      # Q and R of kalman and sage_husa, by {noise}, (rad/s)^2
      process_noise: {row([axis.noise.process_noise for axis in axes])}
      measurement_noise: {row([axis.noise.measurement_noise for axis in axes])}
      # Standard deviation of the noise at rest, for adaptive, rad/s
      noise_deviation: {row([axis.deviation for axis in axes])}
"""


def as_plain(value: Any) -> Any:
    """Return dataclasses and arrays as what JSON knows; what is as long as the data left out."""
    if dataclasses.is_dataclass(value):
        return {
            field.name: as_plain(getattr(value, field.name))
            for field in dataclasses.fields(value)
            if field.name not in _LONG
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
