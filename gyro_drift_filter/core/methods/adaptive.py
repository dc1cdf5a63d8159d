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

The modes of the mode set (`mode_set.py`) are Kalman filters that weigh each other's predictions
(`interacting.py`). R and the noise's correlation are learned at rest (`noise.py`). A doubtful
sample is held back (`outliers.py`), unless the accelerometer explains it (`jolts.py`); if it was
motion after all, what it turned is given back (`compensation.py`). What the accelerometer and all
axes together say of a sample is in `circumstances.py`, what is remembered of held samples in
`doubt.py`, the limits are in `outlier_limits.py`, and the records of an axis in `adaptive_axis.py`.
Each decision has a reason (`reasons.py`).

Rates are in rad/s, variances in (rad/s)^2. Acceleration and jerk are angular, in rad/s per sample
and per sample squared. Equation numbers are the paper's.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, TypedDict

import numpy as np

from gyro_drift_filter.accelerate import kernel, record
from gyro_drift_filter.core.methods.adaptive_axis import (
    ADAPTIVE_AXIS_WORKSPACE,
    AdaptiveAxis,
    AdaptiveAxisWorkspace,
)
from gyro_drift_filter.core.methods.advice import Advice
from gyro_drift_filter.core.methods.circumstances import CALM_SECONDS, Circumstances, compare_rates
from gyro_drift_filter.core.methods.compensation import (
    compensate,
    gives_back_knock,
    note_prediction,
    predictable,
    turn_compensation,
)
from gyro_drift_filter.core.methods.doubt import (
    lies_at_accepted,
    note_confirmation,
    note_held,
    note_innovation,
    note_missing,
    note_rate_change,
    note_repeat,
    start_doubt,
    unmeasured_variance,
)
from gyro_drift_filter.core.methods.interacting import (
    combine_modes,
    correct,
    limit_extrapolation,
    make_certain,
    mode_of,
    predict_modes,
    put_modes_at,
    take_prediction,
)
from gyro_drift_filter.core.methods.jolts import FIRST_CHANGE, JOLT_SAMPLES
from gyro_drift_filter.core.methods.mode_set import MODES, Derivation, ModeSet, derive_mode_set
from gyro_drift_filter.core.methods.noise import (
    NoiseCoefficients,
    derive_noise,
    exceeds_step,
    forget_blocks,
    interrupt_block,
    learn_noise_from_sample,
    restart_block,
    start_noise,
)
from gyro_drift_filter.core.methods.outlier_limits import (
    OutlierLimits,
    derive_limits,
    fill_innovation_limits,
)
from gyro_drift_filter.core.methods.outliers import find_reason, may_lie_behind_gap
from gyro_drift_filter.core.methods.reasons import Decision, Reason, decision_of
from gyro_drift_filter.core.sample import Sample

if TYPE_CHECKING:
    from gyro_drift_filter.core.records import FilterRecord
    from gyro_drift_filter.core.settings import Settings


class AdaptiveCoefficients(TypedDict):
    """What is derived from settings and sample period; for all axes."""

    modes: ModeSet
    limits: OutlierLimits
    calm_samples: int
    noise: NoiseCoefficients


record(AdaptiveCoefficients, in_cache_lines=True)


class AdaptiveWorkspace(TypedDict):
    """What all axes need between prediction and estimate."""

    axes: Annotated[Sequence[AdaptiveAxisWorkspace], ADAPTIVE_AXIS_WORKSPACE, (3,)]
    circumstances: Circumstances
    derivation: Derivation


record(AdaptiveWorkspace, in_cache_lines=True)


