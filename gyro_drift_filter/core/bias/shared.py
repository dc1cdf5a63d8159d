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

"""What is done to the bias at rest and to that in motion together.

The two biases differ by a shift, but most of what moves one moves the other, too. So both are in
one filter, and each rest measures the bias at rest. That corrects the bias in motion as well, and
leaves what motion has shown of the shift. What motion shows of the bias at rest counts in here
alone: `at_rest.py` learns that bias from rests, so that a flight does not change what is subtracted
after the landing.
"""

from gyro_drift_filter.accelerate import PerAxis, kernel
from gyro_drift_filter.core.bias.motion_state import (
    BIAS,
    LARGEST_PRIOR,
    LATER_PRIOR,
    SCALE,
    SCALE_ERROR,
    SPEED,
    STATES,
    UNKNOWN,
    UNKNOWN_PRIOR,
    UNKNOWN_SECONDS,
    MotionBias,
    SharedBias,
    add_bias_process_noise,
    scale_covariances,
    track_all,
    tracks_scale,
    widen_both,
)
from gyro_drift_filter.core.bias.shift import replace_shift, shift_of, shift_variance


@kernel
def start_motion_bias(state: MotionBias, bias: PerAxis, variance: PerAxis) -> None:
    """Begin with the bias at rest (3,) in rad/s and its variance (3,); the shift is kept."""
    bias_at_rest = state['bias_at_rest']
    for axis in range(3):
        i = BIAS + axis
        shift, of_shift = shift_of(state, axis), shift_variance(state, axis)
        for k in range(STATES):
            state['covariance'][i, k] = state['covariance'][k, i] = 0.0
        state['state_vector'][i] = bias[axis] + shift
        state['covariance'][i, i] = variance[axis] + of_shift
        bias_at_rest['bias'][axis] = bias[axis]
        bias_at_rest['variance'][axis] = bias_at_rest['cross_covariance'][axis] = variance[axis]
        bias_at_rest['untracked_variance'][axis] = 0.0
    state['pending_process_noise'] = 0.0
    state['moving_seconds'] = state['vertical_angle'] = state['carried'] = 0.0
    state['moving'] = False
    _start_scale(state, variance)


@kernel
def start_wide_prior(state: MotionBias, bias: PerAxis, variance: PerAxis) -> None:
    """Begin with a bias (3,) in rad/s, all of its variance (3,) tracked and no shift."""
    for axis in range(3):
        replace_shift(state, axis, 0.0, 0.0)
    state['wide'] = True
    start_motion_bias(state, bias, variance)
    state['speed_deviation'] = SPEED
    state['innovation_square'] = 0.0


@kernel
def doubt_wide_prior(state: MotionBias, bias: PerAxis, variance: PerAxis, deviation: float) -> None:
    """Begin anew with a bias (3,) in rad/s, as uncertain as `deviation` in rad/s at least."""
    start_wide_prior(state, bias, variance)
    lacking = deviation * deviation - min(variance[0], variance[1], variance[2])
    state['pending_process_noise'] = max(lacking, 0.0)


@kernel
def _start_scale(state: MotionBias, variance: PerAxis) -> None:
    """Track errors of the scale from where the bias is known, as each would be taken for the other.

    `variance` (3,) is that of the bias, in (rad/s)^2.
    """
    if state['wide'] or tracks_scale(state):
        return
    for axis in range(3):
        if variance[axis] > UNKNOWN * UNKNOWN:
            return
    _expect_any_scale(state)


@kernel
def forget_scale(state: MotionBias) -> None:
    """Forget what is known of the errors of the scale: another sensor measures from now on."""
    if tracks_scale(state):
        _expect_any_scale(state)


@kernel
def _expect_any_scale(state: MotionBias) -> None:
    """Expect the errors of scale and alignment that a factory leaves."""
    vector, covariance = state['state_vector'], state['covariance']
    for i in range(SCALE, STATES):
        vector[i] = 0.0
        for k in range(STATES):
            covariance[i, k] = covariance[k, i] = 0.0
        covariance[i, i] = SCALE_ERROR * SCALE_ERROR


@kernel
def learn_at_rest(state: MotionBias, axis: int, mean: float, noise: float) -> None:
    """Take the mean rate of a rest, in rad/s, with the variance of its noise, in (rad/s)^2, in."""
    add_bias_process_noise(state)
    track_all(state, axis)
    bias_at_rest, i = state['bias_at_rest'], BIAS + axis
    variance = bias_at_rest['variance'][axis]
    cross_covariance = bias_at_rest['cross_covariance'][axis]
    innovation, innovation_variance = mean - bias_at_rest['bias'][axis], variance + noise
    gain, gain_in_motion = variance / innovation_variance, cross_covariance / innovation_variance
    bias_at_rest['bias'][axis] += gain * innovation
    bias_at_rest['variance'][axis] -= gain * variance
    bias_at_rest['cross_covariance'][axis] -= gain * cross_covariance
    state['state_vector'][i] += gain_in_motion * innovation
    left = state['covariance'][i, i] - gain_in_motion * cross_covariance
    # Each axis by itself, as the bias at rest is.
    for k in range(STATES):
        state['covariance'][i, k] = state['covariance'][k, i] = 0.0
    state['covariance'][i, i] = left


@kernel
def keep_shared(state: MotionBias, kept: SharedBias, process_noise: float) -> None:
    """Keep what a segment of rest may change, before it does.

    `process_noise` is that of the bias at rest since the last segment.
    """
    kept['added_process_noise'] = process_noise - state['pending_process_noise']
    for axis in range(3):
        i = BIAS + axis
        kept['bias'][axis] = state['state_vector'][i]
        kept['variance'][axis] = state['covariance'][i, i]
    kept['bias_at_rest'] = state['bias_at_rest']


@kernel
def restore_shared(state: MotionBias, kept: SharedBias, process_noise: float) -> None:
    """Undo what segments of rest have changed since; `process_noise` as for `keep_shared`."""
    state['pending_process_noise'] = process_noise - kept['added_process_noise']
    for axis in range(3):
        i = BIAS + axis
        before = state['covariance'][i, i]
        state['state_vector'][i] = kept['bias'][axis]
        state['covariance'][i, i] = kept['variance'][axis]
        scale_covariances(state, axis, before)
    state['bias_at_rest'] = kept['bias_at_rest']


@kernel
def limit_prior(state: MotionBias) -> None:
    """Leave out of what is tracked in motion what is beyond the largest prior."""
    added = (1.0 - state['untracked_share']) * state['pending_process_noise']
    add_bias_process_noise(state)
    if state['wide']:
        return
    bias_at_rest = state['bias_at_rest']
    for axis in range(3):
        i = BIAS + axis
        # What the bias has just walked, or was left out before, goes with no other state yet.
        correlated = state['covariance'][i, i] - added
        largest_prior = LARGEST_PRIOR
        if state['covariance'][i, i] + bias_at_rest['untracked_variance'][axis] > UNKNOWN * UNKNOWN:
            track_all(state, axis)
            waits = state['moving_seconds'] < UNKNOWN_SECONDS
            largest_prior = UNKNOWN_PRIOR if waits else LATER_PRIOR
        beyond = state['covariance'][i, i] - largest_prior * largest_prior
        beyond = min(beyond, bias_at_rest['cross_covariance'][axis])
        if beyond > 0.0:
            widen_both(state, axis, -beyond)
            bias_at_rest['untracked_variance'][axis] += beyond
        scale_covariances(state, axis, correlated)
