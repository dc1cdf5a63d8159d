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

"""Apply a calibration: subtract the effect of accelerations, and multiply by the matrix.

`calibrate/` finds both. What `~/calibrate` finds is the bias (`commands.py`).
"""

from gyro_drift_filter.accelerate import PerAxis, inlined_kernel, kernel
from gyro_drift_filter.core.sample import LARGEST_ACCELERATION, Result, Sample, SampleStatus
from gyro_drift_filter.core.settings import Settings


@kernel
def subtract_acceleration(sample: Sample, last: PerAxis, settings: Settings) -> None:
    """Subtract from the rates what the acceleration adds to them, so that no bias contains it.

    `last` (3,) in m/s^2 is the last usable one, up to this sample.
    """
    rate, sensitivity = sample['angular_velocity'], settings['calibration_acceleration_sensitivity']
    usable, now = True, sample['linear_acceleration']
    for axis in range(3):
        usable = usable and abs(now[axis]) <= LARGEST_ACCELERATION  # False for NaN
    if usable:
        for axis in range(3):
            last[axis] = now[axis]
    for axis in range(3):
        row = 3 * axis
        rate[axis] -= (
            sensitivity[row] * last[0]
            + sensitivity[row + 1] * last[1]
            + sensitivity[row + 2] * last[2]
        )


@inlined_kernel
def apply_calibration(settings: Settings, result: Result) -> None:
    """Turn the rate into M rate, and its covariance, which is diagonal so far, into M C M'."""
    rate, variance = result['angular_velocity'], result['angular_velocity_variance']
    covariance, matrix = result['angular_velocity_covariance'], settings['calibration_matrix']
    if not settings['is_calibrated'] or result['status'] == SampleStatus.REFUSED:
        for pair in range(3):
            covariance[pair] = 0.0
        return
    x, y, z = rate[0], rate[1], rate[2]
    u, v, w = variance[0], variance[1], variance[2]
    pair = 0
    for i in range(3):
        a, b, c = matrix[3 * i], matrix[3 * i + 1], matrix[3 * i + 2]
        rate[i] = a * x + b * y + c * z
        variance[i] = a * a * u + b * b * v + c * c * w
        for k in range(i + 1, 3):
            other = a * u * matrix[3 * k] + b * v * matrix[3 * k + 1] + c * w * matrix[3 * k + 2]
            covariance[pair] = other
            pair += 1
