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

"""What the sensor turned unseen, given back, so that the heading holds.

Samples are held back that were motion after all, repeated samples hide what the body turned
meanwhile, and smoothing lags behind a motion that begins. What a later sample shows of it is added
to the rates that are put out.
"""

from collections.abc import Sequence

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.matrices import rotation_terms
from gyro_drift_filter.core.methods.adaptive_axis import (
    AdaptiveAxis,
    AdaptiveAxisWorkspace,
    Bridge,
)
from gyro_drift_filter.core.methods.circumstances import Circumstances
from gyro_drift_filter.core.methods.outliers import CONFIRMED_HIT
from gyro_drift_filter.core.methods.reasons import Decision, decision_of
from gyro_drift_filter.core.sensor_checks import RANGE

# The angles of held samples that were motion, of samples that were bridged, and of what smoothing
# has removed in motion make one sum. While it is within SMOOTHING_DEVIATIONS of noise it is given
# back with the time constant SMOOTHING_SECONDS (s), else with COMPENSATION_SECONDS.
COMPENSATION_SECONDS, SMOOTHING_SECONDS, SMOOTHING_DEVIATIONS = 0.25, 4.0, 3.0
COMPENSATION_SHARE = 1.0 / 16.0  # of the angle, at most, with a sample
# A larger angle, in rad, is no motion, unless samples last so long that LARGEST_SAMPLES turn a body
# by more at the range of gyroscopes: the largest step is held for so many by default.
LARGEST_COMPENSATION, LARGEST_SAMPLES = 2.0, 5
LARGEST_KNOCK = 0.02  # rad: a knock turns a body that stays where it is by at most this angle
# The slowest mode averages over so long: a turn that has begun since then may not show yet.
RECENT_SECONDS = 1.0
LEAST_COMPENSATION = 1e-9  # rad: as processors are slow with denormal numbers
PREDICTION_MEMORY = 1.0 / 16.0  # weight of a measurement in how well changes are predicted


