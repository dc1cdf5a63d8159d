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

"""The bias of a body that is shaken while the robot says that it stands.

A machine at work, an arm, or soft tires shake a body that stands, so that no block is still and
there is no rest. What shakes it leads nowhere, so that the mean of its rates is the bias all the
same. A slow turn looks like that, too: only the robot itself can say that there is none
(`motion_hint`).

How certain the mean is shows in how the means of its parts scatter, which are long enough for what
shakes a body to go to and fro in each of them. Gravity has to stand from part to part: wheels that
stand say nothing of who lifts the robot and carries it away.
"""

from collections.abc import Sequence
from typing import Annotated, TypedDict

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.rest.records import (
    MEAN_SUMS,
    SEGMENT_BLOCKS,
    SIGNALS,
    MeanSums,
    PerSignal,
    Rest,
)
from gyro_drift_filter.core.rest.segment import (
    LEAST_VARIANCE,
    add_mean,
    block_mean,
    mean_of,
    scatter_of_means,
)
from gyro_drift_filter.core.rest.standing import STEADY_GRAVITY

# A mean is that of so many parts of two seconds each, or more below 64 Hz. That of few is less
# certain than their scatter says, by (n - 1) / (n - 3), as the variance of Student's t.
PARTS = 5
STUDENT = (PARTS - 1.0) / (PARTS - 3.0)
# The robot may say so while it still comes to a stop.
SKIPPED_PARTS = 1


class ShakenStand(TypedDict):
    """The rates of a body while the robot says that it stands, without a rest."""

    blocks: int  # in the part under way
    sums: PerSignal  # of their means, in rad/s and m/s^2
    gravity: PerAxis  # m/s^2, of the first part
    parts: int  # so far; negative for those that are left out
    beyond_max: bool  # the last mean was beyond the largest bias
    means: Annotated[Sequence[MeanSums], MEAN_SUMS, (3,)]  # of the parts, in rad/s


SHAKEN_STAND = record(ShakenStand)


@kernel
def forget_stand(stand: ShakenStand) -> None:
    """Forget the stand, as it has ended."""
    _begin_anew(stand)
    stand['beyond_max'] = False


@kernel
def _begin_anew(stand: ShakenStand) -> None:
    stand['blocks'] = 0
    stand['parts'] = -SKIPPED_PARTS


@kernel
def note_stand(stand: ShakenStand, rest: Rest) -> bool:
    """Add the full block of a body that stands; return whether the mean is complete.

    Then `stand_mean` and `variance_of_stand_mean` can be read, and the next one begins.
    """
    if stand['parts'] == PARTS:
        stand['parts'] = 0
    for i in range(SIGNALS):
        mean = block_mean(rest, i)
        stand['sums'][i] = mean if stand['blocks'] == 0 else stand['sums'][i] + mean
    stand['blocks'] += 1
    if stand['blocks'] < SEGMENT_BLOCKS:
        return False
    if not _gravity_stands(stand):
        _begin_anew(stand)
        return False
    if stand['parts'] >= 0:
        for axis in range(3):
            part = stand['sums'][axis] / SEGMENT_BLOCKS
            add_mean(stand['means'][axis], part, stand['parts'])
    stand['blocks'] = 0
    stand['parts'] += 1
    return stand['parts'] == PARTS


@kernel
def _gravity_stands(stand: ShakenStand) -> bool:
    """Return whether gravity is in the full part what it was in the first one."""
    for axis in range(3):
        gravity = stand['sums'][3 + axis] / SEGMENT_BLOCKS
        if stand['parts'] <= 0:
            stand['gravity'][axis] = gravity
        elif abs(gravity - stand['gravity'][axis]) > STEADY_GRAVITY:
            return False
    return True


@kernel
def stand_mean(stand: ShakenStand, axis: int) -> float:
    """Return the mean rate of an axis in rad/s."""
    return mean_of(stand['means'][axis], PARTS)


@kernel
def variance_of_stand_mean(stand: ShakenStand, axis: int) -> float:
    """Return the variance of `stand_mean` in (rad/s)^2."""
    scatter = scatter_of_means(stand['means'][axis], PARTS)
    return max(STUDENT * scatter / PARTS, LEAST_VARIANCE)
