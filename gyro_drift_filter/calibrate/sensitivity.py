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

"""How the rates of a gyroscope depend on the acceleration: what gravity does to them at rest."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc  # of Fisher's distribution; scipy.stats takes half a second to load

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.calibrate.rests import Rests
from gyro_drift_filter.gravity import GRAVITY

# A bias wanders from rest to rest by a tenth of what gravity does to it.
WANDERING = 0.1
# So seldom a bias that only wanders looks as if it depended on the acceleration.
BY_CHANCE = 1e-3


@dataclass(frozen=True)
class AccelerationSensitivity:
    """What accelerations add to the rates: measured = rate + bias + matrix acceleration.

    Attributes:
        matrix: (3, 3) in rad/s per m/s^2.
        deviation: (3, 3) its standard error.
        spread: (3, 3) covariance of each of its rows, for rates at rest of variance one.
        is_found: Whether it is more than chance makes of a bias that wanders.
    """

    matrix: Floats
    deviation: Floats
    spread: Floats
    is_found: bool


def find_sensitivity(recordings: Sequence[Rests]) -> AccelerationSensitivity:
    """Return the sensitivity by the rests of recordings of one sensor.

    In addition the bias changes linearly over each recording. What the rests do not tell stays near
    zero, within what data sheets allow. The acceleration is as the sensor gives it: what the bias
    of the accelerometer adds counts as a part of that of the gyroscope.
    """
    recordings = [found for found in recordings if found.rests and _is_measured(found)]
    parts = [_without_trend(found) for found in recordings]
    if not parts:
        nothing = np.zeros((3, 3))
        return AccelerationSensitivity(nothing, nothing, nothing, is_found=False)
    rates, forces = (np.concatenate([part[k] for part in parts]) for k in range(2))
    normal = forces.T @ forces
    inverse = np.linalg.inv(normal + (WANDERING * GRAVITY) ** 2 * np.eye(3))
    matrix, spread = rates.T @ forces @ inverse, inverse @ normal @ inverse
    left = np.sum((rates - forces @ matrix.T) ** 2, axis=0)
    free = sum(len(found.rests) - min(len(found.rests), 2) for found in recordings) - 3
    noise = np.mean(
        [found.rate_density / rest.seconds for found in recordings for rest in found.rests], axis=0
    )
    variance = np.maximum(left / max(free, 1), noise)
    explained = np.maximum(np.sum(rates**2, axis=0) - left, 0.0) / 3.0 / variance
    chance = fdtrc(3, max(free, 1), explained)
    deviation = np.sqrt(np.outer(variance, np.diag(spread)))
    return AccelerationSensitivity(
        matrix, deviation, spread, is_found=bool(free > 0 and chance.min() < BY_CHANCE)
    )


def _is_measured(found: Rests) -> bool:
    return bool(np.isfinite([rest.acceleration for rest in found.rests]).all())


def _without_trend(found: Rests) -> tuple[Floats, Floats]:
    """Return the rates and accelerations (n, 3) at the rests without what goes straight in time."""
    both = np.array([np.concatenate([rest.rate, rest.acceleration]) for rest in found.rests])
    times = np.array([rest.time for rest in found.rests])
    trend = np.column_stack([np.ones(len(times)), times - times.mean()])
    both = both - trend @ np.linalg.lstsq(trend, both, rcond=None)[0]
    return both[:, :3], both[:, 3:]