@kernel
def derive(
    settings: 'Settings',
    period: float,
    coefficients: AdaptiveCoefficients,
    workspace: AdaptiveWorkspace,
) -> None:
    """Fill the coefficients for a sample period in s."""
    derive_mode_set(period, coefficients['modes'], workspace['derivation'])
    derive_limits(settings, period, coefficients['limits'])
    coefficients['calm_samples'] = max(JOLT_SAMPLES, int(CALM_SECONDS / period + 0.5))
    derive_noise(settings, period, coefficients['noise'])
    for axis in range(3):
        # The variances are of other modes.
        workspace['axes'][axis]['variance_key'][0] = 0.0
        workspace['axes'][axis]['error_key'][0] = 0.0


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
    put_modes_at(state, rate)
    make_certain(state, MODES - 1)
    state['held_angle'] = state['knock_angle'] = 0.0
    state['recent_angle'] = state['compensation'] = 0.0
    state['bridge']['samples'] = 0
    state['bridge']['behind'] = False
    state['last_accepted'] = rate
    start_doubt(state['doubt'], rate)


@kernel
def start_over(state: AdaptiveAxis) -> None:
    """Forget what was learned of the noise, before `start`."""
    state['learning'] = False


@kernel
def make_equally_likely(state: AdaptiveAxis) -> None:
    """Leave it to the next sample which mode holds, after `start` at a rate."""
    for j in range(MODES):
        state['probability'][j] = 1.0 / MODES


@kernel
def change_model(state: AdaptiveAxis, before: 'Settings', after: 'Settings', axis: int) -> None:
    """Start the noise anew where other settings give it."""
    deviation = after['model_noise_deviation'][axis]
    if deviation != 0.0 and deviation != before['model_noise_deviation'][axis]:
        start_noise(state['noise'], deviation, after['model_phi'][axis])


@kernel
def change_period(state: AdaptiveAxis, periods: float) -> None:
    """Get ready for gains of a sample period of `periods` old ones.

    Acceleration and jerk are per sample and have followed the samples: where the clock learns the
    period late, they are right already. But the gains of a shorter period are smaller and expect
    less noise in them than the larger gains have left, so then they are scaled down.
    """
    if periods < 1.0:
        for j in range(MODES):
            state['acceleration'][j] *= periods
            state['jerk'][j] *= periods * periods


@kernel
def predict(state: AdaptiveAxis, workspace: AdaptiveWorkspace, axis: int, modes: ModeSet) -> None:
    """Predict the next sample, into the workspace: each mode, and all together."""
    own = workspace['axes'][axis]
    transitions = modes['transitions'][workspace['circumstances']['transition']]
    predict_modes(state, own, transitions, modes)


@kernel
def coast(state: AdaptiveAxis, workspace: AdaptiveWorkspace, axis: int, modes: ModeSet) -> None:
    """Pass over a sample that is missing or no number: the prediction is the state then."""
    predict(state, workspace, axis, modes)
    own = workspace['axes'][axis]
    take_prediction(state, own)
    note_missing(state['doubt'], own['typical_innovation'])
    interrupt_block(state['noise'])


@kernel
def compare_axes(filter_: 'FilterRecord', sample: Sample, missing: int) -> None:
    """Turn what is to be given back with the body, and look at the rates of all axes together."""
    state = filter_['state']
    seconds = (1 + missing) * state['clock']['period']
    turn_compensation(state['methods']['adaptive'], seconds)
    compare_rates(filter_, sample)


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
    doubt, last_accepted = state['doubt'], state['last_accepted']
    own['accepted_before'] = last_accepted
    is_behind_others = doubt['unaccepted'] > 0
    own['is_at_accepted'] = is_behind_others and lies_at_accepted(doubt, sample, last_accepted)
    own['reason'] = _judge(state, own, circumstances, sample, coefficients['limits'])
    _take_in(state, own, circumstances, coefficients, sample)
    _learn(state, own, circumstances, coefficients, sample)
    return sample - own['prediction'], decision_of(own['reason']) == Decision.HOLD


