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

"""Jolts: how the accelerometer is shaken, which tells a body that is hit from an outlier.

A knock turns the sensor as suddenly as a spike would, but shakes the accelerometer as well.
"""

from typing import TypedDict

import numpy as np

from gyro_drift_filter.accelerate import kernel

JOLT_RATIO = 15.0  # usual changes of the acceleration from sample to sample: something was hit
SHAKE_RATIO = 4.0  # usual changes: what noise alone may do
# The least usual changes, in m/s^2: below lies the resolution.
JOLT_FLOOR, SHAKE_FLOOR = 0.05, 0.03
JOLT_SAMPLES = 2  # the gyroscope may lag behind the accelerometer by a sample
LEVER = 0.03  # m: what turns a body suddenly pushes it, too, this far from the axis or further
PUSH_SECONDS = 0.01  # a push may last no longer: of samples further apart each shows a part of it
FIRST_CHANGE = 10.0  # m/s^2, the usual change until it is known
# In motion a shake is that of a hit from so many usual ones on.
HIT_RATIO = 3.0

# Running means of changes and innovations: the weight of a sample, its largest size in such means,
# and the least mean, as processors are slow with denormal numbers.
USUAL_MEMORY, USUAL_LIMIT, LEAST_USUAL = 0.05, 5.0, 1e-9


class Jolt(TypedDict):
    """How the accelerometer is shaken along one axis."""

    linear_acceleration: float  # of the last sample, m/s^2
    change: float  # since the sample before, m/s^2
    change_before: float  # of that one
    usual_change: float  # from sample to sample, m/s^2
    samples_left: int  # for which the last jolt still counts
    calm_samples: int  # in a row, in which noise alone may have changed it


@kernel
def feel_jolt(jolt: Jolt, linear_acceleration: float) -> bool:
    """Note the acceleration along one axis (m/s^2); say if it has jumped, now or just before.

    Where nothing was measured, NaN, nothing is felt, nor at the sample after it.
    """
    change = abs(linear_acceleration - jolt['linear_acceleration'])
    jolt['linear_acceleration'] = linear_acceleration
    jolt['samples_left'] = max(jolt['samples_left'] - 1, 0)
    jolt['change_before'] = jolt['change']
    jolt['change'] = 0.0
    if not change < np.inf:
        jolt['calm_samples'] += 1
        return False
    jolt['calm_samples'] = 0 if change > _change_of_noise(jolt) else jolt['calm_samples'] + 1
    usual = max(jolt['usual_change'], JOLT_FLOOR)
    jolt['change'] = change
    if change > JOLT_RATIO * usual:
        jolt['samples_left'] = JOLT_SAMPLES
    jolt['usual_change'] = usual_after(jolt['usual_change'], change, USUAL_LIMIT * usual)
    return bool(jolt['samples_left'] > 0)


@kernel
def was_jolted(jolt: Jolt) -> bool:
    """Return whether the accelerometer had jumped before this sample; call it after `feel_jolt`."""
    return bool(0 < jolt['samples_left'] < JOLT_SAMPLES)


@kernel
def felt_change(jolt: Jolt, change: float, still: bool) -> float:
    """Return a change of the acceleration (m/s^2), or 0 if it may be noise of a still sensor."""
    return 0.0 if still and change < _change_of_noise(jolt) else change


@kernel
def _change_of_noise(jolt: Jolt) -> float:
    """Return by how much noise alone may change the acceleration with a sample, in m/s^2."""
    return SHAKE_RATIO * max(jolt['usual_change'], SHAKE_FLOOR)


@kernel
def shake_per_jump(period: float) -> float:
    """Return the shake in m/s^2, at `LEVER`, of a jump of 1 rad/s in a sample period in s."""
    return LEVER / period * min(PUSH_SECONDS / period, 1.0)


@kernel
def jump_by_shake(shake: float, usual_shake: float, per_jump: float) -> float:
    """Return the jump in rad/s that a shake explains in motion, at `LEVER` from its axis.

    It is 0 where the shake is not much more than the usual one, both in m/s^2. `per_jump` is what
    `shake_per_jump` returns.
    """
    return shake / per_jump if shake > HIT_RATIO * usual_shake else 0.0


@kernel
def usual_after(usual: float, size: float, largest: float) -> float:
    """Return what is usual after a sample of a size, which counts as `largest` at most."""
    return max(usual + USUAL_MEMORY * (min(size, largest) - usual), LEAST_USUAL)
