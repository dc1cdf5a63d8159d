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

"""One step of the filter for all three axes: live and offline both come through here."""

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, inlined_kernel, kernel, read_only
from gyro_drift_filter.core import methods
from gyro_drift_filter.core.bias.at_rest import leave_rest, track_bias
from gyro_drift_filter.core.bias.motion_state import BIAS, motion_variance
from gyro_drift_filter.core.bias.records import (
    bias_variance,
    has_bias,
    has_learned_bias,
    wander_variance,
    widen,
)
from gyro_drift_filter.core.bias.shift import let_shift_vary
from gyro_drift_filter.core.calibration import apply_calibration, subtract_acceleration
from gyro_drift_filter.core.clock.envelope import advance_clock, note_elapsed
from gyro_drift_filter.core.clock.losses import possibly_in_gap, possibly_missing
from gyro_drift_filter.core.learning_in_motion import learn_in_motion
from gyro_drift_filter.core.out_of_sequence import (
    go_back,
    insert_sample,
    is_overtaken,
    keep_sample,
    note_backward,
    recall_result,
)
from gyro_drift_filter.core.polling import Message, message_period, note_message
from gyro_drift_filter.core.quantisation import (
    add_half_counts,
    needs_half_counts,
    note_counts,
    note_still,
    variance_of_cut,
    variance_of_rounding,
)
from gyro_drift_filter.core.records import FILTER, FilterRecord
from gyro_drift_filter.core.rest.records import derive_lengths
from gyro_drift_filter.core.sample import (
    RESULT,
    SAMPLE,
    STARTED,
    UNUSABLE,
    Result,
    Sample,
    SampleStatus,
    are_equal,
    is_usable,
)
from gyro_drift_filter.core.sensor_changes import adopt_sensor_period, doubt_rest, forget_rest
from gyro_drift_filter.core.sensor_checks import (
    forget_turn,
    may_hang,
    measures_exact_rest,
    note_turn,
    note_values,
)
from gyro_drift_filter.core.zeros import has_failed_to_read

# The most that one sample adds to the sum: a start of motion may be any number.
LARGEST_NIS = 100.0
# The most that one squared residual adds. A filter that lags does so in many samples; one that
# gives an angle back does so in a few.
LARGEST_RESIDUAL = 10.0


@kernel
def step(sample: Sample, filter_: FilterRecord) -> None:
    """Take one sample in, at its place in time, and leave its result in the state of the filter."""
    state, history = filter_['state'], filter_['history']
    clock, gap_limit = state['clock'], filter_['settings']['gap_limit']
    recall_result(filter_)
    if sample['stamp'] < clock['stamp']:
        note_backward(history, clock, sample['stamp'], gap_limit)
        if is_overtaken(history, sample['stamp']):
            _take_overtaken(sample, filter_)
            return
    keep_sample(history, state, sample, gap_limit)
    _take(sample, filter_)


@kernel
def _take_overtaken(sample: Sample, filter_: FilterRecord) -> None:
    """Take a sample in before those that have overtaken it, and then these once more."""
    state, history, own = filter_['state'], filter_['history'], filter_['workspace']
    place = insert_sample(history, sample)
    go_back(filter_)
    for i in range(history['count']):
        _take(history['samples'][i], filter_)
        if i == place:
            own['result'] = state['result']
    history['result'] = state['result']
    state['result'] = own['result']
    history['displaced'] = True


@kernel
def _take(sample: Sample, filter_: FilterRecord) -> None:
    """Take in a sample that follows the one before, or seems to."""
    settings, state = filter_['settings'], filter_['state']
    clock, result, stamp = state['clock'], state['result'], sample['stamp']
    state['counts']['samples'] += 1
    if _is_duplicate(sample, filter_):
        state['counts']['duplicates'] += 1
        _repeat_result(result)
        return
    number = state['counts']['samples'] - state['counts']['duplicates']
    message = note_message(state['polling'], state['checks'], sample, number)
    if message == Message.POLLING_FOUND:
        adopt_sensor_period(filter_)
    period, elapsed, missing, jumped = clock['period'], 0.0, 0, False
    needs_half = False
    if message != Message.REPEAT:
        if filter_['coefficients']['period'] != period:
            derive(filter_, period)
        elapsed = note_elapsed(clock, stamp)
        missing, jumped = advance_clock(
            clock,
            stamp,
            settings['sample_rate'],
            settings['gap_limit'],
            filter_['workspace']['clock'],
        )
        result['status'] = SampleStatus.FILTERED
        needs_half = _look_at_counts(sample, missing == 0 and not jumped, filter_)
    seconds = message_period(state['polling'], clock['period'])
    note_values(state['checks'], sample, seconds, state['bias']['rest'])
    if state['checks']['comes_alive']:
        doubt_rest(filter_)
    if measures_exact_rest(state['checks'], seconds):
        forget_rest(filter_)
    if message == Message.REPEAT:
        _repeat_result(result)
        return
    if needs_half:
        add_half_counts(state['quantisation'], sample['angular_velocity'])
    _filter_sample(sample, elapsed, missing, jumped, filter_)


