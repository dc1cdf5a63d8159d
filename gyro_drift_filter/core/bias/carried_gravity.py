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

"""Gravity, carried on by the rates of a body that is nearly still: whether it tilts slowly.

A body that tilts slowly is as still as one at rest, and the bias may have come to its rate by the
time. But it tilts: gravity moves as the rates less the bias say, g' = g x (w - b), where that of a
body at rest stands, whatever its bias has become.
"""

from enum import IntEnum
from typing import TypedDict

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.matrices import cross_product, vector_length
from gyro_drift_filter.core.rest.noise import random_walk_of, segment_variance
from gyro_drift_filter.core.rest.records import Rest, RestLengths
from gyro_drift_filter.core.rest.segment import block_mean, is_block_filled, segment_mean
from gyro_drift_filter.core.rest.standing import LEAST_GRAVITY

# A tilt is told from a stand where it would have moved gravity by so much, in m/s^2, and by so many
# deviations of its noise: the offset of an accelerometer moves as much while it warms up.
LEAST_MOVED, MOVED_DEVIATIONS = 0.05, 6.0
# In a block, in rad: what is beyond is no slow tilt, and more than the first order of a turn.
LARGEST_ANGLE = 0.02
# The rate of the segment is that of the tilt if it would have moved gravity by this share at least.
LEAST_SHARE = 0.7
# A rate is that of the bias, as far as gravity can tell, within so many deviations.
SAME_RATE_DEVIATIONS = 3.0
# A tilt too slow to be told within so many s is slower than 0.02 deg/s.
LONGEST_SECONDS = 60.0


class TiltEvidence(IntEnum):
    """What gravity says of a segment that may be one of a slow tilt."""

    NONE = 0  # nothing: there is no accelerometer
    SAME = 1  # it has the rate of the bias that gravity is carried on with, but for a turn about it
    UNDECIDED = 2  # it has another one, and gravity does not tell yet
    TOO_SLOW = 3  # nor within `LONGEST_SECONDS`
    STANDS = 4  # gravity has not moved with the rates
    TILT = 5  # it has


class CarriedGravity(TypedDict):
    """Where gravity is now if the rates since a segment, less a bias, are a turn.

    That bias is the last one that is known to be no tilt: gravity stood, or it has lasted, or the
    robot has said that it stands, or it was a first rest.
    """

    bias: PerAxis  # rad/s
    known: bool
    start: PerAxis  # m/s^2, gravity in the segment
    start_blocks: int  # of that
    seconds: float  # since then
    rate: PerAxis  # rad/s, mean of the last block
    gravity: PerAxis  # m/s^2, before that
    step: PerAxis  # m/s^2, by which a tilt at the rate of the segment moves it in half of that
    tilt_rate: PerAxis  # rad/s, of the last tilt that was told
    undecided: bool  # whether segments have been learned that may be of a tilt
    undecided_seconds: float  # since the first of them
    undecided_rate: PerAxis  # rad/s, of the last of them
    evidence: int  # a member of TiltEvidence, of the last segment


CARRIED_GRAVITY = record(CarriedGravity)


@kernel
def lose_gravity(carried: CarriedGravity) -> None:
    """Forget it: the body has moved fast, or nobody has measured whether it has."""
    carried['known'] = False
    carried['evidence'] = TiltEvidence.NONE


@kernel
def forget_gravity(carried: CarriedGravity) -> None:
    """Forget it, and what may be of a tilt: time has jumped, or the bias has begun anew."""
    lose_gravity(carried)
    carried['undecided'] = False


@kernel
def carry_on_with(carried: CarriedGravity, bias: PerAxis) -> None:
    """Carry gravity on with a bias (3,) in rad/s that has been shown now."""
    for axis in range(3):
        carried['bias'][axis] = bias[axis]


@kernel
def carry_gravity(carried: CarriedGravity, rest: Rest, lengths: RestLengths) -> None:
    """Carry gravity on over the last block, and take the rates of the full one.

    So it is known before a motion that ends a rest.
    """
    carried['undecided_seconds'] += lengths['block_seconds']
    if carried['undecided_seconds'] > LONGEST_SECONDS:
        carried['undecided'] = False
    if not carried['known']:
        return
    if not is_block_filled(rest, lengths) or rest['force']['late'] > 0:
        lose_gravity(carried)
        return
    gravity, bias, rate = carried['gravity'], carried['bias'], carried['rate']
    seconds = lengths['block_seconds']
    a, b, c = rate[0] - bias[0], rate[1] - bias[1], rate[2] - bias[2]
    if not vector_length(a, b, c) * seconds < LARGEST_ANGLE:
        lose_gravity(carried)
        return
    x, y, z = cross_product(gravity[0], gravity[1], gravity[2], a, b, c)
    gravity[0] += x * seconds
    gravity[1] += y * seconds
    gravity[2] += z * seconds
    carried['seconds'] += seconds
    for axis in range(3):
        rate[axis] = block_mean(rest, axis)


