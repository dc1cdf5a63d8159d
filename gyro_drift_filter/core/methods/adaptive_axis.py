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

"""What method `adaptive` knows of one axis: its state, and its workspace within a sample."""

from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import record
from gyro_drift_filter.core.methods.doubt import Doubt
from gyro_drift_filter.core.methods.jolts import Jolt
from gyro_drift_filter.core.methods.mode_set import PerMode, Terms
from gyro_drift_filter.core.methods.noise import Noise
from gyro_drift_filter.core.methods.outlier_limits import InnovationLimits

VarianceKey = Annotated[NDArray[np.float64], np.float64, (4,)]
ErrorKey = Annotated[NDArray[np.float64], np.float64, (3,)]


class Bridge(TypedDict):
    """Repeated samples in a row, and what was put out instead: what they turned shows later."""

    samples: int  # in a row, 0 where there were none before the last sample
    angular_velocity: float  # sum of what was put out, rad/s
    before: float  # the sample before them, rad/s
    slope_before: float  # rad/s per sample
    behind: bool  # the last sample was the first one after them
    # of late, in (rad/s)^2: the squared change that was predicted, from one measurement to the
    # next, and its product with the change that was measured
    predicted_square: float
    predicted_product: float


BRIDGE = record(Bridge)


class AdaptiveAxis(TypedDict):
    """State of one axis after a sample."""

    learning: bool  # the noise has been given a first value
    # by mode
    probability: PerMode
    rate: PerMode
    acceleration: PerMode
    jerk: PerMode
    residual: PerMode  # of the sample before the last, which is noise if the mode is right
    last_accepted: float  # the last sample that was, rad/s
    noise: Noise
    doubt: Doubt
    jolt: Jolt  # of the accelerometer along the same axis
    knock_angle: float  # rad, the most that knocks explain of what the held samples turned
    held_angle: float  # rad, what the held samples turned beyond what was put out
    recent_angle: float  # rad, that was smoothed away of late while the sensor seemed still
    bridge: Bridge
    compensation: float  # rad, of it what was motion and is still to be given back


class AdaptiveAxisWorkspace(TypedDict):
    """What one axis needs from its prediction to its estimate."""

    # by mode, before the sample
    prior: PerMode
    rate: PerMode
    acceleration: PerMode
    jerk: PerMode
    expected: PerMode  # the sample: the rate with what can be predicted of its noise
    # of the innovation of each mode: variance, half its inverse, and the square root of that
    variance: PerMode
    half_precision: PerMode
    density: PerMode
    variance_key: VarianceKey  # the noise that these three belong to, see `_predict_mixed`
    error: PerMode  # variance that the noise leaves in the rate of each mode after the sample
    error_key: ErrorKey  # the noise that it belongs to
    # What the mixing moves: probability, and weighted by it rate, acceleration and jerk. What each
    # mode has before, and what arrives in it.
    weighted: Terms
    from_below: Terms
    from_above: Terms
    # terms of sums over the modes
    means: PerMode
    squares: PerMode
    others: PerMode
    prediction: float  # of the sample by all modes together
    prediction_variance: float  # of the innovation
    # rad/s, by which outliers are judged: as if the noise was white, in the geometric mean
    typical_innovation: float
    innovation_limits: InnovationLimits  # of the sample
    reason: int  # of the decision on the sample: a member of Reason
    accepted_before: float  # `last_accepted` before it, rad/s
    # it lies where the last accepted sample did, after one that was held back
    is_at_accepted: bool
    at_limit: bool  # the rate is at the end of the range
    hangs: bool  # it has come so often in a row that it was not measured anew


ADAPTIVE_AXIS = record(AdaptiveAxis, in_cache_lines=True)
ADAPTIVE_AXIS_WORKSPACE = record(AdaptiveAxisWorkspace, in_cache_lines=True)