@kernel
def _filter_sample(
    sample: Sample, elapsed: float, missing: int, jumped: bool, filter_: FilterRecord
) -> None:
    """Filter a sample that was measured, `elapsed` s after the one before, and count its result.

    The values of the sample are raw again after it, as the sample is the caller's.
    """
    settings, state = filter_['settings'], filter_['state']
    clock, result, period = state['clock'], state['result'], filter_['coefficients']['period']
    if settings['is_sensitive']:
        subtract_acceleration(sample, state['linear_acceleration'], settings)
    follows = missing == 0 and not jumped
    possible = possibly_missing(clock, elapsed, period) if follows else 0
    _stop_coasting(sample, missing, jumped, filter_)
    _filter_axes(sample, missing, possible, filter_)
    in_gap = possibly_in_gap(clock, possible)
    _learn_bias(sample, elapsed, missing, in_gap, jumped, filter_)
    _subtract_bias(filter_)
    _widen_shift_by_rounding(filter_)
    apply_calibration(settings, result)
    for axis in range(3):
        state['taken'][axis] = sample['angular_velocity'][axis]
        sample['angular_velocity'][axis] = state['checks']['measured'][axis]
    if result['status'] == SampleStatus.REFUSED:
        state['counts']['refused'] += 1
    else:
        _count_result(filter_)
    if clock['period'] != period:
        methods.change_period(filter_, clock['period'] / period)


@kernel
def _repeat_result(result: Result) -> None:
    """Give the result of the sample before once more."""
    if result['status'] == SampleStatus.FILTERED:
        result['status'] = SampleStatus.REPEATED


@inlined_kernel
def _look_at_counts(sample: Sample, follows: bool, filter_: FilterRecord) -> bool:
    """Look at the counts of a sample; return whether half of one is to be added.

    `follows` where it follows the sample before, with none missing in between.
    """
    state, choice = filter_['state'], filter_['settings']['input_quantisation']
    quantisation, rate = state['quantisation'], sample['angular_velocity']
    needs_half = needs_half_counts(quantisation, choice)
    if follows and note_counts(quantisation, rate, state['checks']['measured']):
        before, needs_half = needs_half, needs_half_counts(quantisation, choice)
        # The bias was learned with half a count more or less in the rates.
        if (before or needs_half) and has_learned_bias(state['bias']):
            widen(state['bias'], variance_of_cut(quantisation))
    if follows and state['bias']['rest']['run'] > 0:
        note_still(quantisation, rate)
    return needs_half


@kernel
def derive(filter_: FilterRecord, period: float) -> None:
    """Derive all coefficients for a sample period in s."""
    coefficients = filter_['coefficients']
    coefficients['period'] = period
    methods.derive(filter_, period)
    derive_lengths(period, coefficients['rest'])


@kernel
def _is_duplicate(sample: Sample, filter_: FilterRecord) -> bool:
    """Return whether stamp and rates are those of the sample before."""
    state, stamp, rate = filter_['state'], sample['stamp'], sample['angular_velocity']
    clock, measured = state['clock'], state['checks']['measured']
    return bool(
        stamp != 0 and clock['started'] and stamp == clock['stamp'] and are_equal(rate, measured)
    )