@kernel
def judge_tilt(carried: CarriedGravity, rest: Rest, lengths: RestLengths, whole: bool) -> None:
    """Note what gravity says of the segment, and carry it on from there unless that is undecided.

    From a `whole` segment, as a motion may have begun in another.
    """
    known, before = carried['known'], carried['evidence']
    _take_step(carried, rest, lengths)
    gravity = carried['gravity']
    if vector_length(gravity[0], gravity[1], gravity[2]) < LEAST_GRAVITY:
        lose_gravity(carried)
        return
    begins_anew = True
    evidence = _shown_by_gravity(carried, rest, lengths)
    if evidence == TiltEvidence.TILT:
        for axis in range(3):
            carried['tilt_rate'][axis] = segment_mean(rest, axis)
    elif evidence == TiltEvidence.UNDECIDED:
        if known and carried['seconds'] >= LONGEST_SECONDS:
            evidence = TiltEvidence.TOO_SLOW
        elif not _moves_gravity(carried, rest, lengths):
            evidence = TiltEvidence.SAME
        else:
            begins_anew = not known
            # A tilt goes on as long as it has the same rate, up to `LONGEST_SECONDS`.
            if before == TiltEvidence.TILT and has_rate(rest, carried['tilt_rate']):
                evidence = TiltEvidence.TILT
    carried['evidence'] = evidence
    if whole and begins_anew:
        _start(carried, rest)


@kernel
def _take_step(carried: CarriedGravity, rest: Rest, lengths: RestLengths) -> None:
    """Take how far a tilt at the rate of the segment moves gravity in half of it.

    Where gravity is not known, it is that of the segment.
    """
    gravity, step = carried['gravity'], carried['step']
    if not carried['known']:
        for axis in range(3):
            gravity[axis] = segment_mean(rest, 3 + axis)
    seconds = 0.5 * rest['blocks'] * lengths['block_seconds']
    bias = carried['bias']
    a = (segment_mean(rest, 0) - bias[0]) * seconds
    b = (segment_mean(rest, 1) - bias[1]) * seconds
    c = (segment_mean(rest, 2) - bias[2]) * seconds
    step[0], step[1], step[2] = cross_product(gravity[0], gravity[1], gravity[2], a, b, c)


@kernel
def _moves_gravity(carried: CarriedGravity, rest: Rest, lengths: RestLengths) -> bool:
    """Return whether the segment has a rate that moves gravity by more than its noise would."""
    gravity, step = carried['gravity'], carried['step']
    size = vector_length(gravity[0], gravity[1], gravity[2])
    lever = 0.5 * rest['blocks'] * lengths['block_seconds'] * size
    noise = segment_variance(rest, 0) + segment_variance(rest, 1) + segment_variance(rest, 2)
    distance = vector_length(step[0], step[1], step[2])
    return is_beyond_gate(distance, SAME_RATE_DEVIATIONS, lever * lever * noise)


@kernel
def has_rate(rest: Rest, rate: PerAxis) -> bool:
    """Return whether the segment has the rate (3,) in rad/s of another one, by their noise."""
    for axis in range(3):
        distance = segment_mean(rest, axis) - rate[axis]
        if is_beyond_gate(distance, SAME_RATE_DEVIATIONS, 2.0 * segment_variance(rest, axis)):
            return False
    return True


@kernel
def _shown_by_gravity(carried: CarriedGravity, rest: Rest, lengths: RestLengths) -> TiltEvidence:
    """Return whether gravity has moved as it was carried, or stands, if that can be told yet."""
    if not carried['known']:
        return TiltEvidence.UNDECIDED
    start, gravity, step = carried['start'], carried['gravity'], carried['step']
    # At the middle of the segment.
    x = gravity[0] - step[0] - start[0]
    y = gravity[1] - step[1] - start[1]
    z = gravity[2] - step[2] - start[2]
    distance = vector_length(x, y, z)
    size = vector_length(start[0], start[1], start[2])
    noise = walk = 0.0
    for axis in range(3):
        noise = max(noise, rest['signals'][3 + axis]['scatter'])
        walk = max(walk, random_walk_of(rest, axis, lengths))
    # Noise that is slow makes the means of blocks vary more.
    noise *= max(rest['acceleration_ratio'], 1.0)
    variance = noise * (1.0 / rest['blocks'] + 1.0 / carried['start_blocks'])
    variance += size * size * walk * rest['variance_ratio'] * carried['seconds']
    beyond = distance - LEAST_MOVED
    if beyond <= 0.0 or not is_beyond_gate(beyond, MOVED_DEVIATIONS, variance):
        return TiltEvidence.UNDECIDED
    # At the rate of the segment it would have moved by so much since then.
    since = carried['seconds'] / (0.5 * rest['blocks'] * lengths['block_seconds'])
    by_rate = vector_length(step[0], step[1], step[2]) * since
    along = (segment_mean(rest, 3) - start[0]) * x
    along += (segment_mean(rest, 4) - start[1]) * y
    along += (segment_mean(rest, 5) - start[2]) * z
    if along < 0.5 * distance * distance:
        return TiltEvidence.STANDS
    return TiltEvidence.TILT if by_rate > LEAST_SHARE * distance else TiltEvidence.UNDECIDED


@kernel
def _start(carried: CarriedGravity, rest: Rest) -> None:
    """Carry gravity on from the segment, to its end already where it may tilt."""
    share = 0.0 if carried['evidence'] == TiltEvidence.STANDS else 1.0
    for axis in range(3):
        carried['start'][axis] = segment_mean(rest, 3 + axis)
        carried['gravity'][axis] = carried['start'][axis] + share * carried['step'][axis]
        carried['rate'][axis] = rest['signals'][axis]['waiting_mean']
    carried['start_blocks'] = rest['blocks']
    carried['seconds'] = 0.0
    carried['known'] = True
