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

"""Sums over a run of the filter, sample by sample, so that a run of any length takes no memory."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import (
    CountPerAxis,
    PerAxis,
    entry_kernel,
    kernel,
    read_only,
    record,
)
from gyro_drift_filter.core.matrices import vector_length
from gyro_drift_filter.core.methods import WITHIN_LIMITS
from gyro_drift_filter.core.methods.reasons import Decision, Reason, decision_of
from gyro_drift_filter.core.sample import LARGEST_ACCELERATION, SampleStatus, is_usable, is_zero
from gyro_drift_filter.messages.imu import IMU, Imu, ImuKind
from gyro_drift_filter.report.sample_times import SampleTimes, sample_seconds

# Less than this, in m/s^2, is no gravity: the sensor falls, or has no accelerometer.
LEAST_ACCELERATION = 1.0
# The end of a rest counts by blocks of so many s, as the start of a motion is in the last ones: at
# the end of a recording, too, as somebody picks the sensor up to stop it.
REST_BLOCK_SECONDS = 1.0
# Outliers are counted for each such stretch of log time, in ns.
OUTLIER_STRETCH = 10_000_000_000


class Noise(TypedDict):
    """What Welford's formulas need of raw and filtered rates."""

    count: int
    seconds: float
    raw_mean: PerAxis  # rad/s
    raw_squares: PerAxis  # sum of squared distances from the mean, (rad/s)^2
    filtered_mean: PerAxis
    filtered_squares: PerAxis


class Shown(IntEnum):
    """What samples that were flagged in a row were, as the next one that was not flagged shows.

    Where axes differ, the largest one counts.
    """

    NOTHING = 0
    MOTION = 1
    KNOCK = 2
    OUTLIER = 3


class Outliers(TypedDict):
    """Where samples were flagged as outliers. Times are log times in ns, 0 before there was one."""

    axes: CountPerAxis
    at_rest: int  # samples with an outlier on some axis
    in_motion: int
    first: int
    last: int
    stretch: int  # the stretch under way, counted from the first one on
    in_stretch: int
    busiest: int  # the stretch with most of them
    in_busiest: int
    in_a_row: int  # samples that the next ones have not judged yet
    is_open: PerAxis  # 0 or 1: whether some of these are of this axis
    shown: int  # `Shown`: what is known of them already
    were_outliers: int  # by what the samples behind them showed
    were_knocks: int
    were_motion: int


class RunSums(TypedDict):
    """The sums of one run."""

    samples: int
    times: SampleTimes
    least: PerAxis  # raw rate, rad/s
    largest: PerAxis  # the same
    seconds: float  # that the samples stand for
    resting: bool
    rests: int
    rest_seconds: float
    known: bool  # whether the bias was learned at rest, or given as learned
    rested_at: int  # log time in ns of the first sample at rest, if there were rests
    first_bias: PerAxis  # of the sample from which on the bias was known, rad/s
    up: PerAxis  # direction in which gravity is felt, of length 1
    up_seconds: PerAxis  # its sum over time, s
    up_before: PerAxis  # the same before the bias was known
    up_squares: PerAxis  # sum of its squares over time, s
    taken: float  # turn about the vertical that the bias would have made, rad
    taken_before: float  # of that before the bias was known
    turned: float  # rad, by the filtered rates, about any axis
    block: Noise  # at rest, under way
    pending: Noise  # the block before, which counts when the next one is whole
    rest: Noise  # of the rest under way
    noise: Noise  # of all rests, each about its own mean, which is not kept
    noise_rests: int  # that `noise` is of
    moving: int  # samples in motion without an outlier
    changed: PerAxis  # sum of squares of what the method makes of them but the bias, (rad/s)^2
    outliers: Outliers


RUN_SUMS = record(RunSums)


