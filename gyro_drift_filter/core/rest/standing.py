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

"""The rates while gravity stands: on the mean they are the bias, whatever their noise.

A body whose gravity stays where it is has not tilted, so what its rates across the vertical show is
no motion but noise, however slow. About the vertical it may turn, and then that axis scatters more
than the others do.
"""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.rest.noise import correlation_of_means, ratio_by_correlation
from gyro_drift_filter.core.rest.records import Rest
from gyro_drift_filter.core.rest.segment import (
    LEAST_VARIANCE,
    add_mean,
    block_mean,
    mean_of,
    scatter_of_means,
)
from gyro_drift_filter.gravity import GRAVITY

# Gravity stands where the means of blocks stay within this, and is that, in m/s^2; the tilt in rad
# that does not show.
STEADY_GRAVITY, LEAST_GRAVITY = 0.2, 5.0
LARGEST_TILT = STEADY_GRAVITY / GRAVITY
# The noise of one axis has up to so many times the variance of the others. What scatters more than
# this is shaken, which hides a turn: the means of blocks of slow noise scatter by half of it.
UNLIKE, LARGEST_SCATTER = 9.0, 0.01  # rad/s


@kernel
def note_gravity(rest: Rest, block_seconds: float) -> None:
    """Note for how long gravity has stood, and the rates meanwhile, at the end of a block."""
    gravity, size, has_moved = rest['gravity'], 0.0, False
    for axis in range(3):
        mean = block_mean(rest, 3 + axis)
        size += mean * mean
        if abs(mean - gravity[axis]) > STEADY_GRAVITY:
            has_moved = True
    rest['standing_seconds'] += block_seconds
    if has_moved:
        for axis in range(3):
            gravity[axis] = block_mean(rest, 3 + axis)
    if has_moved or size < LEAST_GRAVITY * LEAST_GRAVITY or rest['force']['late'] > 0:
        rest['standing_seconds'] = 0.0
        rest['standing_blocks'] = 0
        return
    for axis in range(3):
        add_mean(rest['standing'][axis], block_mean(rest, axis), rest['standing_blocks'])
    rest['standing_blocks'] += 1


@kernel
def standing_mean(rest: Rest, axis: int) -> float:
    """Return the mean rate of an axis while gravity stands."""
    return mean_of(rest['standing'][axis], rest['standing_blocks'])


@kernel
def standing_scatter(rest: Rest, axis: int) -> float:
    """Return the variance of the means of blocks of an axis while gravity stands."""
    return scatter_of_means(rest['standing'][axis], rest['standing_blocks'])


@kernel
def variance_of_standing_mean(rest: Rest, axis: int) -> float:
    """Return the variance of the mean rate, by the scatter of the blocks and how alike they are."""
    blocks = rest['standing_blocks']
    ratio = ratio_by_correlation(correlation_of_means(rest['standing'][axis], blocks))
    return ratio * standing_scatter(rest, axis) / blocks


@kernel
def is_noise(rest: Rest) -> bool:
    """Return whether the three axes scatter alike, and as little as noise does."""
    total = largest = 0.0
    for axis in range(3):
        scatter = standing_scatter(rest, axis) + LEAST_VARIANCE
        total += scatter
        largest = max(largest, scatter)
    alike = largest <= UNLIKE * 0.5 * (total - largest)
    return bool(alike and largest <= LARGEST_SCATTER * LARGEST_SCATTER)