@kernel
def _judge(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    circumstances: Circumstances,
    sample: float,
    limits: OutlierLimits,
) -> Reason:
    """Return the reason for the decision on a sample (rad/s).

    Its innovation says it, unless the rate itself says nothing.
    """
    doubt, typical = state['doubt'], workspace['typical_innovation']
    still = circumstances['still']
    usual = doubt['usual_innovation']
    fill_innovation_limits(workspace['innovation_limits'], usual, typical, still, limits)
    reason = find_reason(state, workspace, circumstances, limits, sample)
    # Called for every sample, as it counts them.
    constant = note_repeat(doubt, sample, state['noise']['variance'])
    if still and not exceeds_step(state['noise']):
        constant = False  # slow noise repeats a value of coarse steps for as long
    cut_off = workspace['at_limit'] and _is_behind(sample, workspace['prediction'], typical)
    if constant and not cut_off:
        return Reason.CONSTANT
    unmeasured = circumstances['repeated'] or workspace['hangs']
    if unmeasured and doubt['unmeasured'] < limits['longest_hold']:
        return Reason.REPEATED
    if cut_off:
        return Reason.AT_LIMIT
    if reason == Reason.RETURNED and gives_back_knock(state):
        return Reason.KNOCKED
    return reason


@kernel
def _take_in(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    circumstances: Circumstances,
    coefficients: AdaptiveCoefficients,
    sample: float,
) -> None:
    """Do with a sample (rad/s) what was decided: in the modes, and in what is doubted."""
    doubt, typical = state['doubt'], workspace['typical_innovation']
    limits, modes = coefficients['limits'], coefficients['modes']
    reason, unmeasured = workspace['reason'], doubt['unmeasured']
    decision = decision_of(reason)
    predicted = decision == Decision.HOLD or decision == Decision.BRIDGE
    note_confirmation(doubt, reason)
    if predicted:
        if decision == Decision.HOLD:
            innovation = sample - workspace['prediction']
            note_held(doubt, sample, innovation, typical, circumstances['dropout'], limits)
        else:
            note_missing(doubt, typical)
        take_prediction(state, workspace)
        limit_extrapolation(state, limits['growth_limit'] * doubt['unaccepted'])
    elif reason == Reason.CONSTANT or decision != Decision.ACCEPT:
        _restart_at(state, workspace, sample, modes)
    else:
        steps = 1.0 + doubt['unaccepted']
        doubt['unaccepted'] = doubt['unmeasured'] = 0
        correct(state, workspace, sample, steps, modes)
    if workspace['hangs'] and decision != Decision.BRIDGE:
        # A value that is used meanwhile was not measured either.
        note_missing(doubt, typical)
        doubt['unmeasured'] = unmeasured + 1
    if doubt['unmeasured'] == 0:
        doubt['behind_gap'] = unmeasured > 0 or may_lie_behind_gap(circumstances)
    doubt['last_sample'] = sample
    if not predicted:
        state['last_accepted'] = sample


@kernel
def _learn(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    circumstances: Circumstances,
    coefficients: AdaptiveCoefficients,
    sample: float,
) -> None:
    """Learn from a sample (rad/s) what is usual, what can be predicted, and what noise is."""
    doubt, prediction = state['doubt'], workspace['prediction']
    accepted_before, decision = workspace['accepted_before'], decision_of(workspace['reason'])
    change = sample - accepted_before
    is_held = decision == Decision.HOLD and not circumstances['dropout']
    note_innovation(doubt, sample - prediction, is_held)
    if not is_held and not workspace['hangs']:
        note_rate_change(doubt, change, coefficients['limits'])
    taken = decision == Decision.ACCEPT or decision == Decision.START_ANEW
    if taken and not workspace['hangs']:
        note_prediction(state['bridge'], prediction - accepted_before, change)
    if circumstances['may_follow_gap'] and not circumstances['noise_alone']:
        # The differences between samples of which some in between are missing are those of no
        # motion: they look as rough as noise.
        interrupt_block(state['noise'])
    _learn_noise(state, workspace, sample, circumstances['noise_alone'], coefficients['noise'])


