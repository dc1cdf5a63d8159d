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

"""Calibrations of other programs: Kalibr's file of an IMU, which OpenVINS reads too, and imu_tk's.

Kalibr (`scale-misalignment`): measured = M C_gyro_i rate + A C_gyro_i acceleration + bias, M lower
triangular, in the axes of the accelerometer, whose own M is lower triangular, too; for OpenVINS
A C_gyro_i is Tg. imu_tk: rate = T K (raw - B), the three matrices one after the other in a text
file.
"""

from typing import Any, NamedTuple

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.calibrate import CalibrationError


class ForeignCalibration(NamedTuple):
    """What a file of another program says: rate = matrix (raw - bias).

    Attributes:
        matrix: (3, 3).
        bias: (3,) in rad/s; None where the file holds none.
        sensitivity: (3, 3) what raw accelerations add to raw rates, in rad/s per m/s^2; None where
            the file holds none.
    """

    matrix: Floats
    bias: Floats | None = None
    sensitivity: Floats | None = None


class Noise(NamedTuple):
    """Noise as Kalibr has it; None where it is not known.

    Attributes:
        rate_density: In rad/s per root of Hz.
        rate_walk: Random walk of the bias in rad/s^2 per root of Hz.
        acceleration_density: In m/s^2 per root of Hz.
        sample_rate: In Hz.
    """

    rate_density: float
    rate_walk: float | None
    acceleration_density: float | None
    sample_rate: float


def from_kalibr(document: Any) -> ForeignCalibration:
    """Return what a Kalibr file says, as PyYAML has loaded it.

    Raises:
        CalibrationError: It is none, or holds no intrinsics.
    """
    imus = document.values() if isinstance(document, dict) else ()
    for imu in (document, *imus):
        if isinstance(imu, dict) and isinstance(imu.get('gyroscopes'), dict):
            gyroscopes = imu['gyroscopes']
            turned = _invertible(gyroscopes.get('C_gyro_i', np.eye(3)), 'C_gyro_i')
            measured = _invertible(gyroscopes.get('M'), 'M') @ turned
            matrix = np.asarray(np.linalg.inv(measured), np.float64)
            sensitivity = _matrix(gyroscopes.get('A', np.zeros((3, 3))), 'A')
            if not sensitivity.any():
                return ForeignCalibration(matrix)
            accelerometers = imu.get('accelerometers')
            raw = accelerometers.get('M') if isinstance(accelerometers, dict) else np.eye(3)
            by_raw = np.linalg.inv(_invertible(raw, 'M of the accelerometers'))
            return ForeignCalibration(matrix, None, sensitivity @ turned @ by_raw)
    raise CalibrationError(
        "no gyroscopes' M in the file: Kalibr writes it with --imu-models scale-misalignment"
    )


def _matrix(value: Any, name: str) -> Floats:
    try:
        matrix = np.asarray(value, np.float64).reshape(3, 3)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f'{name} in the file is no matrix of 3 by 3') from error
    if not np.isfinite(matrix).all():
        raise CalibrationError(f'{name} in the file is not finite')
    return matrix


def _invertible(value: Any, name: str) -> Floats:
    matrix = _matrix(value, name)
    if abs(np.linalg.det(matrix)) < 1e-12:
        raise CalibrationError(f'{name} in the file can not be inverted')
    return matrix


def from_imu_tk(text: str) -> ForeignCalibration:
    """Return what a .calib file of imu_tk says.

    Raises:
        CalibrationError: It is none.
    """
    try:
        numbers = np.array(text.split(), np.float64)
    except ValueError as error:
        raise CalibrationError('the .calib file holds something else than numbers') from error
    if len(numbers) != 21:
        raise CalibrationError(
            f'a .calib file has 21 numbers, misalignment, scale and bias, not {len(numbers)}'
        )
    if not np.isfinite(numbers).all():
        raise CalibrationError('the .calib file holds numbers that are not finite')
    matrix = numbers[:9].reshape(3, 3) @ numbers[9:18].reshape(3, 3)
    return ForeignCalibration(matrix, numbers[18:])


