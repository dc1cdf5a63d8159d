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

"""The rest under way, the noise that is known, and the lengths of values and blocks."""

from collections.abc import Sequence
from enum import IntEnum
from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.rest.force import FORCE, Force
from gyro_drift_filter.core.rest.spikes import WAITING, Waiting

VALUE_SECONDS = 0.01
BLOCK_SECONDS = 0.125
LEAST_BLOCK = 8  # values
SEGMENT_BLOCKS = 16
HALF = 8  # blocks

SIGNALS = 6
PerSignal = Annotated[NDArray[np.float64], np.float64, (SIGNALS,)]


class MeanSums(TypedDict):
    """Sums over the means of blocks, in the unit of their signal."""

    first: float
    last: float
    means: float  # sum of them less the first one
    mean_squares: float
    steps: float  # sum of squared differences of one mean and the next


MEAN_SUMS = record(MeanSums)


class Signal(TypedDict):
    """One of the six signals: what is known of its noise, and the sums under way."""

    least_variance: float
    variance: float  # of values about their block's mean
    scatter: float  # variance of the means of blocks
    value: float  # sum over the value under way
    # the block under way, and the one before, which waits for the verdict on this one
    origin: float
    sum: float
    squares: float
    waiting_mean: float
    waiting_variance: float
    # the segment
    segment: MeanSums
    variances: float
    largest_variance: float  # of the half under way; read only where the noise is not known yet
    # of the first `HALF` blocks of the segment
    early_means: float
    early_mean_squares: float
    early_variances: float
    early_largest_variance: float
    early_steps: float  # with the step from it to the later half
    late_first: float  # mean of the first block of the later half
    before: float  # mean of the segment before
    before_blocks: int  # of that segment; 0 where it is of another rest


SIGNAL = record(Signal)


class Halves(IntEnum):
    """What became of the halves of a segment that did not hold together."""

    WHOLE = 0  # there was no such segment
    LATER = 1  # this segment begins with the later half of it
    LEFT_BEHIND = 2  # that half has been left behind, up to the end of this segment


class BlockOutcome(IntEnum):
    """What a block brought."""

    NOTHING = 0
    SEGMENT = 1  # a segment is ready
    END_OF_REST = 2  # the block ended the rest, and what there is of the segment is ready
    STOP = 3  # it ended a whole rest that is shorter than a segment, and which is ready
    STEADY = 4  # the segment under way is steady, if not known as rest yet


class Obstacle(IntEnum):
    """Why the last block, or the segment that it completes, is no rest."""

    NONE = 0  # it is, or nothing speaks against it yet
    FEW_SAMPLES = 1  # more than half are missing or were held back
    VARIES = 2  # the values of the block vary more than noise does
    MOVED = 3  # the mean of the block is another one than that of the segment
    SCATTERS = 4  # the means of blocks scatter more than those of noise
    DRIFTS = 5  # they move smoothly, or from one half of the segment to the other
    UNEVEN = 6  # the values vary far more at one time than at another
    LOUD = 7  # the accelerations vary far more than at a rest before
    TILTED = 8  # gravity is elsewhere than in the segment before
    PUSHED = 9  # the acceleration has changed since the last rest by more than the body has turned
    NOT_ACCEPTED = 10  # its rate is not accepted as the bias (bias/acceptance.py)
    HINTED_MOTION = 11  # the robot itself says that it moves, which leaves its samples out


class Rest(TypedDict):
    """The rest under way, and what is known of the noise."""

    waiting: Annotated[Waiting, WAITING, ()]
    signals: Annotated[Sequence[Signal], SIGNAL, (SIGNALS,)]
    force: Annotated[Force, FORCE, ()]
    known: bool  # what the noise is
    calm_known: bool  # what that of the accelerations was, where `known` was doubted
    learned: int  # segments that it was learned from
    # of the means of the gyroscope's segments, to what the scatter of their blocks says
    variance_ratio: float
    acceleration_ratio: float  # the same of the accelerometer's, by how blocks follow each other
    blocks_since_rest: int
    # since the last segment that was accepted
    seconds_since_segment: float
    turn: PerAxis  # rad, sum of the turns of blocks
    turned: float  # rad, sum of their sizes; infinite where not all was measured
    standing_seconds: float  # for which gravity has stood, since the last rest
    gravity: PerAxis  # m/s^2, when it began to
    standing: Annotated[Sequence[MeanSums], MEAN_SUMS, (3,)]  # of the rates meanwhile
    standing_blocks: int  # for which it has stood, rest or not
    hinted_motion: bool  # a hint of the robot has said so in the block under way
    at_rest: bool
    sudden: bool  # the last motion showed in a single block
    obstacle: int  # a member of Obstacle
    obstacle_signal: int  # of which signal, where it is that of one
    samples: int  # since the start of the value, missing ones among them
    averaged: int  # of them, those that are in its mean
    index: int  # values since the start of the block, missing ones among them
    count: int  # values in it
    run: int  # still blocks in a row
    blocks: int  # in the segment
    halves: int  # a member of Halves


class OtherNoise(TypedDict):
    """A noise at rest that may have taken the place of the one that is known."""

    rest: Rest  # by that noise
    variances: PerSignal  # of values, in its last segment
    segments: int  # that had it, one after the other
    mean_correlation: PerAxis  # of a block mean with the next one, over the last of them
    shaken: PerSignal  # mean variance of values since the last rest


class RestLengths(TypedDict):
    """Lengths for one sample period."""

    value: int  # samples that are averaged to a value
    block: int  # values in a block
    block_seconds: float
    least_rest: float  # s, that a sensor stands still until it is found at rest the first time


REST = record(Rest)
REST_LENGTHS = record(RestLengths)


@kernel
def derive_lengths(period: float, lengths: RestLengths) -> None:
    """Fill the lengths for a sample period in s."""
    lengths['value'] = max(1, int(VALUE_SECONDS / period + 0.5))
    seconds = lengths['value'] * period
    lengths['block'] = max(LEAST_BLOCK, int(BLOCK_SECONDS / seconds + 0.5))
    lengths['block_seconds'] = lengths['block'] * seconds
    # A block before the segment and one after it are left out.
    lengths['least_rest'] = (SEGMENT_BLOCKS + 2) * lengths['block_seconds']
