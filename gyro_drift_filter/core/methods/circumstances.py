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

"""What is known of a sample beside its rate on one axis.

The accelerometer says whether the body is shaken or may stand, the clock what may be missing, and
the rates of all axes together whether they were measured at all.
"""

import math
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from gyro_drift_filter.accelerate import PerAxis, kernel
from gyro_drift_filter.core.clock.losses import may_follow_gap
from gyro_drift_filter.core.methods.adaptive_axis import AdaptiveAxis, AdaptiveAxisWorkspace
from gyro_drift_filter.core.methods.jolts import (
    JOLT_SAMPLES,
    feel_jolt,
    felt_change,
    jump_by_shake,
    was_jolted,
)
from gyro_drift_filter.core.methods.mode_set import Transition
from gyro_drift_filter.core.methods.noise import exceeds_step, is_begun, usual_deviation
from gyro_drift_filter.core.rest.detection import has_stood_still, shows_noise
from gyro_drift_filter.core.sample import Sample, is_one_value, is_usable
from gyro_drift_filter.core.sensor_checks import SensorChecks
from gyro_drift_filter.core.zeros import has_failed_to_read

if TYPE_CHECKING:
    from gyro_drift_filter.core.records import FilterRecord

# Zeros on all axes are no drop-out by their jump where no axis was faster than this, in rad/s: some
# drivers give zeros for slow rates, of one degree a second at most. At rest `zeros.py` judges them.
LARGEST_DEAD_ZONE = 0.02
# Where the noise exceeds a step, a measured rate comes four times in a row in at most one of 50
# cases: such a rate is that of a bus that hangs.
LEAST_HANG = 3  # repeats
REPEAT_CHANGE = 3.0  # standard deviations of the noise: below, a repeat does no harm
# Blocks of samples in a row that have to be still (`rest/`) for outliers to be judged by noise.
STILL_BLOCKS = 3
# A body may stand, and all its motion have died away, where all rates are this close to those at
# rest, in standard deviations of the noise, and the accelerometer has been calm for as long as a
# hand takes to turn back.
NEAR_REST = 0.7
CALM_SECONDS = 0.15
# Zeros on all axes are a drop-out where they are a surprise on any of them by this many standard
# deviations of the noise, or steps of its resolution. A driver with nothing to report sends zeros;
# so may a robot at rest.
SURPRISE_DEVIATIONS = 3.0


class Circumstances(TypedDict):
    """What is known of a sample beside its rate on the axis at hand."""

    # samples before it, which its stamp and earlier losses do not rule out; 0 behind known ones
    possibly_missing: int
    may_follow_gap: bool  # samples were missing before, and may be again before this one
    dropout: bool  # the sensor had nothing to report
    repeated: bool  # the sensor has not measured since the sample before
    still: bool  # some blocks of samples before it have been still,
    noise_alone: bool  # and so many that a whole block of noise lies within them
    jolted: bool  # the accelerometer has just been shaken,
    jolted_before: bool  # or had been at the sample before
    shake: float  # m/s^2, by which the acceleration has changed, now or at the sample before
    explained_jump: float  # rad/s, of a body that is hit in motion, see `jump_by_shake`
    transition: int  # a member of Transition: what the modes are expected to do


@kernel
def note_circumstances(filter_: 'FilterRecord', sample: Sample, possibly_missing: int) -> None:
    """Note what the accelerometer and all axes together show, before the prediction of a sample."""
    states = filter_['state']['methods']
    circumstances = filter_['workspace']['methods']['adaptive']['circumstances']
    rest, force = filter_['state']['bias']['rest'], sample['linear_acceleration']
    still, measured = has_stood_still(rest, STILL_BLOCKS), not is_one_value(force)
    shake = shake_before = usual_shake = 0.0
    jolted = jolted_before = False
    for axis in range(3):
        if not states['tracking'][axis]:
            continue
        jolt = states['adaptive'][axis]['jolt']
        if feel_jolt(jolt, force[axis] if measured else np.nan):
            jolted = True
        if was_jolted(jolt):
            jolted_before = True
        change = felt_change(jolt, jolt['change'], still)
        change_before = felt_change(jolt, jolt['change_before'], still)
        shake += change * change
        shake_before += change_before * change_before
        usual_shake += jolt['usual_change'] * jolt['usual_change']
    circumstances['possibly_missing'] = possibly_missing
    circumstances['may_follow_gap'] = may_follow_gap(filter_['state']['clock'], possibly_missing)
    circumstances['jolted'] = jolted
    circumstances['jolted_before'] = jolted_before
    circumstances['shake'] = math.sqrt(max(shake, shake_before))
    per_jump = filter_['coefficients']['methods']['adaptive']['limits']['shake_per_jump']
    jump = jump_by_shake(circumstances['shake'], math.sqrt(usual_shake), per_jump)
    circumstances['explained_jump'] = 0.0 if still else jump
    circumstances['still'] = still
    circumstances['noise_alone'] = shows_noise(rest)
    circumstances['transition'] = _transition(filter_)


