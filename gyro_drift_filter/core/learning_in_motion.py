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

"""What a sample tells of the bias in motion.

That is the rates that `bias/in_motion.py` follows, and how the body may have turned unmeasured.
"""

from gyro_drift_filter.accelerate import inlined_kernel, kernel
from gyro_drift_filter.core import methods
from gyro_drift_filter.core.bias.contradiction import note_contradiction
from gyro_drift_filter.core.bias.in_motion import (
    KNOWN_TURN_SECONDS,
    lose_direction,
    take_unmeasured_turn,
    track_motion,
)
from gyro_drift_filter.core.bias.motion_filter import MotionWorkspace
from gyro_drift_filter.core.bias.motion_state import MotionBias
from gyro_drift_filter.core.bias.records import (
    follows_wide_prior,
    forget_contradiction,
    has_bias,
)
from gyro_drift_filter.core.bias.without_rest import correct_unknown_bias
from gyro_drift_filter.core.polling import message_period
from gyro_drift_filter.core.records import FilterRecord, State
from gyro_drift_filter.core.sample import Sample, SampleStatus, is_usable
from gyro_drift_filter.core.sensor_checks import (
    are_rates_stale,
    equal_rates,
    has_fault,
    may_hang,
)


@inlined_kernel
def learn_in_motion(sample: Sample, missing: int, in_gap: int, filter_: FilterRecord) -> None:
    """Follow the bias in motion by the sample's rates, or the filtered ones of an outlier.

    A rate that a method has flagged for its own lag was measured all the same, if a body can have
    come to it since the sample before.
    """
    state, workspace = filter_['state'], filter_['workspace']['motion']
    bias, result, force = state['bias'], state['result'], sample['linear_acceleration']
    if not bias['motion']['directed'] and not abs(force[0]) + abs(force[1]) + abs(force[2]) > 0.0:
        forget_contradiction(bias)  # there is no accelerometer
        return
    seconds = state['clock']['period'] * (1 + missing)
    largest_change = filter_['settings']['outlier_acceleration'] * seconds
    workspace['sound'], flags_motion = True, methods.flags_motion(filter_)
    for axis in range(3):
        rate = sample['angular_velocity'][axis]
        follows = abs(rate - state['taken'][axis]) <= largest_change  # False for NaN
        if result['outlier'][axis] > 0.0 and not (flags_motion and follows):
            rate = result['angular_velocity'][axis]
            workspace['sound'] = False
        workspace['rate'][axis] = rate
    _note_unmeasured_turn(missing, in_gap, state, workspace)
    _follow(bias['motion'], sample, seconds, filter_)
    faulty = has_fault(state['checks'])  # nobody knows how the body turns about that axis
    if has_bias(bias):
        if faulty:
            forget_contradiction(bias)
        note_contradiction(bias)
    if follows_wide_prior(bias):
        if faulty:
            lose_direction(bias['wide_prior'])
        _follow(bias['wide_prior'], sample, seconds, filter_)
        correct_unknown_bias(bias, filter_['settings']['bias_max'])


@kernel
def _note_unmeasured_turn(
    missing: int, in_gap: int, state: State, workspace: MotionWorkspace
) -> None:
    """Note in the workspace how the body may have turned where nobody has measured it.

    A rate may be beyond the end of its range. In a gap the body has turned at the rate before it or
    behind it, whichever is larger, and over samples that only may be missing at the one behind.
    """
    period, at_limit = state['clock']['period'], state['checks']['range_end']['at_limit']
    fastest = before = clipped = 0.0
    for axis in range(3):
        rate = abs(workspace['rate'][axis])
        fastest = max(fastest, rate)
        if at_limit[axis]:
            clipped = max(clipped, rate)
        if missing > 0 and is_usable(state['taken'][axis]):
            before = max(before, abs(state['taken'][axis]))
    unmeasured = _unmeasured_seconds(state, missing, fastest)
    missed = clipped * period * (1 + missing) + max(before, fastest) * unmeasured
    if period * in_gap > KNOWN_TURN_SECONDS:
        missed += fastest * period * in_gap
    workspace['fastest'], workspace['unmeasured_seconds'] = fastest, unmeasured
    workspace['unmeasured_turn'] = missed


@kernel
def _unmeasured_seconds(state: State, missing: int, fastest: float) -> float:
    """Return for how long (s) a rate has not been measured by now; 0 where that is no time.

    It is no usable number, samples are missing, or a bus hangs that sends the same rates again.
    `fastest` is the largest rate of the sample in rad/s.
    """
    period, coasted, checks = state['clock']['period'], state['coasted'], state['checks']
    lasted = period * (1 + max(coasted[0], coasted[1], coasted[2], missing))
    if not state['bias']['rest']['at_rest'] and are_rates_stale(checks, fastest):
        message = message_period(state['polling'], period)
        lasted = max(lasted, message * (1 + equal_rates(checks)))
    if lasted <= KNOWN_TURN_SECONDS:
        return 0.0
    seconds = period * (1 + missing)
    return float(lasted if lasted - seconds <= KNOWN_TURN_SECONDS else seconds)


@kernel
def _follow(motion: MotionBias, sample: Sample, seconds: float, filter_: FilterRecord) -> None:
    """Update by the workspace's rates."""
    state, workspace = filter_['state'], filter_['workspace']['motion']
    refused = state['result']['status'] == SampleStatus.REFUSED
    if refused or state['clock']['period'] > KNOWN_TURN_SECONDS:
        lose_direction(motion)  # nobody knows how the body turns from one sample to the next
        return
    if may_hang(state['checks']) or state['checks']['accelerometer_hangs']:
        lose_direction(motion)
    if workspace['unmeasured_turn'] > 0.0 or motion['unmeasured_turn'] > 0.0:
        take_unmeasured_turn(motion, workspace)
    rest, lengths = state['bias']['rest'], filter_['coefficients']['rest']
    track_motion(motion, workspace, sample, seconds, rest, lengths)