@kernel
def _learn_noise(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    sample: float,
    noise_alone: bool,
    coefficients: NoiseCoefficients,
) -> None:
    """Learn the noise from a sample (rad/s) that is accepted, and was measured."""
    noise, decision = state['noise'], decision_of(workspace['reason'])
    measured = not workspace['hangs'] and not workspace['at_limit']
    if decision == Decision.ACCEPT and measured:
        learn_noise_from_sample(noise, sample, noise_alone, coefficients)
    elif decision == Decision.START_ANEW:
        restart_block(noise)
    elif workspace['hangs'] and noise['blocks'] == 0:
        # The body may have come to rest meanwhile, so motion before it tells nothing of the rest.
        forget_blocks(noise)
    else:
        interrupt_block(noise)


@kernel
def limits_of(workspace: AdaptiveAxisWorkspace) -> tuple[float, float]:
    """Return the two limits that the innovation just taken in was held against, in rad/s.

    Both are 0 where something else decided, and one of them where it is infinite.
    """
    limits, reason = workspace['innovation_limits'], workspace['reason']
    failed = reason == Reason.DROPOUT or reason == Reason.DROPOUT_GOES_ON
    if failed or reason == Reason.CONSTANT or reason >= Reason.REPEATED:
        return 0.0, 0.0
    least_jump = limits['body_jump'] if reason == Reason.BEYOND_BODY else limits['least_jump']
    return _finite(limits['innovation_threshold']), _finite(least_jump)


@kernel
def _finite(limit: float) -> float:
    """Return a limit, or 0 where it is infinite, so that there is none."""
    return limit if limit < np.inf else 0.0


@kernel
def _restart_at(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    sample: float,
    modes: ModeSet,
) -> None:
    """Put all modes at a sample (rad/s), for a decision that is not to hold it back."""
    doubt, decision = state['doubt'], decision_of(workspace['reason'])
    put_modes_at(state, sample)
    doubt['unaccepted'] = doubt['unmeasured'] = 0
    doubt['before_restart'] = state['last_accepted']
    if decision == Decision.START_ANEW:
        jump = abs(sample - workspace['prediction'])
        make_certain(state, mode_of(jump, state['noise']['variance'], modes))
    elif decision == Decision.PASS:
        make_certain(state, MODES - 1)
        # What the true rate is was not measured.
        note_missing(doubt, workspace['typical_innovation'])


@kernel
def _is_behind(sample: float, prediction: float, typical_innovation: float) -> bool:
    """Return whether a rate is no larger than predicted, as one is that its range has cut off."""
    size = sample if sample > 0.0 else -sample
    predicted = prediction if sample > 0.0 else -prediction
    return bool(predicted >= size - typical_innovation)


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
    noise_alone = circumstances['noise_alone']
    # Without a sample there was no decision: `reason` is left over from an earlier one.
    measured, decision = sample == sample, decision_of(own['reason'])
    accepted = measured and decision == Decision.ACCEPT
    rate, variance, process_noise = combine_modes(state, own, modes, noise_alone, accepted)
    if measured and decision == Decision.BRIDGE:
        origin = own['accepted_before']
        rate = origin + predictable(state['bridge']) * (rate - origin)
    elif not circumstances['still'] and (not measured or decision == Decision.HOLD):
        # A vibration turns back within some samples, so that each further step of an extrapolation
        # comes true by that share alone.
        steps = 1.0 * state['doubt']['unaccepted']
        left_out = (1.0 - predictable(state['bridge']) ** steps) * (rate - state['last_accepted'])
        rate -= left_out
        variance += left_out * left_out
    if own['hangs']:
        variance = max(variance, unmeasured_variance(state['doubt']))
    if measured and not circumstances['dropout']:
        rate += compensate(state, own, circumstances, sample, rate, period)
    return rate, variance, process_noise, state['noise']['variance']


ADVICE = Advice(
    outliers='look at the raw rates; for motion raise outlier.acceleration, for noise '
    'raise outlier.threshold',
    large_innovations='is it a vibration? Leave it at rest for a second so that it learns its '
    'noise, or set model.noise_deviation',
    small_innovations='no outlier will be found; set model.noise_deviation lower, or to 0',
    learns_noise=True,
)
