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

"""The bias, and what the last segments of rest say of it."""

from collections.abc import MutableSequence
from enum import IntEnum
from typing import Annotated, TypedDict

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.bias.carried_gravity import CarriedGravity
from gyro_drift_filter.core.bias.motion_state import MotionBias, SharedBias
from gyro_drift_filter.core.bias.shaken_stand import ShakenStand
from gyro_drift_filter.core.bias.slow_turn import SlowTurn
from gyro_drift_filter.core.bias.swing import Swing
from gyro_drift_filter.core.rest.records import OtherNoise, Rest

RECENT = 8  # segments of one rest that have to agree


class Hint(IntEnum):
    """What the robot says of its own motion."""

    NONE = 0
    MOVES = 1
    STANDS = 2


class RestSegment(TypedDict):
    """A segment of the rest under way, and the bias before it was taken in."""

    mean: PerAxis  # rad/s
    noise: PerAxis  # variance of the mean, (rad/s)^2
    # of the bias before the segment was taken in
    bias: PerAxis
    variance: PerAxis
    in_motion: SharedBias
    # those of the state when the segment was taken in; 0 where it was not
    process_noise: float
    largest_process_noise: float


REST_SEGMENT = record(RestSegment)


class Bias(TypedDict):
    """The bias, and what the last segments of rest say of it."""

    rest: Rest
    other_noise: OtherNoise
    known: bool
    bias: PerAxis  # rad/s
    variance: PerAxis  # (rad/s)^2
    # variance of the provisional one by its scatter, (rad/s)^2; 0 where there is none
    provisional_variance: PerAxis
    provisional_seconds: float  # for how long its rates were steady; 0 where gravity stood instead
    motion: MotionBias  # the bias in motion
    # the same from a wide prior, until a rest of this run has shown a bias, or there is a
    # provisional one
    wide_prior: MotionBias
    # those that the wide prior began with, in rad/s and (rad/s)^2
    assumed_bias: PerAxis
    assumed_variance: PerAxis
    contradicts: bool  # rates and accelerations are not of one motion
    vertical: PerAxis  # mean direction of gravity in motion, of length one and less
    walk: float  # share of the random walk's variance that the bias takes; in a warm-up above 1
    walk_at_rest: float  # the same at rest, of what is allowed there
    process_noise: float  # (rad/s)^2, by which the variance has grown since the last segment
    largest_process_noise: float  # (rad/s)^2, the same with all of the random walk
    recent: Annotated[MutableSequence[RestSegment], REST_SEGMENT, (RECENT,)]  # the last one first
    recent_count: int
    gravity: PerAxis  # m/s^2, of the last of them, or of the rest before
    carried: CarriedGravity  # since one of them, or since one that was refused
    before_tilt: Annotated[RestSegment, REST_SEGMENT, ()]  # the first that may be of one
    lag: PerAxis  # rad/s, the mean of the last innovations of this rest
    wander: PerAxis  # (rad/s)^2, mean of what squared innovations at rest exceed their variance by
    shaken_stand: ShakenStand
    swing: Swing  # slow motion that may pass for rest
    hint: int  # a member of Hint
    hint_seconds: float  # until it is forgotten
    temperature: float  # in deg C, when the bias was last widened for it; NaN before the first
    temperature_before: float  # in deg C, where it began to change this way, or at the last rest
    # the stillness under way, whether its rate is accepted as the bias or not
    still_seconds: float
    still_blocks: float
    still_sum: PerAxis  # rad/s
    seconds_since_rest: float  # since the last rest, or since the start where there was none
    doubted_segments: int  # of rest, to go until one is accepted after a slow turn
    turn: SlowTurn  # the rate of rest that was not accepted
    # mean logarithms of the variance of the rates, and of the accelerations, in the quietest
    # segment that has shown the bias
    quietest_rates: float
    quietest_accelerations: float
    rest_beyond_max: bool  # the stillness under way has a rate beyond the largest bias
    # segments of rest that were counted
    segments: int  # that the bias was learned from
    segments_beyond_max: int  # with a rate that no bias has
    segments_turning: int  # with a rate that the bias can't have come to
    corrected: int  # times that motion alone has shown another bias
    restored: bool  # that of an earlier run is in use again, after motion had shown another


BIAS_RECORD = record(Bias)


@kernel
def bias_variance(state: Bias, axis: int) -> float:
    """Return the variance of the bias at rest by now, in (rad/s)^2."""
    return float(state['variance'][axis] + state['process_noise'])


@kernel
def wander_variance(state: Bias, axis: int) -> float:
    """Return the variance by which the bias wanders about its estimate at rest, in (rad/s)^2.

    It is apart from `bias_variance`, as an estimate that used it would follow slow turns.
    """
    return max(float(state['wander'][axis]), 0.0)


@kernel
def is_remembered(state: Bias) -> bool:
    """Return whether the bias is one of an earlier run, and no rest of this one has shown it."""
    return bool(state['known'] and state['segments'] == 0)


@kernel
def follows_wide_prior(state: Bias) -> bool:
    """Return whether the wide prior is followed: no bias is known but one of an earlier run."""
    return bool(not has_bias(state) or is_remembered(state))


@kernel
def has_provisional(state: Bias) -> bool:
    """Return whether the bias is a provisional one (`provisional.py`)."""
    return bool(state['provisional_variance'][0] > 0.0)


@kernel
def has_bias(state: Bias) -> bool:
    """Return whether a bias is known, or a provisional one."""
    return bool(state['known'] or has_provisional(state))


@kernel
def has_learned_bias(state: Bias) -> bool:
    """Return whether there is more than a guess: what `has_bias` asks for, or shown by motion."""
    return bool(has_bias(state) or state['corrected'] > 0)


@kernel
def forget_contradiction(state: Bias) -> None:
    """Forget that rates have contradicted accelerations: something else explains that."""
    state['contradicts'] = False
    state['motion']['contradictions'] = 0


@kernel
def widen(state: Bias, variance: float) -> None:
    """Take a step of the bias into account, by its variance in (rad/s)^2."""
    state['process_noise'] += variance
    state['motion']['pending_process_noise'] += variance
    state['wide_prior']['pending_process_noise'] += variance
    state['largest_process_noise'] += variance


@kernel
def take_process_noise_in(state: Bias) -> None:
    """Count what the bias has walked by now as uncertainty of where it began.

    Motion replaces only a part of the bias, and nothing is known of how the rest has walked.
    """
    for axis in range(3):
        state['variance'][axis] += state['process_noise']
        state['assumed_variance'][axis] += state['process_noise']
    state['largest_process_noise'] -= state['process_noise']
    state['process_noise'] = 0.0
