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

"""What `gyro_drift calibrate` prints and writes: tables and the parameter file."""

import math
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.calibrate.between_rests import Closures
from gyro_drift_filter.calibrate.exchange import ForeignCalibration
from gyro_drift_filter.calibrate.results import Calibration, ReferenceFit, name_of_entry
from gyro_drift_filter.cli.parameter_text import as_yaml, bias_parameters, parameter_text, today
from gyro_drift_filter.cli.printing import table
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.phrases import plain

_MATRIX, _SENSITIVITY = 'calibration.matrix', 'calibration.acceleration_sensitivity'


def report(result: Calibration) -> str:
    """Return all tables of a calibration."""
    sides = f' on {result.sides} sides' if result.sides else ''
    parts = [
        f'rests: {result.rests}{sides}, {result.rest_seconds:.0f} s in all; {len(result.legs)} '
        f'turns between them{" or seen by the reference" if result.reference else ""}',
        'rate = matrix (raw - bias), with standard errors',
        _matrix(result.matrix, result.deviation),
        _least_known(result.deviation),
    ]
    if len(result.legs):
        parts.append(_closures(result))
    if result.accelerometer is not None:
        found = result.accelerometer
        parts += [
            'found with it, for the accelerometer: acceleration = matrix (raw - bias)',
            _matrix(found.matrix, found.matrix_deviation),
            'bias (m/s^2): '
            + ', '.join(
                f'{value:.4f} +- {deviation:.4f}'
                for value, deviation in zip(found.bias, found.bias_deviation, strict=True)
            ),
        ]
    if (sensitivity := result.sensitivity) is not None:
        parts += [
            'what 1 g along each axis adds to the rates (deg/s)',
            _matrix(
                *(np.degrees(GRAVITY * x) for x in (sensitivity.matrix, sensitivity.deviation))
            ),
        ]
    if result.reference is not None:
        parts.append(_reference(result.reference))
    return '\n\n'.join(parts)


def _least_known(deviation: Floats) -> str:
    worst = float(deviation.max())
    name = name_of_entry(*map(int, np.unravel_index(np.argmax(deviation), deviation.shape)))
    return (
        f'the least known entry is {name}: known to {plain(100.0 * worst, 2)} %, which is '
        f'{plain(360.0 * worst, 2)} deg in a whole turn'
    )


def _reference(fit: ReferenceFit) -> str:
    lines = [
        f'reference: {1e3 * fit.late:.1f} +- {1e3 * fit.late_deviation:.1f} ms late, noise '
        f'{math.degrees(fit.noise):.2g} deg'
    ]
    if fit.level:
        lines.append('  it never tilts: compared about the vertical alone')
    else:
        quaternion = ', '.join(f'{value:.5f}' for value in fit.rotation)
        deviation = math.degrees(float(np.max(fit.rotation_deviation)))
        lines.append(f'  rotation to the sensor: x, y, z, w {quaternion} +- {deviation:.2g} deg')
    return '\n'.join(lines)


def _matrix(values: Floats, deviations: Floats) -> str:
    rows = [['', *AXES]]
    for name, row, errors in zip(AXES, values, deviations, strict=True):
        cells = (f'{v:.5f} +- {d:.5f}' for v, d in zip(row, errors, strict=True))
        rows.append([f'  {name}', *cells])
    return table(rows)


def _closures(result: Calibration) -> str:
    """Return the table of by how much turned rates miss gravity, before and after."""
    rows = [['by how much gravity is missed', 'before', 'after']]
    both = result.before, result.after
    seconds = float(result.legs[:, 2].sum())

    def row(title: str, values: list[float]) -> None:
        rows.append([title, *(f'{value:.2f}' for value in values)])

    def degrees(of: Closures) -> Floats:
        return np.degrees(of.angles)

    row('root mean square (deg)', [float(np.sqrt(np.mean(degrees(of) ** 2))) for of in both])
    row('median (deg)', [float(np.median(degrees(of))) for of in both])
    row('worst (deg)', [float(degrees(of).max()) for of in both])
    # The same turns by both.
    turned = float(result.after.turned.sum()) / (2.0 * math.pi)
    row('for each whole turn (deg)', [float(degrees(of).sum()) / turned for of in both])
    row(
        'for each minute of turning (deg)', [60 * float(degrees(of).sum()) / seconds for of in both]
    )
    return table(rows)


def parameter_file(result: Calibration, source: str) -> str:
    """Return the text of a ROS 2 parameter file; a comment names the recordings, its source."""
    head = [
        'Scale and misalignment of a gyroscope, for the node and `gyro_drift replay --params`.',
        f'Found from {source}: {len(result.legs)} turns between {result.rests} rests, '
        f'on {today()}.',
        *(f'Not known well: {text}' for text in result.unknown),
    ]
    if (found := result.accelerometer) is not None:
        head += [
            'The accelerometer, for whoever needs it: acceleration = matrix (raw - bias), m/s^2.',
            f'  matrix: {as_yaml(found.matrix)}',
            f'  bias: {as_yaml(found.bias)}',
        ]
    values = {_MATRIX: result.matrix}
    remarks = {
        _MATRIX: [
            'rate = matrix (filtered - bias), row by row; standard errors:',
            as_yaml(result.deviation),
        ]
    }
    if (sensitivity := result.sensitivity) is not None:
        values[_SENSITIVITY] = sensitivity.matrix
        remarks[_SENSITIVITY] = [
            'What each m/s^2 adds to the rates, in rad/s, row by row; standard errors:',
            as_yaml(sensitivity.deviation),
        ]
    return parameter_text(head, values, remarks)


def foreign_file(found: ForeignCalibration, source: str) -> str:
    """Return the text of a ROS 2 parameter file with what a file of another program says.

    Raises:
        GyroDriftFilterError: The node and replay would refuse the file.
    """
    head = [f'Scale and misalignment of a gyroscope, from {source}.']
    values: dict[str, Any] = {_MATRIX: found.matrix}
    if found.sensitivity is not None:
        values[_SENSITIVITY] = found.sensitivity
    if found.bias is not None:
        values |= bias_parameters(found.bias.tolist())
    return parameter_text(head, values, {})