@kernel
def _transition(filter_: 'FilterRecord') -> Transition:
    """Return what the modes are expected to do.

    A body may stand where the accelerometer has been calm for some samples, and the rates that were
    filtered last are about the bias at rest.
    """
    state = filter_['state']
    calm_samples = filter_['coefficients']['methods']['adaptive']['calm_samples']
    settling = True
    for axis in range(3):
        if not state['methods']['tracking'][axis]:
            continue
        own, rate = state['methods']['adaptive'][axis], state['filtered'][axis]
        if own['jolt']['calm_samples'] < JOLT_SAMPLES:
            return Transition.SHAKEN
        distance = rate - state['bias']['bias'][axis]
        near = distance * distance < NEAR_REST * NEAR_REST * own['noise']['variance']
        settling = settling and near and own['jolt']['calm_samples'] >= calm_samples
    return Transition.SETTLING if settling else Transition.MOVING


@kernel
def compare_rates(filter_: 'FilterRecord', sample: Sample) -> None:
    """Note what the rates of all axes together show, behind their prediction."""
    state, workspace = filter_['state'], filter_['workspace']['methods']['adaptive']
    axes, checks, polling = state['methods']['adaptive'], state['checks'], state['polling']
    rate, circumstances = sample['angular_velocity'], workspace['circumstances']
    surprised = turned = fast = living = False
    for axis in range(3):
        axis_state, own = axes[axis], workspace['axes'][axis]
        own['at_limit'] = checks['range_end']['at_limit'][axis]
        own['hangs'] = _hangs(axis_state, checks, axis, circumstances['still'])
        if not state['methods']['tracking'][axis]:
            continue
        if is_usable(rate[axis]) and _surprises(axis_state, own, rate[axis]):
            surprised = True
        if axis_state['last_accepted'] != 0.0:
            living = True
        if abs(axis_state['last_accepted']) > LARGEST_DEAD_ZONE:
            fast = True
        if polling['bridged'] and _has_turned(axis_state, own, rate[axis]):
            turned = True
    dropout = fast and surprised and _may_have_failed(checks, sample['linear_acceleration'])
    rests = circumstances['still'] or not state['bias']['rest']['known']
    # Zeros that go on are passed on at last.
    dropout = dropout or (living and rests and has_failed_to_read(filter_))
    circumstances['dropout'] = dropout and filter_['settings']['outlier_enabled']
    repeated = polling['bridged'] and turned and not circumstances['still']
    circumstances['repeated'] = repeated and not circumstances['dropout']


@kernel
def _may_have_failed(checks: SensorChecks, force: PerAxis) -> bool:
    """Return whether rates and acceleration (3,) in m/s^2 may be those of a read that failed."""
    measured = checks['measured']
    if not is_one_value(measured):
        return False
    # Alike by chance may be the rates of a coarse sensor, or the accelerations, but not both.
    failed = is_one_value(force) and force[0] != 0.0
    return bool(failed or (measured[0] == 0.0 and not checks['gives_zeros']))


@kernel
def _hangs(state: AdaptiveAxis, checks: SensorChecks, axis: int, still: bool) -> bool:
    """Return whether an axis has shown one rate more often in a row than its noise lets it.

    Before the first rest motion may be in the noise, so that a body that stands `still` says
    nothing: a sensor of coarse steps shows one rate then.
    """
    if checks['equal'][axis] < LEAST_HANG or checks['range_end']['at_limit'][axis]:
        return False
    noise = state['noise']
    if still and noise['blocks'] == 0:
        return False
    return noise['resolution'] > 0.0 and exceeds_step(noise)


@kernel
def _has_turned(state: AdaptiveAxis, workspace: AdaptiveAxisWorkspace, sample: float) -> bool:
    """Return whether the predicted change since the last sample is more than noise explains."""
    change, noise = abs(sample - workspace['prediction']), state['noise']
    return bool(is_begun(noise) and change > REPEAT_CHANGE * usual_deviation(noise))


@kernel
def _surprises(state: AdaptiveAxis, workspace: AdaptiveAxisWorkspace, sample: float) -> bool:
    """Return whether a sample is far from its prediction and from the one before."""
    noise = state['noise']
    surprise = min(abs(sample - workspace['prediction']), abs(sample - state['last_accepted']))
    usual = SURPRISE_DEVIATIONS * usual_deviation(noise)
    return bool(is_begun(noise) and surprise > max(usual, workspace['typical_innovation']))
