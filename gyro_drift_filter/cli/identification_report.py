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

"""What `gyro_drift identify` prints and writes: tables and the parameter file."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.calibrate.exchange import Noise
from gyro_drift_filter.cli.parameter_text import as_yaml, bias_parameters, parameter_text, today
from gyro_drift_filter.cli.printing import table
from gyro_drift_filter.core.parameters import AXES, Parameters
from gyro_drift_filter.identify.allan import Coefficient
from gyro_drift_filter.identify.identification import AxisModel, DeadAxis, Identification
from gyro_drift_filter.identify.models import MATERIAL
from gyro_drift_filter.phrases import counted, named_axes, plain

_CHOICE = (
    f'* the smallest model whose AIC is no more than {MATERIAL:g} above that of the best. The '
    'methods kalman and sage_husa take ARMA(1, 0).'
)
_SPANS = 6  # of rest that are listed: a day may have hundreds


def report(result: Identification) -> str:
    """Return all tables of an identification."""
    models = (_models(name, axis) for name, axis in _alive(result))
    return '\n\n'.join([_head(result), _overview(result), _checks(result), *models, _CHOICE])


def _alive(result: Identification) -> list[tuple[str, AxisModel]]:
    """Return names and models of the axes that measure."""
    return [
        (name, axis)
        for name, axis in zip(AXES, result.axes, strict=True)
        if not isinstance(axis, DeadAxis)
    ]


def _head(result: Identification) -> str:
    timing, quiet = result.timing, result.quiet
    listed = _times(result)
    spans = ', '.join(listed[:_SPANS])
    if len(listed) > _SPANS:
        spans += f' and {len(listed) - _SPANS} more'
    sensors = 'gyroscope and accelerometer' if quiet.accelerometer else 'the gyroscope alone'
    lines = [
        f'rest: {result.seconds:.1f} s in {counted(len(quiet.spans), "span")}, by {sensors}: '
        f'{spans}',
        f'time: {1.0 / timing.period:.4g} Hz, samples taken as evenly spaced',
    ]
    if timing.uneven > 0.01:
        lines[-1] += f', though {100 * timing.uneven:.0f} % of the stamps come in bursts or late'
    settings = int(np.count_nonzero(timing.set_back))
    cuts = (len(timing.breaks) - settings, 'gap'), (settings, 'setting')
    if listed_cuts := ' and '.join(counted(number, what) for number, what in cuts if number):
        lines[-1] += f'; cut at {listed_cuts}{" of the clock" if settings else ""}'
    if _bias_moves(result):
        lines.insert(1, f'bias: {_of_bias(result)}')
    if others := quiet.other_rates:
        seconds = sum(len(other.span) for other in others) * timing.period
        lines.insert(
            1, f'left out: {seconds:.1f} s in {counted(len(others), "span")} at other rates'
        )
    if quiet.missing:
        lines.append(f'missing: {quiet.missing} samples are not finite')
    return '\n'.join(lines)


def _times(result: Identification) -> list[str]:
    """Return the times of the rests in s from the first sample."""
    return [
        f'{begin:.1f} to {end:.1f} s' for begin, end in zip(result.begins, result.ends, strict=True)
    ]


def _bias_moves(result: Identification) -> list[str]:
    """Return the names of the axes whose bias differs from rest to rest."""
    return [name for name, axis in _alive(result) if axis.preprocessed.bias_moves]


def _of_bias(result: Identification) -> str:
    """Return what the bias is the mean of."""
    moving, spans = _bias_moves(result), result.quiet.spans
    if not moving:
        return 'the mean over all rests'
    longest = _times(result)[spans.index(max(spans, key=len))]
    return f'the mean of the longest rest, {longest}, as it moves about {named_axes(moving)}'


def _overview(result: Identification) -> str:
    degrees = math.degrees
    alive = _alive(result)
    lines: tuple[tuple[str, Callable[[AxisModel], str]], ...] = (
        ('bias (deg/s)', lambda a: f'{degrees(a.preprocessed.bias):.4f}'),
        ('  standard error', lambda a: f'{degrees(a.preprocessed.bias_deviation):.4f}'),
        ('trend taken out, order', lambda a: str(a.preprocessed.trend_order)),
        ('outliers taken out', lambda a: str(a.preprocessed.outliers)),
        ('noise at rest (deg/s)', lambda a: f'{degrees(a.deviation):.4f}'),
        ('of kalman and sage_husa: phi', lambda a: f'{a.phi:.4f}'),
        ('  root of Q (deg/s)', lambda a: _root(a.noise.process_noise)),
        ('  root of R (deg/s)', lambda a: _root(a.noise.measurement_noise)),
        ('angle random walk (deg/sqrt(h))', lambda a: _read(a.allan.angle_random_walk, 60.0)),
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
    for number, (title, value) in enumerate(lines):
        dead = '-' if number else 'dead'
        cells = (dead if isinstance(axis, DeadAxis) else value(axis) for axis in result.axes)
        rows.append([title, *cells])
    identifiable = [(name, axis) for name, axis in alive if axis.description.identifiable]
    text = table(rows)
    if identifiable:
        text += '\n\n' + _drift_and_white(identifiable)
    if hidden := [name for name, axis in alive if not axis.description.identifiable]:
        text += f'\n\nAR(1) plus white noise: not identifiable on {named_axes(hidden)}'
    return text


def _drift_and_white(axes: Sequence[tuple[str, AxisModel]]) -> str:
    """Return the table of AR(1) plus white noise; intervals have as many digits as estimates."""
    rows = [['AR(1) plus white noise, with 95 % intervals', *(name for name, _ in axes)]]
    found = [axis.description for _, axis in axes]
    rows.append(['phi', *(f'{d.phi:.4f}' for d in found)])
    rows.append(['', *('{:.4f} to {:.4f}'.format(*d.phi_interval) for d in found)])
    for title, estimates in (
        ('drift (deg/s)', [(d.drift_variance, d.drift_variance_interval) for d in found]),
        ('white noise (deg/s)', [(d.white_variance, d.white_variance_interval) for d in found]),
    ):
        rows.append([title, *(_root(variance) for variance, _ in estimates)])
        rows.append(['', *(' to '.join(map(_root, interval)) for _, interval in estimates)])
    return table(rows)


def _root(variance: float) -> str:
    """Return the deviation in deg/s of a variance in (rad/s)^2; none is left of a negative one."""
    return f'{math.degrees(math.sqrt(max(variance, 0.0))):.3g}'


def _read(reading: Coefficient | None, factor: float) -> str:
    return '-' if reading is None else f'{factor * math.degrees(reading.value):.3g}'


def _taus(reading: Coefficient | None) -> str:
    if reading is None:
        return '-'
    if reading.shortest == reading.longest:
        return plain(reading.shortest, 2)
    return f'{plain(reading.shortest, 2)} to {plain(reading.longest, 2)}'


def _checks(result: Identification) -> str:
    lines = ['assumptions of the model:']
    for name, axis in _alive(result):
        for check in axis.checks:
            verdict = 'holds' if check.passed else 'FAILS'
            lines.append(f'  {name}  {check.name:<12}  {verdict}  {check.detail}')
    return '\n'.join(lines)


def _models(name: str, axis: AxisModel) -> str:
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


def _with_errors(values: Floats, deviations: Floats) -> str:
    return ', '.join(f'{v:.4f}+-{d:.4f}' for v, d in zip(values, deviations, strict=True)) or '-'


def parameter_file(result: Identification, source: str, noise: str) -> str:
    """Return the text of a ROS 2 parameter file.

    Comments in it name the recording, and how the noise Q and R was found.

    Raises:
        GyroDriftFilterError: The node and replay would refuse the file.
    """
    default = Parameters()

    def per_axis(
        of: Callable[[AxisModel], float], otherwise: Sequence[float]
    ) -> tuple[float, float, float]:
        x, y, z = (
            otherwise[i] if isinstance(axis, DeadAxis) else _rounded(of(axis))
            for i, axis in enumerate(result.axes)
        )
        return x, y, z

    values = {
        'sample_rate': _rounded(1.0 / result.timing.period),
        **bias_parameters(per_axis(lambda axis: axis.preprocessed.bias, default.bias_initial)),
        'model.phi': per_axis(lambda axis: axis.phi, default.model_phi),
        'model.process_noise': per_axis(
            lambda axis: axis.noise.process_noise, default.model_process_noise
        ),
        'model.measurement_noise': per_axis(
            lambda axis: axis.noise.measurement_noise, default.model_measurement_noise
        ),
        'model.noise_deviation': per_axis(
            lambda axis: axis.deviation, default.model_noise_deviation
        ),
    }
    bias_deviation = per_axis(lambda axis: axis.preprocessed.bias_deviation, (0.0, 0.0, 0.0))
    dead = [n for n, axis in zip(AXES, result.axes, strict=True) if isinstance(axis, DeadAxis)]
    # The figures of a sensor that changes its rate hold at one of its rates only.
    rate = f' at {1.0 / result.timing.period:.4g} Hz' if result.timing.stretches else ''
    head = [
        'Noise model of a gyroscope, for the node and `gyro_drift replay --params`.',
        'SI units; per axis x, y, z.',
        f'Identified from {source}, {result.seconds:.0f} s of rest{rate}, on {today()}.',
    ]
    if dead:
        head.append(f"Dead: {named_axes(dead)}; the package's defaults stand there.")
    remarks = {
        'sample_rate': ['Hz'],
        'bias.max': ['Larger than the default, as the bias is, rad/s'],
        'bias.initial': [
            f'{_of_bias(result).capitalize()}, rad/s.',
            'It holds until the first rest; standard error, with moves from rest to rest:',
            as_yaml(bias_deviation),
        ],
        'model.phi': ['AR(1) coefficient of the drift'],
        'model.process_noise': [f'Q and R of kalman and sage_husa, by {noise}, (rad/s)^2'],
        'model.noise_deviation': ['Standard deviation of the noise at rest, for adaptive, rad/s'],
    }
    return parameter_text(head, values, remarks)


def _rounded(value: float) -> float:
    """Return a value with nine digits: no recording tells as many."""
    return float(f'{value:.9g}')


def noise_of(result: Identification) -> Noise:
    """Return the noise of the noisiest axis, as Kalibr has it."""
    alive = [axis for _, axis in _alive(result)]
    walks = [
        axis.allan.rate_random_walk.value
        for axis in alive
        if axis.allan.rate_random_walk is not None
    ]
    # Where the Allan deviation has no such slope, the noise as if it were white.
    densities = [
        axis.deviation * math.sqrt(result.timing.period)
        if axis.allan.angle_random_walk is None
        else axis.allan.angle_random_walk.value
        for axis in alive
    ]
    walk = max(walks, default=None)
    return Noise(max(densities), walk, None, 1.0 / result.timing.period)
