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

"""What a message filter is like at one moment, for reports: few numbers of a large state."""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate.kernels import kernel
from gyro_drift_filter.accelerate.records import record
from gyro_drift_filter.core import Parameters, methods
from gyro_drift_filter.core.bias.records import bias_variance, has_provisional, wander_variance
from gyro_drift_filter.core.matrices import vector_length
from gyro_drift_filter.core.quantisation import known_count, variance_of_rounding
from gyro_drift_filter.core.rest.noise import deviation_of_values
from gyro_drift_filter.core.sample import is_zero

# One for each axis.
Counts = Annotated[list[int], np.int64, (3,)]
Values = Annotated[list[float], np.float64, (3,)]


class Telemetry(NamedTuple):
    """Values of the filter's state: `read_telemetry` says of which part of it.

    Counts begin anew at each reset; only those of segments are kept, as the bias is. Deviations at
    rest are 0 while the noise is not known.
    """

    # what has come in: counts of messages
    samples: int
    duplicates: int  # those that had come before
    refused: int  # those without a usable rate
    beyond_range: int  # those with a rate that no gyroscope measures: degrees, not radians?
    beyond_gravity: int  # those with an acceleration that no body has for long: counts or mg?
    times_stuck: int
    not_measured: int  # those that repeat a measurement
    samples_per_message: float  # below 1 where a driver asks more often than its sensor measures
    # raw values, by axis or of all
    faults: Counts  # a member of `AxisFault`
    truncated: bool  # counts are cut towards zero
    count_size: Values  # rad/s that a count of the sensor stands for; 0 where no counts are seen
    unusable: Counts  # rates that were no usable number
    clipped: Counts  # samples at the end of the range
    at_limit: Counts  # 1 where the last rate was at the end of the range
    clipped_calibrated: Counts  # 1 where it was clipped before the driver calibrated its rates
    # outliers, and how well samples were predicted
    outliers: Counts
    outlier_reason: Counts  # that of the last outlier, of several in a row that of the first one
    outlier_method: Counts  # the number in `METHODS` of the method that gave this reason
    last_outlier: Counts  # what `samples` was when the last outlier came
    nis_samples: Counts  # that are in the two sums
    nis_sum: Values  # of normalised innovations squared
    residual_sum: Values  # of squared differences between sample and filtered rate, over R
    # the clock
    period: float  # s, from sample to sample
    period_blocks: int  # blocks of stamps that the period was learned from; 0 while it is a guess
    gaps: int
    missing_samples: int
    restarts: int
    zero_stamps: int
    same_stamps: int
    backward_stamps: int
    overtaken: int  # messages that later ones had overtaken, and that were filtered at their place
    stamp: int  # ns, the last one that is not 0
    # the sensor as a whole
    divergences: Counts
    stuck: bool
    all_zero: bool  # the last rates are exactly 0
    accelerometer_hangs: bool
    contradicts_gravity: bool  # rates and accelerations are not of one motion
    # the noise
    process_noise: Values  # (rad/s)^2, of the last sample
    measurement_noise: Values  # (rad/s)^2, of the last sample
    noise_correlation: Values  # of samples one apart
    noise_correlation_two_apart: Values
    noise_blocks: Counts  # blocks that it was learned from
    noise_block_seconds: float  # s, that each of them lasts; 0 where there are none
    rate_deviation_at_rest: Values  # rad/s
    acceleration_deviation_at_rest: Values  # m/s^2
    acceleration_at_rest: float  # m/s^2, its size; 0 in motion
    # the bias at rest
    bias_known: bool
    bias_corrected: bool  # motion alone has shown another bias
    bias_provisional: bool  # the first seconds have shown it, but no rest
    bias: Values  # rad/s
    bias_deviation: Values  # rad/s, with its wander, and what rounding leaves in a mean
    # of the rest under way, or of the last mean of a stand in which the body is shaken: its rate is
    # beyond bias.max
    rest_beyond_max: bool
    at_rest: bool
    rest_obstacle: int  # a member of `Obstacle`: why the last block or segment was no rest
    rest_obstacle_signal: int  # in which signal that showed
    seconds_since_rest: float  # s; since the start where `segments` is 0
    standing_seconds: float  # s, for which gravity has stood since the last rest
    least_rest_seconds: float  # s, that a rest has to last to be found
    segments: int
    segments_beyond_max: int  # such segments, and means of a stand in which the body is shaken
    segments_turning: int  # those with a rate that the bias can not have come to: it has turned

    @property
    def message_period(self) -> float:
        """The time in s from one message to the next, which may repeat a measurement."""
        return self.period * self.samples_per_message

    @property
    def has_stamps(self) -> bool:
        """Whether the driver stamps; only stamps of samples that were measured anew are counted."""
        return self.zero_stamps < max(self.samples - self.not_measured, 1)

    @property
    def first_rest(self) -> int:
        """For how long in whole s the sensor has to stand still until it is found at rest."""
        return math.ceil(self.least_rest_seconds)


TELEMETRY = record(Telemetry)


