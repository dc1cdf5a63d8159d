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

"""A sample of the sensor, and what the filter makes of it."""

from enum import IntEnum
from typing import TypedDict

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, kernel, record

# A rate beyond this is no rate: nearly 30,000 times what the fastest gyroscopes measure, in rad/s.
LARGEST_RATE = 1.0e6

# Nor is an acceleration beyond this: ten times the range of accelerometers for impacts, in m/s^2.
LARGEST_ACCELERATION = 2.0e4

# The variance of a value that lies anywhere within a count, in counts squared.
COUNT_VARIANCE = 1.0 / 12.0

# In place of a method's reason: the rate was no usable number, so no method has seen it.
UNUSABLE = -1
# The same of a sample that the filter has started at: nothing was predicted.
STARTED = -2


class Sample(TypedDict):
    """What the sensor measures at one moment."""

    stamp: int  # ns; 0 where the driver does not stamp
    angular_velocity: PerAxis  # rad/s; a value that is no number is bridged by the prediction
    linear_acceleration: PerAxis  # m/s^2; NaN where it is unknown


class SampleStatus(IntEnum):
    """What became of a sample."""

    FILTERED = 0
    REPEATED = 1  # the sample before (same stamp and rates, or polled faster): its result once more
    REFUSED = 2  # no usable rate yet on some axis, so there is no result


class Result(TypedDict):
    """What the filter makes of a sample."""

    status: int  # a SampleStatus
    angular_velocity: PerAxis  # filtered, with the bias subtracted and calibrated, rad/s
    angular_velocity_variance: PerAxis  # (rad/s)^2
    angular_velocity_covariance: PerAxis  # of x and y, x and z, y and z, (rad/s)^2
    innovation: PerAxis  # rad/s
    innovation_variance: PerAxis  # (rad/s)^2, fixed before the sample is seen
    process_noise: PerAxis  # Q, (rad/s)^2
    measurement_noise: PerAxis  # R, (rad/s)^2
    outlier: PerAxis  # 0 or 1
    # why it is one or not: a key of `Method.reasons`, UNUSABLE or STARTED
    reason: CountPerAxis
    # what the size of the innovation was held against, rad/s; 0 where there was no such limit
    innovation_threshold: PerAxis  # by noise: `outlier.threshold`
    least_jump: PerAxis  # by what a body does: `outlier.acceleration`
    bias: PerAxis  # subtracted from the rate, rad/s
    at_rest: float  # 0 or 1


SAMPLE = record(Sample)
RESULT = record(Result)


@kernel
def is_usable(rate: float) -> bool:
    """Tell whether a value in rad/s can be a rate at all."""
    return abs(rate) <= LARGEST_RATE  # False for NaN


@kernel
def smallest_change(resolution: float, change: float) -> float:
    """Return the smaller one of the smallest change so far, `resolution`, and another change.

    Both in the signal's unit; the resolution is 0 before the first change, and a `change` of 0 is
    none.
    """
    if change > 0.0 and (change < resolution or resolution == 0.0):
        return change
    return resolution


@kernel
def is_zero(values: PerAxis) -> bool:
    """Return whether all axes are exactly 0."""
    return bool(values[0] == 0.0 and values[1] == 0.0 and values[2] == 0.0)


@kernel
def are_equal(values: PerAxis, others: PerAxis) -> bool:
    """Return whether all axes have the values of others; a NaN is equal to none."""
    return bool(values[0] == others[0] and values[1] == others[1] and values[2] == others[2])


@kernel
def is_one_value(values: PerAxis) -> bool:
    """Return whether all axes have the same value to the last bit, as where a read has failed.

    It is 0, or another fixed value: -1 count where a driver takes an error code for a value.
    """
    return bool(values[0] == values[1] and values[1] == values[2])