@kernel
def _stop_coasting(sample: Sample, missing: int, jumped: bool, filter_: FilterRecord) -> None:
    """Start anew on axes that time has jumped on, or that had no usable rate for `gap_limit` s."""
    state, limit = filter_['state'], filter_['settings']['gap_limit']
    for axis in range(3):
        usable = is_usable(sample['angular_velocity'][axis])
        coasted = 0 if usable else state['coasted'][axis] + 1 + missing
        state['coasted'][axis] = coasted
        if jumped or coasted * state['clock']['period'] > limit:
            state['methods']['tracking'][axis] = 0


@kernel
def _filter_axes(sample: Sample, missing: int, possible: int, filter_: FilterRecord) -> None:
    """Predict all axes, then update them with the sample.

    Before it `missing` samples were lost for sure, and up to `possible` may have been.
    """
    rate, result = sample['angular_velocity'], filter_['state']['result']
    starting = filter_['workspace']['methods']['starting']
    tracking = filter_['state']['methods']['tracking']
    for axis in range(3):
        starting[axis] = 1 - tracking[axis]
        if starting[axis]:
            if is_usable(rate[axis]):
                methods.start(filter_, axis, rate[axis])
            else:
                result['status'] = SampleStatus.REFUSED
    methods.note_circumstances(filter_, sample, possible)
    for axis in range(3):
        if not tracking[axis]:
            continue
        if not starting[axis]:
            for _ in range(missing):
                methods.coast(filter_, axis)
        if is_usable(rate[axis]):
            methods.predict(filter_, axis)
        else:
            methods.coast(filter_, axis)
    methods.compare_axes(filter_, sample, missing)
    for axis in range(3):
        if not tracking[axis]:
            continue
        result['innovation_variance'][axis] = methods.innovation_variance(filter_, axis)
        _update_axis(rate[axis], axis, filter_)


@inlined_kernel
def _update_axis(rate: float, axis: int, filter_: FilterRecord) -> None:
    """Update the prediction of an axis with a rate in rad/s, if it is usable, into the result."""
    result, usable = filter_['state']['result'], is_usable(rate)
    innovation, outlier, reason = 0.0, True, UNUSABLE
    threshold = least_jump = 0.0
    if usable:
        innovation, outlier = methods.update(filter_, axis, rate)
        reason = STARTED
        if not filter_['workspace']['methods']['starting'][axis]:
            reason = methods.reason(filter_, axis, outlier)
            threshold, least_jump = methods.innovation_limits(filter_, axis)
    result['innovation'][axis] = innovation
    result['outlier'][axis] = outlier
    result['reason'][axis] = reason
    result['innovation_threshold'][axis] = threshold
    result['least_jump'][axis] = least_jump
    estimate, variance, process_noise, measurement_noise = methods.estimate(
        filter_, axis, rate if usable else np.nan
    )
    filter_['state']['filtered'][axis] = result['angular_velocity'][axis] = estimate
    result['angular_velocity_variance'][axis] = variance
    result['process_noise'][axis] = process_noise
    result['measurement_noise'][axis] = measurement_noise


@inlined_kernel
def _learn_bias(
    sample: Sample, elapsed: float, missing: int, in_gap: int, jumped: bool, filter_: FilterRecord
) -> None:
    """Learn the bias, at rest or in motion.

    Up to `in_gap` samples may be missing in a gap before this one, beside those that are for sure.
    """
    state = filter_['state']
    bias, result = state['bias'], state['result']
    if jumped:
        leave_rest(bias)
    trusted = result['status'] == SampleStatus.FILTERED and not may_hang(state['checks'])
    trusted = trusted and not has_failed_to_read(filter_)
    for axis in range(3):
        if result['outlier'][axis] > 0.0:
            trusted = False
    track_bias(filter_, sample, trusted, missing, elapsed)
    result['at_rest'] = bias['rest']['at_rest']
    _note_turn(missing, jumped, filter_)
    if filter_['settings']['bias_in_motion']:
        learn_in_motion(sample, missing, in_gap, filter_)