class MessageReport(NamedTuple):
    """What a message filter is like.

    Attributes:
        received: Messages that have come in.
        malformed: Messages that are no Imu; nothing is published for them.
        last_malformed: What was wrong with the last of these; empty where there was none.
        not_reported: Messages without angular velocity, which are passed on as they came.
        own_outputs: Messages that this filter had published, and does not filter again.
        lost: Messages that never came in, as far as the node knows.
        frame_changes: Messages with another frame_id than the one before.
        frame: The last frame_id, as it can be shown.
        parameters: Those of the filter.
        telemetry: Values of the filter's state.
    """

    received: int
    malformed: int
    last_malformed: str
    not_reported: int
    own_outputs: int
    lost: int
    frame_changes: int
    frame: str
    parameters: Parameters
    telemetry: Telemetry


def as_telemetry(records: NDArray[Any]) -> list[Telemetry]:
    """Return records of TELEMETRY (n,) in Python's own numbers, which it works faster with."""
    columns = (records[name].tolist() for name in Telemetry._fields)
    return list(map(Telemetry._make, zip(*columns, strict=True)))


@kernel
def read_telemetry(filter_: Any, out: Any) -> None:
    """Write the values of a record of FILTER into one of TELEMETRY."""
    state, coefficients = filter_['state'], filter_['coefficients']
    counts, clock, bias, result = state['counts'], state['clock'], state['bias'], state['result']
    checks, quantisation = state['checks'], state['quantisation']
    out['samples'] = counts['samples']
    out['duplicates'] = counts['duplicates']
    out['refused'] = counts['refused']
    out['beyond_range'] = checks['beyond_range']
    out['beyond_gravity'] = checks['beyond_gravity']
    out['times_stuck'] = checks['times_stuck']
    out['not_measured'] = state['polling']['not_measured']
    out['samples_per_message'] = state['polling']['samples_per_message']
    out['truncated'] = quantisation['truncated']
    out['period'] = clock['mean_period']
    out['period_blocks'] = clock['blocks']
    out['gaps'] = clock['gaps']
    out['missing_samples'] = clock['missing_samples']
    out['restarts'] = clock['restarts']
    out['zero_stamps'] = clock['zero_stamps']
    out['same_stamps'] = clock['same_stamps']
    out['backward_stamps'] = clock['backward_stamps']
    out['overtaken'] = clock['overtaken']
    out['stamp'] = clock['stamp']
    out['stuck'] = checks['stuck']
    out['accelerometer_hangs'] = checks['accelerometer_hangs']
    out['contradicts_gravity'] = bias['contradicts']
    out['bias_known'] = bias['known']
    out['bias_corrected'] = bias['corrected'] > 0
    # A zero that the first seconds confirm is the initial bias still.
    out['bias_provisional'] = has_provisional(bias) and not is_zero(bias['bias'])
    out['rest_beyond_max'] = bias['rest_beyond_max'] or bias['shaken_stand']['beyond_max']
    out['at_rest'] = bias['rest']['at_rest']
    x, y, z = bias['rest']['gravity']
    out['acceleration_at_rest'] = vector_length(x, y, z) if bias['rest']['at_rest'] else 0.0
    out['rest_obstacle'] = bias['rest']['obstacle']
    out['rest_obstacle_signal'] = bias['rest']['obstacle_signal']
    out['seconds_since_rest'] = bias['seconds_since_rest']
    out['standing_seconds'] = bias['rest']['standing_seconds']
    out['least_rest_seconds'] = coefficients['rest']['least_rest']
    out['noise_block_seconds'] = methods.noise_block_seconds(filter_)
    out['segments'] = bias['segments']
    out['segments_beyond_max'] = bias['segments_beyond_max']
    out['segments_turning'] = bias['segments_turning']
    out['all_zero'] = True
    for axis in range(3):
        if checks['measured'][axis] != 0.0:
            out['all_zero'] = False
        out['rate_deviation_at_rest'][axis] = deviation_of_values(bias['rest'], axis)
        out['acceleration_deviation_at_rest'][axis] = deviation_of_values(bias['rest'], 3 + axis)
        out['faults'][axis] = checks['fault'][axis]
        out['count_size'][axis] = known_count(quantisation, axis)
        out['unusable'][axis] = checks['unusable'][axis]
        out['clipped'][axis] = checks['range_end']['clipped'][axis]
        out['at_limit'][axis] = checks['range_end']['at_limit'][axis]
        out['clipped_calibrated'][axis] = checks['range_end']['clipped_calibrated'][axis]
        out['outliers'][axis] = counts['outliers'][axis]
        out['outlier_reason'][axis] = counts['outlier_reason'][axis]
        out['outlier_method'][axis] = counts['outlier_method'][axis]
        out['last_outlier'][axis] = counts['last_outlier'][axis]
        out['nis_samples'][axis] = counts['nis_samples'][axis]
        out['nis_sum'][axis] = counts['nis_sum'][axis]
        out['residual_sum'][axis] = counts['residual_sum'][axis]
        out['divergences'][axis] = methods.divergences(filter_, axis)
        out['process_noise'][axis] = result['process_noise'][axis]
        out['measurement_noise'][axis] = result['measurement_noise'][axis]
        blocks, one_apart, two_apart = methods.learned_noise(filter_, axis)
        out['noise_blocks'][axis] = blocks
        out['noise_correlation'][axis] = one_apart
        out['noise_correlation_two_apart'][axis] = two_apart
        out['bias'][axis] = bias['bias'][axis]
        rounding = variance_of_rounding(quantisation, axis, result['measurement_noise'])
        variance = bias_variance(bias, axis) + wander_variance(bias, axis)
        out['bias_deviation'][axis] = math.sqrt(variance + rounding)
