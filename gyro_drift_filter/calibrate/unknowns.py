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

"""The unknowns of a calibration, and what is known of them beforehand.

They stand in one vector: the matrix of the gyroscope row by row, bias and upper triangular
matrix of the accelerometer, the logarithm of a factor that is common to the gyroscope's nominal
scales, and what relates a reference to the sensor.
"""

from typing import NamedTuple

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.gravity import GRAVITY

MATRIX, OFFSET, UPPER, SCALE = slice(0, 9), slice(9, 12), slice(12, 18), 18
# Of a reference: rotation vector to the sensor, and by how much its stamps are late.
TURNED, LATE = slice(19, 22), 22
UNKNOWNS = 23
UPPER_ENTRIES = np.triu_indices(3)

# What data sheets of MEMS sensors give as standard deviations: scale and misalignment of the
# gyroscope, bias, scale and misalignment of the accelerometer. The nominal scale of a driver,
# common to all axes, may be off by more.
SCALE_DEVIATION, MISALIGNMENT = 0.03, float(np.radians(2.0))
OFFSET_DEVIATION, ACCELEROMETER_SCALE = 0.1 * GRAVITY, 0.05
NOMINAL_DEVIATION = 0.3


class Residuals(NamedTuple):
    """Residuals (n,) of standard deviation one, and what they depend on (n, UNKNOWNS)."""

    values: Floats
    jacobian: Floats


def start() -> Floats:
    """Return the unknowns (UNKNOWNS,) of a perfect sensor."""
    unknowns = np.zeros(UNKNOWNS)
    unknowns[MATRIX] = np.eye(3).ravel()
    unknowns[UPPER] = np.eye(3)[UPPER_ENTRIES]
    return unknowns


def set_scale(unknowns: Floats, scale: float) -> None:
    """Set in unknowns (UNKNOWNS,) the nominal scale of a gyroscope that is perfect but for that."""
    unknowns[MATRIX], unknowns[SCALE] = scale * np.eye(3).ravel(), np.log(scale)


def upper(unknowns: Floats) -> Floats:
    """Return the matrix (3, 3) of the accelerometer in unknowns (UNKNOWNS,)."""
    matrix = np.zeros((3, 3))
    matrix[UPPER_ENTRIES] = unknowns[UPPER]
    return matrix


def prior(unknowns: Floats) -> Residuals:
    """Return what is known of any sensor: it is as its data sheet says, but for a common scale."""
    jacobian = np.zeros((UNKNOWNS, UNKNOWNS))
    values = np.zeros(UNKNOWNS)
    scale, identity = float(np.exp(unknowns[SCALE])), np.eye(3).ravel()
    deviations = np.where(identity > 0.0, SCALE_DEVIATION, MISALIGNMENT)
    values[MATRIX] = (unknowns[MATRIX] / scale - identity) / deviations
    jacobian[MATRIX, MATRIX] = np.diag(1.0 / (scale * deviations))
    jacobian[MATRIX, SCALE] = -unknowns[MATRIX] / (scale * deviations)
    values[OFFSET] = unknowns[OFFSET] / OFFSET_DEVIATION
    jacobian[OFFSET, OFFSET] = np.eye(3) / OFFSET_DEVIATION
    identity = np.eye(3)[UPPER_ENTRIES]
    deviations = np.where(identity > 0.0, ACCELEROMETER_SCALE, MISALIGNMENT)
    values[UPPER] = (unknowns[UPPER] - identity) / deviations
    jacobian[UPPER, UPPER] = np.diag(1.0 / deviations)
    values[SCALE] = unknowns[SCALE] / NOMINAL_DEVIATION
    jacobian[SCALE, SCALE] = 1.0 / NOMINAL_DEVIATION
    jacobian[TURNED, TURNED] = np.eye(3) / np.pi
    values[TURNED] = unknowns[TURNED] / np.pi
    jacobian[LATE, LATE], values[LATE] = 1.0, unknowns[LATE]
    return Residuals(values, jacobian)


def same_frame(unknowns: Floats) -> Residuals:
    """Return residuals that are zero if the matrix does not turn the sensor as a whole.

    A reference alone can't tell that turn, because its own rotation to the sensor is unknown. So
    the axes stay as near as can be to those that the sensor had.
    """
    jacobian = np.zeros((3, UNKNOWNS))
    for row, (i, k) in enumerate(((0, 1), (0, 2), (1, 2))):
        jacobian[row, 3 * i + k], jacobian[row, 3 * k + i] = 1.0, -1.0
    jacobian /= 1e-3 * MISALIGNMENT
    return Residuals(jacobian @ unknowns, jacobian)
