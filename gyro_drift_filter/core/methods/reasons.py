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

"""What method `adaptive` does with a sample, and why, in the words of a user."""

from collections.abc import Mapping
from enum import IntEnum

from gyro_drift_filter.accelerate import kernel


class Decision(IntEnum):
    """What is to be done with a sample."""

    ACCEPT = 0  # it corrects the modes; a CONSTANT starts them anew
    HOLD = 1  # back, until the samples after it say what it was
    START_ANEW = 2  # at this sample: what was held back was motion
    BRIDGE = 3  # nothing was measured, the prediction stands in for it
    PASS = 4  # as it is: the sensor is at the end of its range


class Reason(IntEnum):
    """Why a decision is what it is: `REASONS` says it, and `decision_of` which one it is.

    The order matters, as `decision_of` and `limits_of` compare the numbers: a new one comes at the
    end of its group.
    `outliers.py` judges a sample by its innovation. `adaptive` overrules it where the rate says
    nothing: for CONSTANT, REPEATED and AT_LIMIT. It also tells KNOCKED from RETURNED.
    """

    # ACCEPT
    EXPECTED = 0
    CROWDED = 1
    RETURNED = 2
    KNOCKED = 3
    CONSTANT = 4
    # HOLD
    FAR = 5
    FAR_WHILE_STILL = 6
    BEYOND_BODY = 7
    BEYOND_REACH = 8
    DROPOUT = 9
    UNDECIDED = 10
    # START_ANEW
    REACHED = 11
    STAYED = 12
    PUSHED = 13
    JOLTED = 14
    CONFIRMED = 15
    GROWN = 16
    GROWN_AGAIN = 17
    GONE_ON = 18
    AGREED = 19
    HELD_LONGEST = 20
    CROWDED_WHILE_HELD = 21
    DROPOUT_GOES_ON = 22
    UNCONFIRMED = 23
    # BRIDGE
    REPEATED = 24
    # PASS
    AT_LIMIT = 25


# In the words of a user, of the sample at hand.
REASONS: Mapping[int, str] = {
    Reason.EXPECTED: 'within the limits',
    Reason.CROWDED: 'accepted: too many were held back of late for all of them to be outliers',
    Reason.RETURNED: 'back at the prediction: what was held back before it was an outlier',
    Reason.KNOCKED: 'back at the prediction: what was held back was a knock, which the '
    'accelerometer felt; its angle is given back',
    Reason.CONSTANT: 'accepted: it has come so often in a row that it is the rate',
    Reason.FAR: 'beyond outlier.threshold and outlier.acceleration',
    Reason.FAR_WHILE_STILL: 'beyond outlier.threshold, and the rate had been as steady as at rest '
    'until then',
    Reason.BEYOND_BODY: 'a jump that no body makes within a sample period unless it is hit',
    Reason.BEYOND_REACH: 'beyond outlier.threshold, and further away than a body can have come '
    'since the last sample that was measured',
    Reason.DROPOUT: 'a read that failed: all three rates are exactly 0, or the same value',
    Reason.UNDECIDED: 'neither back at the prediction nor shown to be motion yet',
    Reason.REACHED: 'taken for motion: a body can have come there since the last sample that was '
    'measured',
    Reason.STAYED: 'taken for motion that has ended: the rate is still near the last accepted one',
    Reason.PUSHED: 'taken for motion: the accelerometer was shaken by as much as explains it',
    Reason.JOLTED: 'taken for motion: the accelerometer has jumped, and the rate is still away',
    Reason.CONFIRMED: 'taken for motion: the rate is still away, and the jump was within '
    'outlier.acceleration',
    Reason.GROWN: 'taken for motion: further away, as a turn is that has only begun',
    Reason.GROWN_AGAIN: 'taken for motion: further away for the second time',
    Reason.GONE_ON: 'taken for motion: by steps like the first one, as of a body that is stopped',
    Reason.AGREED: 'taken for motion: more samples in a row agree than outliers do (outlier.run)',
    Reason.HELD_LONGEST: 'taken for motion: no more samples in a row are held back (outlier.run)',
    Reason.CROWDED_WHILE_HELD: 'taken for motion: too many were held back of late for all of them '
    'to be outliers',
    Reason.DROPOUT_GOES_ON: 'passed on: reads have failed for as long as samples are held back',
    Reason.UNCONFIRMED: 'started anew: nothing speaks for the sample that the filter started at',
    Reason.REPEATED: 'bridged: the sensor has not measured since the sample before',
    Reason.AT_LIMIT: 'passed on: the rate is taken for the end of the range',
}


@kernel
def decision_of(reason: int) -> Decision:
    """Return the decision that a `Reason` stands for."""
    if reason >= Reason.AT_LIMIT:
        return Decision.PASS
    if reason >= Reason.REPEATED:
        return Decision.BRIDGE
    if reason >= Reason.REACHED:
        return Decision.START_ANEW
    return Decision.HOLD if reason >= Reason.FAR else Decision.ACCEPT
