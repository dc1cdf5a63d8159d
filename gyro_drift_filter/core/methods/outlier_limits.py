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

"""What a sample has to exceed to be an outlier, and what a body does at most in a sample period.

At rest noise alone says what is far. In motion it has to be more than a body reaches in a sample
period, too.
"""

from typing import TYPE_CHECKING, TypedDict

import numpy as np

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.methods.jolts import shake_per_jump
from gyro_drift_filter.core.methods.mode_set import FORESEEN_SECONDS

if TYPE_CHECKING:
    from gyro_drift_filter.core.settings import Settings

GROWTH_LIMIT = 500.0  # rad/s^2: motion that has only begun grows by no more than an arm can do
# At sample periods above `FORESEEN_SECONDS` the least jump in motion grows with what the modes fail
# to foresee, up to the change of a hand that reverses its turn, in rad/s.
LARGEST_REVERSAL = 16.0
JERK_FROM_REST = 250.0  # rad/s^3: a motion that begins faster shows in the next sample
AGREEMENT_LIMIT = 150.0  # rad/s^2: held samples that differ by more are no motion
BODY_LIMIT = 1000.0  # rad/s^2: what is not hit does no more
JOLT_LIMIT = 6.0  # rad/s: what a hit may do to the rate in a sample, ...
JOLT_ACCELERATION = 300.0  # rad/s^2: ... or in a longer period, up to `LARGEST_REVERSAL`


class OutlierLimits(TypedDict):
    """Limits for one sample period."""

    threshold: float  # outlier.threshold: a number of typical or usual innovations
    acceleration_limit: float  # rad/s, by `outlier.acceleration` in a sample period
    least_jump: float  # rad/s, in motion
    least_jump_while_still: float  # rad/s
    growth_limit: float  # rad/s
    agreement_limit: float  # rad/s
    body_limit: float  # rad/s
    jolt_limit: float  # rad/s
    shake_per_jump: float  # m/s^2 for a jump of 1 rad/s
    run: int  # samples: the longest run of equal outliers
    longest_hold: int  # samples


class InnovationLimits(TypedDict):
    """What the sample at hand has to exceed to be doubtful, in rad/s.

    Its innovation has to exceed the first two. The last one is for its distance from the
    prediction, the last accepted sample or the one before the last restart, whichever is nearest.
    """

    innovation_threshold: float  # `outlier.threshold` typical or usual innovations
    least_jump: float  # by `outlier.acceleration`, or less where the sensor is still
    body_jump: float  # beyond this it is doubtful whatever the other two are


@kernel
def derive_limits(settings: 'Settings', period: float, limits: OutlierLimits) -> None:
    """Fill the limits for a sample period in s."""
    enabled = settings['outlier_enabled']
    limits['threshold'] = settings['outlier_threshold'] if enabled else np.inf
    limit = settings['outlier_acceleration'] * period
    unforeseen = max(period / FORESEEN_SECONDS, 1.0) ** 2.0
    limits['acceleration_limit'] = limit
    limits['least_jump'] = max(min(limit * unforeseen, LARGEST_REVERSAL), limit)
    from_rest = 0.5 * JERK_FROM_REST * period * period
    limits['least_jump_while_still'] = min(from_rest, limit)
    limits['growth_limit'] = GROWTH_LIMIT * period
    limits['agreement_limit'] = AGREEMENT_LIMIT * period
    limits['body_limit'] = BODY_LIMIT * period
    limits['jolt_limit'] = max(JOLT_LIMIT, min(JOLT_ACCELERATION * period, LARGEST_REVERSAL))
    limits['shake_per_jump'] = shake_per_jump(period)
    limits['run'] = settings['outlier_run']
    limits['longest_hold'] = 2 * settings['outlier_run'] + 2


@kernel
def fill_innovation_limits(
    innovation_limits: InnovationLimits,
    usual_innovation: float,
    typical_innovation: float,
    still: bool,
    limits: OutlierLimits,
) -> None:
    """Fill in what the innovation of a sample has to exceed, before `find_reason`.

    The usual innovation is that of the last samples, the typical one is what the modes expect of
    white noise, both in rad/s.
    """
    usual = limits['threshold'] * usual_innovation
    innovation_limits['innovation_threshold'] = max(limits['threshold'] * typical_innovation, usual)
    least_jump = limits['least_jump_while_still'] if still else limits['least_jump']
    innovation_limits['least_jump'] = least_jump
    # No body jumps this far, whatever the modes expect, except back from where outliers led.
    innovation_limits['body_jump'] = max(limits['jolt_limit'], limits['body_limit'], usual)