@entry_kernel(IMU, read_only(np.int64), read_only(np.float64), RUN_SUMS)
def add_run(
    imus: Sequence[Imu],
    log_times: NDArray[np.int64],
    matrix: NDArray[np.float64],
    all_sums: Sequence[RunSums],
) -> None:
    """Add filtered messages to the sums.

    Args:
        imus: (n,) IMU with their results.
        log_times: (n,) in ns.
        matrix: (9,) that turns raw rates into calibrated ones.
        all_sums: (1,).
    """
    sums = all_sums[0]
    for i in range(len(imus)):
        imu = imus[i]
        if imu['kind'] != ImuKind.GOOD or imu['result']['status'] != SampleStatus.FILTERED:
            continue
        _note_outlier(imu, log_times[i], sums['outliers'])
        sample, raw = imu['sample'], imu['sample']['angular_velocity']
        if not (is_usable(raw[0]) and is_usable(raw[1]) and is_usable(raw[2])):
            continue
        step = sample_seconds(sample['stamp'], log_times[i], sums['times'])
        for axis in range(3):
            if sums['samples'] == 0 or raw[axis] < sums['least'][axis]:
                sums['least'][axis] = raw[axis]
            if sums['samples'] == 0 or raw[axis] > sums['largest'][axis]:
                sums['largest'][axis] = raw[axis]
        sums['samples'] += 1
        sums['seconds'] += step
        if sums['rests'] == 0:
            sums['rested_at'] = log_times[i]
        _add_heading(imu, step, sums)
        _add_rest(imu, matrix, step, sums)


@kernel
def _add_heading(imu: Imu, step: float, sums: RunSums) -> None:
    """Add what the bias turns about the vertical within a step in s."""
    result, force, up = imu['result'], imu['sample']['linear_acceleration'], sums['up']
    if result['at_rest'] > 0.0 and not sums['known']:
        sums['known'] = True
        for axis in range(3):
            sums['first_bias'][axis] = result['bias'][axis]
    length = vector_length(force[0], force[1], force[2])
    if LEAST_ACCELERATION < length < LARGEST_ACCELERATION:
        for axis in range(3):
            up[axis] = force[axis] / length
    about, turned = 0.0, 0.0
    for axis in range(3):
        about += up[axis] * result['bias'][axis]
        turned += result['angular_velocity'][axis] * result['angular_velocity'][axis]
        sums['up_seconds'][axis] += up[axis] * step
        sums['up_squares'][axis] += up[axis] * up[axis] * step
        if not sums['known']:
            sums['up_before'][axis] += up[axis] * step
    sums['taken'] += about * step
    sums['turned'] += np.sqrt(turned) * step
    if not sums['known']:
        sums['taken_before'] += about * step


@kernel
def _add_rest(imu: Imu, matrix: NDArray[np.float64], step: float, sums: RunSums) -> None:
    """Add the noise of a sample, where it is one at rest; an outlier is no noise."""
    result, raw, block = imu['result'], imu['sample']['angular_velocity'], sums['block']
    if result['at_rest'] == 0.0:
        if sums['resting']:
            close_rest(sums)
        sums['resting'] = False
        if result['outlier'][0] + result['outlier'][1] + result['outlier'][2] == 0.0:
            sums['moving'] += 1
            for axis in range(3):
                change = result['angular_velocity'][axis]
                for k in range(3):
                    change -= matrix[3 * axis + k] * (raw[k] - result['bias'][k])
                sums['changed'][axis] += change * change
        return
    if not sums['resting']:
        sums['rests'] += 1
    sums['resting'] = True
    sums['rest_seconds'] += step
    if result['outlier'][0] + result['outlier'][1] + result['outlier'][2] > 0.0:
        return
    block['count'] += 1
    block['seconds'] += step
    share = 1.0 / block['count']
    for axis in range(3):
        rate = 0.0
        for k in range(3):
            rate += matrix[3 * axis + k] * raw[k]
        distance = rate - block['raw_mean'][axis]
        block['raw_mean'][axis] += share * distance
        block['raw_squares'][axis] += distance * (rate - block['raw_mean'][axis])
        rate = result['angular_velocity'][axis]
        distance = rate - block['filtered_mean'][axis]
        block['filtered_mean'][axis] += share * distance
        block['filtered_squares'][axis] += distance * (rate - block['filtered_mean'][axis])
    if block['seconds'] >= REST_BLOCK_SECONDS:
        _merge(sums['pending'], sums['rest'])
        _clear(sums['pending'])
        _merge(block, sums['pending'])
        _clear(block)


@kernel
def close_rest(sums: RunSums) -> None:
    """End the rest under way; what came last is left out, as it may be motion already."""
    rest, noise = sums['rest'], sums['noise']
    sums['noise_rests'] += 1 if rest['count'] > 0 else 0
    noise['count'] += rest['count']
    noise['seconds'] += rest['seconds']
    for axis in range(3):
        noise['raw_squares'][axis] += rest['raw_squares'][axis]
        noise['filtered_squares'][axis] += rest['filtered_squares'][axis]
    _clear(sums['block'])
    _clear(sums['pending'])
    _clear(rest)


