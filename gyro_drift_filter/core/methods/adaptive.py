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

"""Method `adaptive`: interacting Kalman filters per axis, from rest to fast motion.

Each mode of the mode set (`mode_set.py`) is a Kalman filter with another Q. How well each predicted
the sample gives its probability (interacting multiple models; Blom and Bar-Shalom, IEEE
Transactions on Automatic Control 33, 1988): the mode probabilities are the adaptive Q. R and the
noise's correlation are learned at rest (`noise.py`). A doubtful sample is held back
(`outliers.py`).

Rates are in rad/s, variances in (rad/s)^2. Acceleration and jerk are angular, in rad/s per sample
and per sample squared. Equation numbers are the paper's.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, kernel, record
from gyro_drift_filter.core.matrices import rotation_terms
from gyro_drift_filter.core.methods.advice import Advice
from gyro_drift_filter.core.methods.mode_set import (
    MODES,
    Derivation,
    ModeSet,
    PerMode,
    Terms,
    Transition,
    Transitions,
    derive_mode_set,
)
from gyro_drift_filter.core.methods.noise import (
    BLOCK_SECONDS,
    FORGETTING_SECONDS,
    LEAST_BLOCK,
    Noise,
    interrupt_block,
    is_begun,
    largest_variance,
    learn_noise,
    restart_block,
    start_noise,
    usual_deviation,
)
from gyro_drift_filter.core.methods.outliers import (
    FIRST_CHANGE,
    JOLT_SAMPLES,
    Circumstances,
    Decision,
    Doubt,
    Jolt,
    OutlierLimits,
    Reason,
    decision_of,
    derive_limits,
    feel_jolt,
    has_returned,
    is_constant,
    judge,
    note_decision,
    note_held,
    note_missing,
    shake_along,
    start_doubt,
    was_jolted,
)
from gyro_drift_filter.core.polling import Polling
from gyro_drift_filter.core.rest import SEGMENT_BLOCKS, Rest, has_stood_still
from gyro_drift_filter.core.sample import Sample, is_usable
from gyro_drift_filter.core.sensor_checks import SensorChecks

if TYPE_CHECKING:
    from gyro_drift_filter.core.settings import Settings

# A mode probability below this is none.
SMALLEST = 1e-300
# What was motion among held samples, and what smoothing has not put out in motion, is given back
# with these time constants, so that the heading holds: the second where it is no more than noise
# makes of it, within so many deviations. As longest_hold bounds the number of held samples, and the
# range of gyroscopes their rate, it is no more than the first angle. The second is more than a
# knock turns a body that stays where it is.
COMPENSATION_SECONDS, SMOOTHING_SECONDS, SMOOTHING_DEVIATIONS = 0.25, 4.0, 3.0
COMPENSATION_SHARE = 1.0 / 16.0  # of the angle, at most, with a sample
LARGEST_COMPENSATION = 2.0  # rad
LARGEST_KNOCK = 0.02  # rad
# The slowest mode averages over so long: a turn that has begun since then may not show yet.
RECENT_SECONDS = 1.0
LEAST_COMPENSATION = 1e-9  # rad: as processors are slow with denormal numbers
# Zeros on all axes are no drop-out where no axis was faster than this, in rad/s: some drivers give
# zeros for slow rates, of one degree a second at most.
LARGEST_DEAD_ZONE = 0.02
REPEAT_CHANGE = 3.0  # standard deviations of the noise: below, a repeat does no harm
PREDICTION_MEMORY = 1.0 / 16.0  # weight of a measurement in how well changes are predicted
# Blocks of samples in a row that have to be still (`rest.py`) for outliers to be judged by noise.
STILL_BLOCKS = 3
# A body may stand, and all its motion have died away, where all rates are this close to those at
# rest, in standard deviations of the noise, and the accelerometer has been calm for as long as a
# hand takes to turn back.
NEAR_REST = 0.7
CALM_SECONDS = 0.15
# Zeros on all axes are a drop-out where they are a surprise on any of them by this many standard
# deviations of the noise, or steps of its resolution. A driver with nothing to report sends zeros;
# so may a robot at rest.
DROPOUT = 3.0

Three = Annotated[NDArray[np.float64], np.float64, (3,)]


class AdaptiveCoefficients(TypedDict):
    """What is derived from settings and sample period; for all axes."""

    period: float  # s
    modes: ModeSet
    limits: OutlierLimits
    calm_samples: int
    block_samples: int
    block_forgetting: float  # b of equation (13), from block to block of noise


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
    sample_accepted: bool  # whether the last sample was
    accepted: float  # the last sample that was, rad/s
    noise: Noise
    doubt: Doubt
    jolt: Jolt  # of the accelerometer along the same axis
    knocked: bool  # a jolt was felt while samples were held back
    held_angle: float  # rad, what the held samples turned beyond what was put out
    recent_angle: float  # rad, that was smoothed away of late while the sensor seemed to stand
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
    error: PerMode  # variance that the noise leaves in the rate of each mode after the sample
    of_noise: Three  # variance, roughness and correlation that these four belong to
    # What the mixing moves: probability, and by it rate, acceleration and jerk. What each mode
    # holds before, and what arrives in it.
    held: Terms
    from_below: Terms
    from_above: Terms
    # terms of sums over the modes
    means: PerMode
    squares: PerMode
    others: PerMode
    prediction: float  # of the sample by all modes together
    prediction_variance: float  # of the innovation
    typical_innovation: float  # rad/s, by which outliers are judged
    reason: int  # of the decision on the sample: a member of Reason
    accepted: float  # the sample that was accepted before it, rad/s
    returned: bool  # it lies there again, after one that was held back
    at_limit: bool  # the rate is at the end of the range


ADAPTIVE_COEFFICIENTS = record(AdaptiveCoefficients, in_cache_lines=True)
ADAPTIVE_AXIS = record(AdaptiveAxis, in_cache_lines=True)
ADAPTIVE_AXIS_WORKSPACE = record(AdaptiveAxisWorkspace, in_cache_lines=True)


class AdaptiveWorkspace(TypedDict):
    """What all axes need between prediction and estimate."""

    axes: Annotated[Sequence[AdaptiveAxisWorkspace], ADAPTIVE_AXIS_WORKSPACE, (3,)]
    circumstances: Circumstances
    derivation: Derivation


ADAPTIVE_WORKSPACE = record(AdaptiveWorkspace, in_cache_lines=True)


@kernel
def derive(
    settings: 'Settings',
    period: float,
    coefficients: AdaptiveCoefficients,
    workspace: AdaptiveWorkspace,
) -> None:
    """Fill the coefficients for a sample period in s.

    The forgetting factor is for `FORGETTING_SECONDS`.
    """
    coefficients['period'] = period
    derive_mode_set(period, coefficients['modes'], workspace['derivation'])
    derive_limits(settings, period, coefficients['limits'])
    coefficients['calm_samples'] = max(JOLT_SAMPLES, int(CALM_SECONDS / period + 0.5))
    samples = max(LEAST_BLOCK, int(BLOCK_SECONDS / period))
    coefficients['block_samples'] = samples
    exponent = BLOCK_SECONDS / FORGETTING_SECONDS
    coefficients['block_forgetting'] = settings['forgetting_factor'] ** exponent
    for axis in range(3):
        workspace['axes'][axis]['of_noise'][0] = 0.0  # the variances are of other modes


@kernel
def start(state: AdaptiveAxis, settings: 'Settings', axis: int, rate: float) -> None:
    """Start at a rate: nothing is known but that the true one is near it.

    What was learned of the noise is kept; before that it is what the settings say.
    """
    if not state['learning']:
        deviation, phi = settings['model_noise_deviation'][axis], settings['model_phi'][axis]
        start_noise(state['noise'], deviation, phi)
        state['jolt']['usual_change'] = FIRST_CHANGE
        state['learning'] = True
    restart_block(state['noise'])
    _put_modes_at(state, rate)
    _make_certain(state, MODES - 1)
    state['held_angle'] = 0.0
    state['recent_angle'] = 0.0
    state['compensation'] = 0.0
    state['knocked'] = False
    state['bridge']['samples'] = 0
    state['bridge']['behind'] = False
    state['sample_accepted'] = False
    state['accepted'] = rate
    start_doubt(state['doubt'], rate)


@kernel
def start_over(state: AdaptiveAxis) -> None:
    """Forget what was learned of the noise, before `start`."""
    state['learning'] = False


@kernel
def _put_modes_at(state: AdaptiveAxis, rate: float) -> None:
    """Start all modes at a rate."""
    rates, acceleration, jerk = state['rate'], state['acceleration'], state['jerk']
    for j in range(MODES):
        rates[j] = rate
        acceleration[j] = 0.0
        jerk[j] = 0.0
    state['doubt']['held'] = 0
    state['doubt']['unseen'] = 0
    state['doubt']['agreeing'] = 0


@kernel
def _make_certain(state: AdaptiveAxis, mode: int) -> None:
    """Give nearly all probability to one mode."""
    probability = state['probability']
    for j in range(MODES):
        probability[j] = 1e-9
    probability[mode] = 1.0


@kernel
def make_equally_likely(state: AdaptiveAxis) -> None:
    """Leave it to the next sample which mode holds, after `start` at a rate."""
    probability = state['probability']
    for j in range(MODES):
        probability[j] = 1.0 / MODES


@kernel
def change_model(state: AdaptiveAxis, before: 'Settings', after: 'Settings', axis: int) -> None:
    """Start the noise anew where other settings give it."""
    deviation = after['model_noise_deviation'][axis]
    if deviation != 0.0 and deviation != before['model_noise_deviation'][axis]:
        start_noise(state['noise'], deviation, after['model_phi'][axis])


@kernel
def change_period(state: AdaptiveAxis, periods: float) -> None:
    """Get ready for gains of a sample period of `periods` old ones.

    Acceleration and jerk are per sample. They have followed the samples, and it is the clock that
    has learned late how far these lie apart. But with a shorter period the gains are smaller, and
    what the larger ones have learned is noisier than they expect, so that it shrinks.
    """
    if periods < 1.0:
        acceleration, jerk = state['acceleration'], state['jerk']
        for j in range(MODES):
            acceleration[j] *= periods
            jerk[j] *= periods * periods


@kernel
def predict(state: AdaptiveAxis, workspace: AdaptiveWorkspace, axis: int, modes: ModeSet) -> None:
    """Predict the next sample, into the workspace: each mode, and all together."""
    own = workspace['axes'][axis]
    transitions = modes['transitions'][workspace['circumstances']['transition']]
    _mix(state, own, transitions, modes['up_further'])
    _predict_modes(state, own, modes)


@kernel
def coast(state: AdaptiveAxis, workspace: AdaptiveWorkspace, axis: int, modes: ModeSet) -> None:
    """Pass over a sample that is missing or no number: the prediction is the state then."""
    predict(state, workspace, axis, modes)
    own = workspace['axes'][axis]
    _take_prediction(state, own)
    state['sample_accepted'] = False
    note_missing(state['doubt'], own['typical_innovation'])
    interrupt_block(state['noise'])


@kernel
def _take_prediction(state: AdaptiveAxis, workspace: AdaptiveAxisWorkspace) -> None:
    """Take the prediction for the state."""
    probability, rate = state['probability'], state['rate']
    acceleration, jerk = state['acceleration'], state['jerk']
    prior, predicted_rate = workspace['prior'], workspace['rate']
    predicted_acceleration, predicted_jerk = workspace['acceleration'], workspace['jerk']
    for j in range(MODES):
        probability[j] = prior[j]
        rate[j] = predicted_rate[j]
        acceleration[j] = predicted_acceleration[j]
        jerk[j] = predicted_jerk[j]


@kernel
def look_around(
    axes: Sequence[AdaptiveAxis],
    workspace: AdaptiveWorkspace,
    tracking: CountPerAxis,
    sample: Sample,
    rest: Rest,
    filtered: PerAxis,
    bias: PerAxis,
    calm_samples: int,
) -> None:
    """Look at the accelerometer and at all axes together, before the prediction of a sample.

    A body may stand where the accelerometer has been calm for `calm_samples`, and the rates that
    were filtered last are about the bias at rest (both (3,) in rad/s).
    """
    circumstances, shake, force = workspace['circumstances'], 0.0, sample['linear_acceleration']
    # Zeros on all axes are of a driver that has nothing to report, or of no accelerometer.
    measured = not (force[0] == 0.0 and force[1] == 0.0 and force[2] == 0.0)
    still = has_stood_still(rest, STILL_BLOCKS)
    jolted = jolted_before = False
    shaken, settling = False, True
    for axis in range(3):
        if not tracking[axis]:
            continue
        jolt, rate = axes[axis]['jolt'], filtered[axis] - bias[axis]
        if feel_jolt(jolt, force[axis] if measured else np.nan):
            jolted = True
        if was_jolted(jolt):
            jolted_before = True
        change = shake_along(jolt, still)
        shake += change * change
        shaken = shaken or jolt['calm_samples'] < JOLT_SAMPLES
        calm = jolt['calm_samples'] >= calm_samples
        near = NEAR_REST * NEAR_REST * axes[axis]['noise']['variance']
        settling = settling and calm and rate * rate < near
    circumstances['jolted'] = jolted
    circumstances['jolted_before'] = jolted_before
    circumstances['shake'] = math.sqrt(shake)
    circumstances['still'] = still
    circumstances['at_rest'] = has_stood_still(rest, SEGMENT_BLOCKS)
    transition = Transition.SETTLING if settling else Transition.MOVING
    circumstances['transition'] = Transition.SHAKEN if shaken else transition


@kernel
def compare_axes(
    axes: Sequence[AdaptiveAxis],
    workspace: AdaptiveWorkspace,
    tracking: CountPerAxis,
    checks: SensorChecks,
    polling: Polling,
    sample: Sample,
    settings: 'Settings',
    period: float,
) -> None:
    """Look at the rates of all axes together, between prediction and update."""
    rate, circumstances = sample['angular_velocity'], workspace['circumstances']
    surprised = turned = fast = False
    _turn_compensation(axes, period)
    for axis in range(3):
        state, own = axes[axis], workspace['axes'][axis]
        own['at_limit'] = checks['at_limit'][axis]
        if not tracking[axis]:
            continue
        if is_usable(rate[axis]) and _surprises(state, own, rate[axis]):
            surprised = True
        if abs(state['accepted']) > LARGEST_DEAD_ZONE:
            fast = True
        if polling['bridged'] and _has_turned(state, own, rate[axis]):
            turned = True
    measured = checks['measured']
    all_zero = measured[0] == 0.0 and measured[1] == 0.0 and measured[2] == 0.0
    circumstances['dropout'] = all_zero and fast and surprised and settings['outlier_enabled']
    repeated = polling['bridged'] and turned and not circumstances['still']
    circumstances['repeated'] = repeated and not circumstances['dropout']
    circumstances['polled'] = polling['not_measured'] > 0


@kernel
def _turn_compensation(axes: Sequence[AdaptiveAxis], period: float) -> None:
    """Turn the angles that are still to be given back against the body, over a period in s.

    They belong to an orientation of the past, and stay what they are only in a frame that does not
    turn. The rotation is that of the last sample (Rodrigues).
    """
    x, y, z = axes[0]['compensation'], axes[1]['compensation'], axes[2]['compensation']
    if x == 0.0 and y == 0.0 and z == 0.0:
        return
    a, b = axes[0]['accepted'] * period, axes[1]['accepted'] * period
    c = axes[2]['accepted'] * period
    along, square = a * x + b * y + c * z, a * a + b * b + c * c
    across, within = rotation_terms(square)
    axes[0]['compensation'] = x - across * (b * z - c * y) + within * (a * along - x * square)
    axes[1]['compensation'] = y - across * (c * x - a * z) + within * (b * along - y * square)
    axes[2]['compensation'] = z - across * (a * y - b * x) + within * (c * along - z * square)


@kernel
def _has_turned(state: AdaptiveAxis, workspace: AdaptiveAxisWorkspace, sample: float) -> bool:
    """Return whether more was predicted to change since the sample before than noise would."""
    change, noise = abs(sample - workspace['prediction']), state['noise']
    return bool(is_begun(noise) and change > REPEAT_CHANGE * usual_deviation(noise))


@kernel
def _surprises(state: AdaptiveAxis, workspace: AdaptiveAxisWorkspace, sample: float) -> bool:
    """Return whether a sample is far from its prediction and from the one before."""
    noise = state['noise']
    surprise = min(abs(sample - workspace['prediction']), abs(sample - state['accepted']))
    usual = DROPOUT * usual_deviation(noise)
    return bool(is_begun(noise) and surprise > max(usual, workspace['typical_innovation']))


@kernel
def innovation_variance(workspace: AdaptiveAxisWorkspace) -> float:
    """Return the variance of the innovation to come."""
    return workspace['prediction_variance']


@kernel
def update(
    state: AdaptiveAxis,
    workspace: AdaptiveWorkspace,
    axis: int,
    coefficients: AdaptiveCoefficients,
    sample: float,
) -> tuple[float, bool]:
    """Take a sample (rad/s) in after its prediction.

    Returns:
        The innovation in rad/s, and whether the sample was held back.
    """
    own, circumstances = workspace['axes'][axis], workspace['circumstances']
    doubt, noise, limits = state['doubt'], state['noise'], coefficients['limits']
    prediction, typical = own['prediction'], own['typical_innovation']
    dropout, accepted = circumstances['dropout'], state['accepted']
    reason = judge(doubt, sample, prediction, accepted, typical, circumstances, limits)
    # After the judgement, which it overrules: it has to see every sample.
    constant = is_constant(doubt, sample, noise['variance'])
    if constant:
        reason = Reason.CONSTANT
    elif circumstances['repeated'] and doubt['unseen'] < limits['longest_hold']:
        reason = Reason.REPEATED
    elif own['at_limit'] and _is_behind(sample, prediction, typical):
        reason = Reason.AT_LIMIT
    decision = decision_of(reason)
    own['reason'] = reason
    own['accepted'] = accepted
    own['returned'] = doubt['held'] > 0 and has_returned(doubt, sample, accepted)
    if decision == Decision.HOLD or decision == Decision.BRIDGE:
        if decision == Decision.HOLD:
            note_held(doubt, sample, prediction, typical, dropout, limits)
        else:
            note_missing(doubt, typical)
        _take_prediction(state, own)
        _stay_within_reach(state, limits['growth_limit'] * doubt['held'])
    elif constant or decision != Decision.ACCEPT:
        _put_modes_at(state, sample)
        doubt['before_restart'] = accepted
        if decision == Decision.START_ANEW:
            jump = abs(sample - prediction)
            _make_certain(state, _mode_of(jump, noise['variance'], coefficients['modes']))
        elif decision == Decision.PASS:
            _make_certain(state, MODES - 1)
            note_missing(doubt, typical)  # what the true rate is was not measured
    else:
        steps = 1.0 + doubt['held']
        doubt['held'] = 0
        doubt['unseen'] = 0
        _correct(state, own, sample, steps, coefficients['modes'])
    doubt['last_sample'] = sample
    note_decision(doubt, sample - prediction, decision == Decision.HOLD and not dropout)
    taken = decision == Decision.ACCEPT or decision == Decision.START_ANEW
    if taken and circumstances['polled']:
        _note_prediction(state['bridge'], prediction - accepted, sample - accepted)
    state['sample_accepted'] = taken
    if taken or decision == Decision.PASS:
        state['accepted'] = sample
    if decision == Decision.ACCEPT:
        length, forgetting = coefficients['block_samples'], coefficients['block_forgetting']
        at_rest, period = circumstances['at_rest'], coefficients['period']
        learn_noise(noise, sample, at_rest, period, length, forgetting)
    elif decision == Decision.START_ANEW:
        restart_block(noise)
    else:
        interrupt_block(noise)
    return sample - prediction, decision == Decision.HOLD


@kernel
def _is_behind(sample: float, prediction: float, typical_innovation: float) -> bool:
    """Return whether a rate is no larger than its prediction, as at the end of the range."""
    size = sample if sample > 0.0 else -sample
    predicted = prediction if sample > 0.0 else -prediction
    return bool(predicted >= size - typical_innovation)


@kernel
def _compensate(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    circumstances: Circumstances,
    sample: float,
    rate: float,
    period: float,
) -> float:
    """Return what to add to the estimate, in rad/s, for what the sensor turned unseen before.

    That is what was held back, where a later sample confirmed it or the accelerometer felt a knock;
    what was bridged; and what was smoothed away in motion. Sample and estimate in rad/s, period in
    s.
    """
    decision, returned, missed = decision_of(workspace['reason']), workspace['returned'], 0.0
    if decision == Decision.HOLD:
        # What has come back was an outlier; or a knock, which turns a body by a small angle.
        small = state['knocked'] and abs(state['held_angle']) <= LARGEST_KNOCK
        if returned and not small:
            state['held_angle'] = 0.0
        state['held_angle'] += (sample - rate) * period
        state['knocked'] = state['knocked'] or circumstances['jolted']
    elif state['held_angle'] != 0.0 and decision != Decision.BRIDGE:
        largest = LARGEST_KNOCK if state['knocked'] else 0.0
        if (decision == Decision.START_ANEW or decision == Decision.PASS) and not returned:
            largest = LARGEST_COMPENSATION
        if abs(state['held_angle']) <= largest:
            missed = state['held_angle']
        state['held_angle'] = 0.0
        state['knocked'] = False
    missed += _cross_bridge(state['bridge'], workspace, sample, rate) * period
    if decision == Decision.ACCEPT:
        # A motion is seen only when a block of samples has shown it: what was smoothed away since
        # it began was motion, too.
        recent = state['recent_angle'] + (sample - rate) * period
        if circumstances['still']:
            state['recent_angle'] = _without_denormal(recent * (1.0 - period / RECENT_SECONDS))
        else:
            missed += recent
            state['recent_angle'] = 0.0
    angle = state['compensation'] + missed
    if angle == 0.0:
        state['compensation'] = 0.0
        return 0.0
    angle = _without_denormal(min(max(angle, -LARGEST_COMPENSATION), LARGEST_COMPENSATION))
    noise = state['noise']['variance'] * 0.5 * period * SMOOTHING_SECONDS
    small = angle * angle < SMOOTHING_DEVIATIONS * SMOOTHING_DEVIATIONS * noise
    seconds = SMOOTHING_SECONDS if small else COMPENSATION_SECONDS
    now = angle * min(period / seconds, COMPENSATION_SHARE)
    state['compensation'] = angle - now
    return float(now / period)


@kernel
def _without_denormal(angle: float) -> float:
    """Return an angle in rad, or none where it is too small for anything."""
    return 0.0 if abs(angle) < LEAST_COMPENSATION else angle


@kernel
def _stay_within_reach(state: AdaptiveAxis, reach: float) -> None:
    """Keep an extrapolation within `reach` (rad/s) of the last sample that was accepted."""
    rate, accepted = state['rate'], state['accepted']
    for j in range(MODES):
        rate[j] = min(max(rate[j], accepted - reach), accepted + reach)


@kernel
def estimate(
    state: AdaptiveAxis,
    workspace: AdaptiveWorkspace,
    axis: int,
    modes: ModeSet,
    sample: float,
    period: float,
) -> tuple[float, float, float, float]:
    """Return rate in rad/s, its variance, Q in place of (17), and R.

    `sample` in rad/s is NaN where there is none, `period` in s.
    """
    own = workspace['axes'][axis]
    circumstances = workspace['circumstances']
    at_rest = circumstances['at_rest']
    rate, variance, process_noise = _combine_modes(state, own, modes, at_rest)
    # Without a sample there was no decision: what stands there is of an earlier one.
    measured = sample == sample
    if measured and decision_of(own['reason']) == Decision.BRIDGE:
        rate = own['accepted'] + _predictable(state['bridge']) * (rate - own['accepted'])
    if measured and not circumstances['dropout']:
        rate += _compensate(state, own, circumstances, sample, rate, period)
    return rate, variance, process_noise, state['noise']['variance']


@kernel
def _note_prediction(bridge: Bridge, predicted: float, measured: float) -> None:
    """Note a change that was predicted and measured, in rad/s."""
    square, product = predicted * predicted, predicted * measured
    bridge['predicted_square'] += PREDICTION_MEMORY * (square - bridge['predicted_square'])
    bridge['predicted_product'] += PREDICTION_MEMORY * (product - bridge['predicted_product'])


@kernel
def _predictable(bridge: Bridge) -> float:
    """Return the share of a predicted change that comes true, between 0 and 1.

    It is the regression of what was measured on what was predicted.
    """
    square, product = bridge['predicted_square'], bridge['predicted_product']
    return float(min(max(product / square, 0.0), 1.0)) if square > 0.0 else 1.0


@kernel
def _cross_bridge(
    bridge: Bridge, workspace: AdaptiveAxisWorkspace, sample: float, put_out: float
) -> float:
    """Return what repeated samples turned beyond what was put out, in rad/s times samples.

    It shows with the second sample after them, by the cubic that has the rates and the slopes at
    both ends. `sample` and what is put out for it are in rad/s.
    """
    decision, accepted = decision_of(workspace['reason']), workspace['accepted']
    repeated, turned = decision == Decision.BRIDGE, 0.0
    if bridge['behind']:
        slope = _predictable(bridge) * (sample - accepted)
        slope = bridge['slope_before'] if repeated else slope
        turned = _turned_beyond(bridge, accepted, slope)
    if repeated and (bridge['samples'] == 0 or bridge['behind']):
        bridge['samples'] = 0
        bridge['angular_velocity'] = 0.0
        bridge['before'] = accepted
        bridge['slope_before'] = _predictable(bridge) * (workspace['prediction'] - accepted)
    elif bridge['behind'] or decision == Decision.HOLD:
        bridge['samples'] = 0
    if repeated:
        bridge['samples'] += 1
        bridge['angular_velocity'] += put_out
    bridge['behind'] = not repeated and bridge['samples'] > 0
    return turned


@kernel
def _turned_beyond(bridge: Bridge, after: float, slope_after: float) -> float:
    """Return what `_cross_bridge` does, for the rate after the bridge and the slope there.

    In rad/s and rad/s per sample.
    """
    intervals = bridge['samples'] + 1.0
    curve = (bridge['slope_before'] - slope_after) * intervals * intervals / 12.0
    mean = 0.5 * (bridge['before'] + after)
    return float(bridge['samples'] * mean + curve - bridge['angular_velocity'])


@kernel
def _combine_modes(
    state: AdaptiveAxis, workspace: AdaptiveAxisWorkspace, modes: ModeSet, at_rest: bool
) -> tuple[float, float, float]:
    """Return what the modes say together: rate, its variance, and Q."""
    probability, rate = state['probability'], state['rate']
    means, squares, others = workspace['means'], workspace['squares'], workspace['others']
    error, lag, ratio = workspace['error'], modes['unseen_lag'], modes['innovation_ratio']
    process = modes['process_ratio']
    noise = state['noise']['variance']
    # The error of an extrapolation grows about as the number of samples.
    growth = noise * state['doubt']['held'] * state['doubt']['held']
    # At rest nothing lags, and what the modes differ by is noise, which their errors count already.
    unseen, apart = (0.0, 0.0) if at_rest else (noise, 1.0)
    origin = rate[MODES - 1]
    for j in range(MODES):
        distance = rate[j] - origin
        own = error[j] + lag[j] * unseen if growth == 0.0 else (ratio[j] - 1.0) * growth
        means[j] = probability[j] * distance
        spread = distance * distance
        squares[j] = probability[j] * (max(own, spread) + apart * min(own, spread))
        others[j] = probability[j] * process[j]
    mean = _sum(means)
    variance = max(_sum(squares) - mean * mean, error[0])
    return origin + mean, variance, _sum(others) * noise


# The loops below are cut so that compilers turn them into vector instructions: what can be done in
# each mode apart from what goes from mode to mode, and sums by `_sum`.


@kernel
def _sum(values: PerMode) -> float:
    """Return the sum over the modes: four sums side by side, as each waits for its last term."""
    a = b = c = d = 0.0
    for j in range(0, MODES, 4):
        a += values[j]
        b += values[j + 1]
        c += values[j + 2]
        d += values[j + 3]
    return (a + b) + (c + d)


@kernel
def _largest(values: PerMode) -> float:
    """Return the largest value over the modes, as `_sum` does."""
    a = b = c = d = values[0]
    for j in range(0, MODES, 4):
        a = max(a, values[j])
        b = max(b, values[j + 1])
        c = max(c, values[j + 2])
        d = max(d, values[j + 3])
    largest: float = max(max(a, b), max(c, d))
    return largest


@kernel
def _mix(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    transitions: Transitions,
    up_further: PerMode,
) -> None:
    """Multiply by the transition matrix: the mixing step of interacting models.

    Each mode passes on a share of its probability upwards and one downwards, which end with
    falling probability in one of the modes beyond. One pass each way does it, as the shares are
    geometric. What arrives in a mode is averaged into its state. Leaves the mixed states and the
    prior in the workspace.
    """
    probability, prior = state['probability'], workspace['prior']
    rate, acceleration, jerk = state['rate'], state['acceleration'], state['jerk']
    mixed_rate, mixed_acceleration = workspace['rate'], workspace['acceleration']
    mixed_jerk, held = workspace['jerk'], workspace['held']
    from_below, from_above = workspace['from_below'], workspace['from_above']
    stay, up_first = transitions['stay'], transitions['up_first']
    down_first, down_further = transitions['down_first'], transitions['down_further']
    for j in range(MODES):
        weight = probability[j]
        held[j, 0] = weight
        held[j, 1] = weight * rate[j]
        held[j, 2] = weight * acceleration[j]
        held[j, 3] = weight * jerk[j]
    up = up_rate = up_acceleration = up_jerk = 0.0
    down = down_rate = down_acceleration = down_jerk = 0.0
    for i in range(1, MODES):
        # Both ways at once, as each waits for its last step: to i from below and to k from above.
        first, further = up_first[i - 1], up_further[i]
        up = up * further + held[i - 1, 0] * first
        up_rate = up_rate * further + held[i - 1, 1] * first
        up_acceleration = up_acceleration * further + held[i - 1, 2] * first
        up_jerk = up_jerk * further + held[i - 1, 3] * first
        from_below[i, 0] = up
        from_below[i, 1] = up_rate
        from_below[i, 2] = up_acceleration
        from_below[i, 3] = up_jerk
        k = MODES - 1 - i
        down = down * down_further[k, 0] + held[k + 1, 0] * down_first[k + 1, 0]
        down_rate = down_rate * down_further[k, 1] + held[k + 1, 1] * down_first[k + 1, 1]
        down_acceleration = (
            down_acceleration * down_further[k, 2] + held[k + 1, 2] * down_first[k + 1, 2]
        )
        down_jerk = down_jerk * down_further[k, 3] + held[k + 1, 3] * down_first[k + 1, 3]
        from_above[k, 0] = down
        from_above[k, 1] = down_rate
        from_above[k, 2] = down_acceleration
        from_above[k, 3] = down_jerk
    for j in range(MODES):
        prior[j] = held[j, 0] * stay[j] + from_below[j, 0] + from_above[j, 0]
        share = 1.0 / max(prior[j], SMALLEST)
        mixed_rate[j] = (held[j, 1] * stay[j] + from_below[j, 1] + from_above[j, 1]) * share
        mixed_acceleration[j] = (held[j, 2] * stay[j] + from_below[j, 2] + from_above[j, 2]) * share
        mixed_jerk[j] = (held[j, 3] * stay[j] + from_below[j, 3] + from_above[j, 3]) * share


@kernel
def _predict_modes(state: AdaptiveAxis, workspace: AdaptiveAxisWorkspace, modes: ModeSet) -> None:
    """Predict the sample with each mode, equation (7), and all together: mean and variance.

    The innovation of a mode is the sample less the predicted rate and less the noise that the last
    residual predicts, correlation * residual: this makes the innovations of a slow mode white
    although the sensor's noise is not.
    """
    rate, acceleration, jerk = workspace['rate'], workspace['acceleration'], workspace['jerk']
    expected, variance = workspace['expected'], workspace['variance']
    means, squares, others = workspace['means'], workspace['squares'], workspace['others']
    prior, noise = workspace['prior'], state['noise']
    lag_ratio, logarithm = modes['lag_ratio'], modes['innovation_logarithm']
    correlation = noise['correlation'] if state['sample_accepted'] else 0.0
    of_noise = workspace['of_noise']
    if (
        of_noise[0] != noise['variance']
        or of_noise[1] != noise['roughness']
        or of_noise[2] != correlation
    ):
        _predict_variances(noise, correlation, workspace, modes)
    sample = state['doubt']['last_sample']
    # Mean and variance by one pass, from the fastest mode, which is never far off.
    origin = rate[MODES - 1]
    for j in range(MODES):
        predicted_noise = correlation * (sample - rate[j])
        rate[j] += acceleration[j]
        expected[j] = rate[j] + predicted_noise
        acceleration[j] = lag_ratio[j] * acceleration[j] + jerk[j]
        jerk[j] *= lag_ratio[j]
        distance = expected[j] - origin
        means[j] = prior[j] * distance
        squares[j] = prior[j] * (variance[j] + distance * distance)
        others[j] = prior[j] * logarithm[j]
    mean = _sum(means)
    workspace['prediction'] = origin + mean
    workspace['prediction_variance'] = max(_sum(squares) - mean * mean, variance[0])
    # The geometric mean is not blown up by the small chance of a fast mode.
    workspace['typical_innovation'] = math.sqrt(noise['variance'] * math.exp(_sum(others)))


@kernel
def _predict_variances(
    noise: Noise, correlation: float, workspace: AdaptiveAxisWorkspace, modes: ModeSet
) -> None:
    """Write the variance of each mode's innovation, and of the error that noise leaves in its rate.

    With gain K the last residual holds 1 - K of the noise, so knowing it takes
    (correlation * (1 - K)) ** 2 off the variance. A fast mode sees less noise, as far as its own
    prediction follows the noise: from all of it at K = 0 to `roughness` at K = 1.

    Averages of correlated noise err more: by what AR(1) noise leaves in an exponential average of
    the same gain, relative to white noise, within 5 % for the modes.
    """
    variance, of_noise = workspace['variance'], workspace['of_noise']
    half_precision, density = workspace['half_precision'], workspace['density']
    gain, ratio = modes['gain_rate'], modes['innovation_ratio']
    of_noise[0] = noise['variance']
    of_noise[1] = noise['roughness']
    of_noise[2] = correlation
    error, noise_ratio = workspace['error'], modes['noise_ratio']
    whole, alike = largest_variance(noise), noise['correlation']
    for j in range(MODES):
        left = 1.0 - gain[j]
        rough = noise['roughness'] + (1.0 - noise['roughness']) * left
        known = correlation * left
        variance[j] = noise['variance'] * (ratio[j] * rough - known * known)
        half_precision[j] = 0.5 / variance[j]
        density[j] = math.sqrt(half_precision[j])
        error[j] = whole * noise_ratio[j] * (1.0 + alike * left) / (1.0 - alike * left)


@kernel
def _correct(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    sample: float,
    steps: float,
    modes: ModeSet,
) -> None:
    """Correct each mode, equations (10) and (11), and weigh the modes by their likelihood.

    `steps` is the number of samples since the last one that was accepted: the innovation has built
    up over all of them, and gains for one step would overshoot in acceleration and jerk.
    """
    probability, prior = state['probability'], workspace['prior']
    rate, acceleration, jerk = state['rate'], state['acceleration'], state['jerk']
    predicted_rate, predicted_acceleration = workspace['rate'], workspace['acceleration']
    predicted_jerk, expected = workspace['jerk'], workspace['expected']
    gain_rate, gain_acceleration = modes['gain_rate'], modes['gain_acceleration']
    gain_jerk = modes['gain_jerk']
    half_precision, density = workspace['half_precision'], workspace['density']
    least = modes['least_probability']
    share = 1.0 / steps
    for j in range(MODES):
        innovation = sample - predicted_rate[j]
        rate[j] = predicted_rate[j] + gain_rate[j] * innovation
        acceleration[j] = predicted_acceleration[j] + gain_acceleration[j] * innovation * share
        jerk[j] = predicted_jerk[j] + gain_jerk[j] * innovation * (share * share)
        surprise = sample - expected[j]
        probability[j] = -(surprise * surprise * half_precision[j])
    largest = _largest(probability)
    for j in range(MODES):
        probability[j] = prior[j] * density[j] * _exponential(probability[j] - largest)
    whole = 1.0 / _sum(probability)
    for j in range(MODES):
        probability[j] = max(probability[j] * whole, least[j])


@kernel
def _exponential(exponent: float) -> float:
    """Return exp(exponent), or that of the nearest of -80 to 0, within 1e-7 of it from -10 on.

    By its series for a 128th of it, and seven squares. Unlike `math.exp` it can be a vector
    instruction.
    """
    x = min(max(exponent, -80.0), 0.0) * (1.0 / 128.0)
    square = x * x
    root = (1.0 + x) + square * (0.5 + x * (1.0 / 6.0))
    root += square * square * (1.0 / 24.0 + x * (1.0 / 120.0))
    root *= root
    root *= root
    root *= root
    root *= root
    root *= root
    root *= root
    return root * root


@kernel
def _mode_of(size: float, variance: float, modes: ModeSet) -> int:
    """Return the slowest mode to which a jump of this size (rad/s) is nothing special."""
    ratio = modes['innovation_ratio']
    mode = MODES - 1
    while mode > 0 and ratio[mode - 1] * variance > size * size:
        mode -= 1
    return mode


ADVICE = Advice(
    outliers='look at the raw rates; raise outlier.threshold or outlier.acceleration',
    large_innovations='is it a vibration? Leave it at rest for a second so that it learns its '
    'noise, or set model.noise_deviation',
    small_innovations='set model.noise_deviation lower, or to 0',
    learns_noise=True,
)