def to_kalibr(
    noise: Noise,
    topic: str,
    matrix: Floats | None = None,
    accelerometer: Floats | None = None,
    sensitivity: Floats | None = None,
) -> str:
    """Return the text of a file that Kalibr and OpenVINS read.

    Kalibr looks for the noise at the top, and for no more; OpenVINS for all in `imu0`, and for the
    first line. The matrices stand there by the names of Kalibr's results, too, which this package
    reads.

    Args:
        noise: For its noise densities.
        topic: Of the Imu messages.
        matrix: (3, 3) of rate = matrix (raw - bias); None where only noise is known.
        accelerometer: (3, 3) the same of the accelerometer.
        sensitivity: (3, 3) what its raw accelerations add to the raw rates, in rad/s per m/s^2.
    """
    text = [
        '%YAML 1.0',
        '---',
        '# Kalibr reads the first part, OpenVINS the second. Both are for the raw topic.',
        *_noise(noise, topic, ''),
        'imu0:',
        *_rows('T_i_b', np.eye(4)),
        *_noise(noise, topic, '  '),
        '  time_offset: 0.0',
        '  model: kalibr',
    ]
    # The axes are those in which the accelerometer's matrix is lower triangular.
    inverse = np.linalg.inv(np.eye(3) if accelerometer is None else accelerometer)
    acceleration, turned = _lower(np.asarray(inverse, np.float64))
    measured = np.linalg.inv(np.eye(3) if matrix is None else matrix)
    rate, gyroscope = _lower(np.asarray(measured @ turned.T, np.float64))
    by_force = (np.zeros((3, 3)) if sensitivity is None else sensitivity) @ acceleration
    if matrix is not None:  # as Kalibr writes its results
        text += [
            '  accelerometers:',
            *_rows('M', acceleration, '    '),
            '  gyroscopes:',
            *_rows('M', rate, '    '),
            *_rows('C_gyro_i', gyroscope, '    '),
            *_rows('A', by_force @ gyroscope.T, '    '),
        ]
    text += [
        *_rows('Tw', rate),
        *_rows('R_IMUtoGYRO', gyroscope),
        *_rows('Ta', acceleration),
        *_rows('R_IMUtoACC', np.eye(3)),
        *_rows('Tg', by_force),
    ]
    return '\n'.join(text) + '\n'


def lacking(noise: Noise) -> str:
    """Return in words what Kalibr and OpenVINS need and the noise does not hold; empty if all."""
    names = [name for name, value in _densities(noise).items() if value is None]
    if not names:
        return ''
    return (
        f'the file for Kalibr has no {" and no ".join(names)}. Kalibr and OpenVINS need a value: '
        'see the data sheet'
    )


def _densities(noise: Noise) -> dict[str, float | None]:
    """Return the noise by the names of Kalibr, which takes none that is zero."""
    return {
        'accelerometer_noise_density': noise.acceleration_density or None,
        'accelerometer_random_walk': None,
        'gyroscope_noise_density': noise.rate_density or None,
        'gyroscope_random_walk': noise.rate_walk or None,
    }


def _noise(noise: Noise, topic: str, indent: str) -> list[str]:
    lines = [f'rostopic: {topic}', f'update_rate: {noise.sample_rate:.6g}']
    for name, value in _densities(noise).items():
        lines.append(f'# {name}: not known' if value is None else f'{name}: {value:.9e}')
    return [indent + line for line in lines]


def _lower(matrix: Floats) -> tuple[Floats, Floats]:
    """Return a lower triangular matrix and a rotation whose product a matrix is."""
    q, r = np.linalg.qr(matrix.T)
    signs = np.where(np.diag(r) < 0.0, -1.0, 1.0)
    return (signs[:, None] * r).T, (q * signs).T


def _rows(name: str, matrix: Floats, indent: str = '  ') -> list[str]:
    listed = ('[' + ', '.join(f'{value:.9e}' for value in row) + ']' for row in matrix)
    return [f'{indent}{name}:', *(f'{indent}  - {row}' for row in listed)]