@entry_kernel(RUN_SUMS)
def end_run(all_sums: Sequence[RunSums]) -> None:
    """End the rest that the recording ends with."""
    close_rest(all_sums[0])


@kernel
def _merge(part: Noise, whole: Noise) -> None:
    """Add one set of sums to another, by the formula of Chan, Golub and LeVeque."""
    count = part['count'] + whole['count']
    if part['count'] == 0:
        return
    share = part['count'] / count
    for axis in range(3):
        distance = part['raw_mean'][axis] - whole['raw_mean'][axis]
        whole['raw_mean'][axis] += share * distance
        between = whole['count'] * share * distance * distance
        whole['raw_squares'][axis] += part['raw_squares'][axis] + between
        distance = part['filtered_mean'][axis] - whole['filtered_mean'][axis]
        whole['filtered_mean'][axis] += share * distance
        between = whole['count'] * share * distance * distance
        whole['filtered_squares'][axis] += part['filtered_squares'][axis] + between
    whole['count'] = count
    whole['seconds'] += part['seconds']


@kernel
def _clear(noise: Noise) -> None:
    noise['count'] = 0
    noise['seconds'] = 0.0
    for axis in range(3):
        noise['raw_mean'][axis] = 0.0
        noise['raw_squares'][axis] = 0.0
        noise['filtered_mean'][axis] = 0.0
        noise['filtered_squares'][axis] = 0.0


@kernel
def _note_outlier(imu: Imu, log_time: int, found: Outliers) -> None:
    """Count a sample that was flagged; what is no usable number is none."""
    result, flagged = imu['result'], False
    for axis in range(3):
        if not is_usable(imu['sample']['angular_velocity'][axis]):
            continue
        if result['outlier'][axis] > 0.0:
            found['axes'][axis] += 1
            found['is_open'][axis] = 1.0
            flagged = True
        elif found['is_open'][axis] > 0.0 and result['reason'][axis] != Reason.REPEATED:
            found['is_open'][axis] = 0.0
            shown = _shown_by(result['reason'][axis])
            if shown > found['shown']:
                found['shown'] = shown
    if not flagged:
        if found['in_a_row'] > 0 and is_zero(found['is_open']):
            _close_row(found)
        return
    found['in_a_row'] += 1
    if result['at_rest'] > 0.0:
        found['at_rest'] += 1
    else:
        found['in_motion'] += 1
    if found['first'] == 0:
        found['first'] = log_time
    found['last'] = log_time
    stretch = (log_time - found['first']) // OUTLIER_STRETCH
    if stretch != found['stretch']:
        found['stretch'] = stretch
        found['in_stretch'] = 0
    found['in_stretch'] += 1
    if found['in_stretch'] > found['in_busiest']:
        found['in_busiest'] = found['in_stretch']
        found['busiest'] = stretch


@kernel
def _shown_by(reason: int) -> int:
    """Return what a sample shows of those of its axis that were flagged just before it.

    The paper's methods never take such a sample for anything else than an outlier.
    """
    if reason == WITHIN_LIMITS or reason == Reason.RETURNED:
        return Shown.OUTLIER
    if reason == Reason.KNOCKED:
        return Shown.KNOCK
    # Reads that failed are no motion, if they went on for too long to be held back.
    is_motion = decision_of(reason) == Decision.START_ANEW and reason != Reason.DROPOUT_GOES_ON
    return Shown.MOTION if is_motion else Shown.NOTHING


@kernel
def _close_row(found: Outliers) -> None:
    """Count samples that were flagged in a row by what they turned out to be."""
    if found['shown'] == Shown.OUTLIER:
        found['were_outliers'] += found['in_a_row']
    elif found['shown'] == Shown.KNOCK:
        found['were_knocks'] += found['in_a_row']
    elif found['shown'] == Shown.MOTION:
        found['were_motion'] += found['in_a_row']
    found['in_a_row'] = 0
    found['shown'] = Shown.NOTHING


def no_sums() -> Any:
    """Return RUN_SUMS (1,) of nothing; without an accelerometer z is taken for up (REP-145)."""
    sums: Any = np.zeros(1, RUN_SUMS)
    sums['up'][0, 2] = 1.0
    return sums