@kernel
def compensate(
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
    largest = max(LARGEST_COMPENSATION, LARGEST_SAMPLES * RANGE * period)
    unseen = (sample - rate) * period
    missed = _held_motion(state, workspace, circumstances, unseen, largest, period)
    missed += _cross_bridge(state['bridge'], workspace, sample, rate) * period
    if decision_of(workspace['reason']) == Decision.ACCEPT:
        # A motion is seen only when a block of samples has shown it: what was smoothed away since
        # it began was motion, too.
        recent = state['recent_angle'] + unseen
        if circumstances['still']:
            state['recent_angle'] = _without_denormal(recent * (1.0 - period / RECENT_SECONDS))
        else:
            missed += recent
            state['recent_angle'] = 0.0
    return _give_back(state, missed, largest, period)


@kernel
def _held_motion(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    circumstances: Circumstances,
    unseen: float,
    largest: float,
    period: float,
) -> float:
    """Return the angle in rad that held samples turned, once it is known that they were motion.

    `unseen` is what the sample at hand turns beyond what is put out, `largest` the largest angle
    that may be motion, both in rad; `period` in s.
    """
    decision, at_accepted = decision_of(workspace['reason']), workspace['is_at_accepted']
    missed = 0.0
    if decision == Decision.HOLD:
        # What has come back was an outlier; or a knock, which turns a body by a small angle.
        if at_accepted and abs(state['held_angle']) > state['knock_angle']:
            state['held_angle'] = 0.0
        state['held_angle'] += unseen
        knock = circumstances['explained_jump'] / CONFIRMED_HIT * period
        if circumstances['jolted']:
            knock = max(knock, LARGEST_KNOCK)
        state['knock_angle'] = max(state['knock_angle'], knock)
    elif state['held_angle'] != 0.0 and decision != Decision.BRIDGE:
        was_motion = decision == Decision.START_ANEW or decision == Decision.PASS
        was_motion = was_motion and not at_accepted
        if abs(state['held_angle']) <= (largest if was_motion else state['knock_angle']):
            missed = state['held_angle']
        state['held_angle'] = state['knock_angle'] = 0.0
    return missed


@kernel
def _give_back(state: AdaptiveAxis, missed: float, largest: float, period: float) -> float:
    """Return the rate in rad/s by which missed angles are given back, now by `missed` rad more."""
    angle = state['compensation'] + missed
    if angle == 0.0:
        state['compensation'] = 0.0
        return 0.0
    angle = _without_denormal(min(max(angle, -largest), largest))
    noise = state['noise']['variance'] * 0.5 * period * SMOOTHING_SECONDS
    small = angle * angle < SMOOTHING_DEVIATIONS * SMOOTHING_DEVIATIONS * noise
    seconds = SMOOTHING_SECONDS if small else COMPENSATION_SECONDS
    now = angle * min(period / seconds, COMPENSATION_SHARE)
    state['compensation'] = angle - now
    return float(now / period)


@kernel
def gives_back_knock(state: AdaptiveAxis) -> bool:
    """Return whether the angle of what is held back is given back though the rate has returned."""
    return 0.0 < abs(state['held_angle']) <= state['knock_angle']


@kernel
def _without_denormal(angle: float) -> float:
    """Return an angle in rad, or none where it is too small for anything."""
    return 0.0 if abs(angle) < LEAST_COMPENSATION else angle


@kernel
def turn_compensation(axes: Sequence[AdaptiveAxis], seconds: float) -> None:
    """Turn the angles that are still to be given back against the body as it turns.

    They belong to an orientation of the past, and stay what they are only in a frame that does not
    turn. The rotation is that of the last sample (Rodrigues).
    """
    x, y, z = axes[0]['compensation'], axes[1]['compensation'], axes[2]['compensation']
    if x == 0.0 and y == 0.0 and z == 0.0:
        return
    a, b = axes[0]['last_accepted'] * seconds, axes[1]['last_accepted'] * seconds
    c = axes[2]['last_accepted'] * seconds
    along, square = a * x + b * y + c * z, a * a + b * b + c * c
    across, within = rotation_terms(square)
    axes[0]['compensation'] = x - across * (b * z - c * y) + within * (a * along - x * square)
    axes[1]['compensation'] = y - across * (c * x - a * z) + within * (b * along - y * square)
    axes[2]['compensation'] = z - across * (a * y - b * x) + within * (c * along - z * square)


@kernel
def note_prediction(bridge: Bridge, predicted: float, measured: float) -> None:
    """Note a change that was predicted and measured, in rad/s."""
    square, product = predicted * predicted, predicted * measured
    bridge['predicted_square'] += PREDICTION_MEMORY * (square - bridge['predicted_square'])
    bridge['predicted_product'] += PREDICTION_MEMORY * (product - bridge['predicted_product'])


@kernel
def predictable(bridge: Bridge) -> float:
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
    decision, accepted_before = decision_of(workspace['reason']), workspace['accepted_before']
    repeated, turned = decision == Decision.BRIDGE, 0.0
    if workspace['hangs'] and not repeated:
        # The bridge ends with a rate that was not measured: how the body turned nobody knows.
        bridge['samples'], bridge['behind'] = 0, False
        return 0.0
    if bridge['behind']:
        slope = predictable(bridge) * (sample - accepted_before)
        slope = bridge['slope_before'] if repeated else slope
        turned = _turned_beyond(bridge, accepted_before, slope)
    if repeated and (bridge['samples'] == 0 or bridge['behind']):
        bridge['samples'] = 0
        bridge['angular_velocity'] = 0.0
        bridge['before'] = accepted_before
        bridge['slope_before'] = predictable(bridge) * (workspace['prediction'] - accepted_before)
    elif bridge['behind'] or decision == Decision.HOLD:
        bridge['samples'] = 0
    if repeated:
        bridge['samples'] += 1
        bridge['angular_velocity'] += put_out
    bridge['behind'] = not repeated and bridge['samples'] > 0
    return turned


@kernel
def _turned_beyond(bridge: Bridge, after: float, slope_after: float) -> float:
    """Return what repeated samples turned beyond what was put out, in rad/s times samples.

    `after` (rad/s) and `slope_after` (rad/s per sample) are rate and slope behind the bridge.
    """
    intervals = bridge['samples'] + 1.0
    curve = (bridge['slope_before'] - slope_after) * intervals * intervals / 12.0
    mean = 0.5 * (bridge['before'] + after)
    return float(bridge['samples'] * mean + curve - bridge['angular_velocity'])