@inlined_kernel
def _subtract_bias(filter_: FilterRecord) -> None:
    """Subtract the bias from the result, and add its variance."""
    settings, state = filter_['settings'], filter_['state']
    bias, result = state['bias'], state['result']
    at_rest = bias['rest']['at_rest']
    in_motion = settings['bias_in_motion'] and not at_rest and not bias['contradicts']
    refused = result['status'] == SampleStatus.REFUSED
    for axis in range(3):
        result['bias'][axis] = 0.0
        if not settings['bias_enabled']:
            continue
        mean, variance = bias['bias'][axis], bias_variance(bias, axis)
        if in_motion:
            mean = bias['motion']['state_vector'][BIAS + axis]
            variance = motion_variance(bias['motion'], axis)
        result['bias'][axis] = mean
        if refused and not state['methods']['tracking'][axis]:
            continue  # there is no result to take it off
        # At rest the rates themselves are rounded as their mean was.
        variance += wander_variance(bias, axis) if at_rest else _rounding_variance(filter_, axis)
        result['angular_velocity'][axis] -= mean
        result['angular_velocity_variance'][axis] += variance


@kernel
def _rounding_variance(filter_: FilterRecord, axis: int) -> float:
    """Return the variance, in (rad/s)^2, of the mean of a rest by its rounding."""
    state = filter_['state']
    noise = state['result']['measurement_noise']
    return variance_of_rounding(state['quantisation'], axis, noise)


@inlined_kernel
def _widen_shift_by_rounding(filter_: FilterRecord) -> None:
    """Let the shift in motion vary by what the mean of a rest is off by its rounding.

    The bias in motion is not, and gravity can show that.
    """
    bias, tracking = filter_['state']['bias'], filter_['state']['methods']['tracking']
    if bias['rest']['at_rest'] or not bias['known']:
        return
    for axis in range(3):
        rounding = _rounding_variance(filter_, axis)
        if tracking[axis] and rounding > bias['motion']['rectified'][axis]:
            let_shift_vary(bias['motion'], axis, rounding)


@inlined_kernel
def _note_turn(missing: int, jumped: bool, filter_: FilterRecord) -> None:
    """Note by how much the body turns with a sample, if that is known."""
    state = filter_['state']
    bias, checks = state['bias'], state['checks']
    if bias['rest']['at_rest']:
        checks['accelerometer_hangs'] = False
    if bias['rest']['at_rest'] or state['result']['status'] == SampleStatus.REFUSED or jumped:
        forget_turn(checks)
        return
    period = state['clock']['period']
    seconds, message = period * (1 + missing), message_period(state['polling'], period)
    note_turn(checks, state['filtered'], bias['bias'], has_bias(bias), seconds, message)


@inlined_kernel
def _count_result(filter_: FilterRecord) -> None:
    state = filter_['state']
    counts, result = state['counts'], state['result']
    for axis in range(3):
        if result['outlier'][axis] > 0.0:
            counts['outliers'][axis] += 1
            counts['last_outlier'][axis] = counts['samples']
            counts['outliers_in_a_row'][axis] += 1
            if counts['outliers_in_a_row'][axis] == 1:
                counts['outlier_reason'][axis] = result['reason'][axis]
                counts['outlier_method'][axis] = filter_['settings']['method']
            continue
        if not methods.was_not_measured(filter_, axis):
            counts['outliers_in_a_row'][axis] = 0
        if methods.is_noise_known(filter_, axis):
            innovation = result['innovation'][axis]
            squared = innovation * innovation / result['innovation_variance'][axis]
            counts['nis_sum'][axis] += min(squared, LARGEST_NIS)
            counts['nis_samples'][axis] += 1
            residual = state['taken'][axis] - state['filtered'][axis]
            squared = residual * residual / result['measurement_noise'][axis]
            counts['residual_sum'][axis] += min(squared, LARGEST_RESIDUAL)


# numba takes arrays from Python faster than their records.


@entry_kernel(
    read_only(np.int64),
    read_only((np.float64, 2)),
    read_only((np.float64, 2)),
    SAMPLE,
    FILTER,
    RESULT,
)
def step_samples(
    stamps: NDArray[np.int64],
    rates: NDArray[np.float64],
    accelerations: NDArray[np.float64],
    sample: NDArray[np.void],
    filter_: NDArray[np.void],
    results: NDArray[np.void],
) -> None:
    """Take n samples in by a loop over `step`, and keep the result of each."""
    now = sample[0]
    for i in range(len(stamps)):
        now['stamp'] = stamps[i]
        for axis in range(3):
            now['angular_velocity'][axis] = rates[i, axis]
            now['linear_acceleration'][axis] = accelerations[i, axis]
        step(now, filter_[0])
        results[i] = filter_[0]['state']['result']
