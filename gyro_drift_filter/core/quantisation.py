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

"""Counts of the converter: how large one is, and whether they are cut towards zero or rounded.

A sensor that cuts loses half a count, always towards zero. At rest with a bias that is a part of
the bias, in motion about zero it is not, and the heading drifts. The noise at rest shows it
(`cut_at_rest.py`), and so does motion: rates that come from afar land on each count as often as it
is wide, and zero is twice as wide as the others where counts are cut. A driver's dead band makes
zero wide, too, but takes it from the counts beside it. Both are judged over all axes together by
the likelihood ratio (Wald's sequential test).
"""

import math
from enum import IntEnum
from typing import Annotated, TypedDict

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, inlined_kernel, kernel, record
from gyro_drift_filter.core.cut_at_rest import (
    COUNTS_AT_REST,
    LEAST_SAMPLES,
    CountsAtRest,
    add_counts_at_rest,
    evidence_of_cut,
    forget_counts_at_rest,
    moments_at_rest,
    note_count_at_rest,
)
from gyro_drift_filter.core.sample import COUNT_VARIANCE, is_zero

# A change of one count is a vote for that count, and one that is smaller, or no whole number of
# counts, a vote against it. With this lead of votes the count is known.
CERTAIN_VOTES = 50
# This lead is not by chance: of changes of any size one in ten is of a given one.
LIKELY_VOTES = 10
# After so many changes without a count that is known there is none: the rates are calibrated or
# averaged.
LONGEST_SEARCH = 2000
# Changes of more counts than this are left out, as a small error of the count adds up.
LARGEST_STEPS = 10.0
SAME_COUNT = 0.05  # counts, by which the change of one count may be off
PART = 0.1  # counts, from which on a rate or a change is no whole number of them
LEAST_COUNT = 1e-5  # rad/s: half of a finer one is below all bias
# A rate has come from afar with a change of so many counts, and lands on the counts up to this.
AFAR_COUNTS = 8.0
NEAR_COUNTS = 2
# How much likelier a landing is where zero is twice as wide: 2/6 instead of 1/5, 4/6 of 4/5; and
# one beside zero where these counts are as wide as the next: 1/2 instead of 1/4, 1/2 of 3/4.
ZERO_IF_WIDE, OTHER_IF_WIDE = math.log(5.0 / 3.0), math.log(5.0 / 6.0)
BESIDE_IF_WHOLE, NEXT_IF_WHOLE = math.log(2.0), math.log(2.0 / 3.0)
SURE = math.log(1000.0)
LARGEST_EVIDENCE = math.log(1e6)
# Rests are looked at again when they have so many times the samples, and begin anew after so many,
# as the bias moves on.
NEXT_LOOK, MOST_SAMPLES = 2, 100_000


class Choice(IntEnum):
    """The choices of `input.quantisation`, in their order."""

    AUTO = 0
    NONE = 1
    ROUND = 2
    TRUNCATE = 3


class Quantisation(TypedDict):
    """The counts of the three axes, and what landings say of them."""

    count: PerAxis  # rad/s, what one is worth, as far as is known
    votes: CountPerAxis
    change: PerAxis  # of the rates with the last sample, rad/s
    changes: CountPerAxis  # that have been looked at for it
    parts: CountPerAxis  # lead of changes that were smaller than the known count
    absent: bool  # the search has ended on all axes, and found none
    # logarithms of likelihood ratios
    wide_zero: float
    whole_neighbours: float
    truncated: bool
    still: Annotated[CountsAtRest, COUNTS_AT_REST, ()]  # that may be a rest, or part of one
    rests: Annotated[CountsAtRest, COUNTS_AT_REST, ()]  # before that
    next_look: int  # at them, with so many samples; 0 for the first one
    rest_has_told: bool  # whether counts are cut, once


QUANTISATION = record(Quantisation)


@inlined_kernel
def note_counts(state: Quantisation, rate: PerAxis, before: PerAxis) -> bool:
    """Take rates (3,) in rad/s in, and those before.

    Returns:
        Whether `known_count` of an axis, or `truncated`, is another one now.
    """
    landed = known = False
    if state['absent']:
        return False
    for axis in range(3):
        change, count = rate[axis] - before[axis], state['count'][axis]
        if state['votes'][axis] < CERTAIN_VOTES:
            if LEAST_COUNT < abs(change) < math.inf and state['changes'][axis] < LONGEST_SEARCH:
                _look_for_count(state, axis, abs(change))
                known = known or state['votes'][axis] >= CERTAIN_VOTES
        # One branch instead of two that noise makes at random.
        elif (abs(change) > AFAR_COUNTS * count) & (abs(rate[axis]) < (NEAR_COUNTS + PART) * count):
            landed = _note_landing(state, axis, change, rate) or landed
        state['change'][axis] = change
    if not landed:
        return known
    truncated = state['truncated']
    if state['wide_zero'] < 0.0:
        state['truncated'] = False
    elif state['wide_zero'] > SURE and state['whole_neighbours'] > SURE:
        state['truncated'] = True
    return known or bool(state['truncated'] != truncated)


@kernel
def note_still(state: Quantisation, rate: PerAxis) -> None:
    """Take in rates (3,) in rad/s of what may be a rest, behind `note_counts`."""
    if state['absent'] or state['truncated'] or state['rest_has_told']:
        return
    seen = False
    for axis in range(3):
        count = known_count(state, axis)
        if count == 0.0:
            continue
        counts = rate[axis] / count
        whole = math.floor(counts + 0.5)
        if abs(counts - whole) < PART:
            note_count_at_rest(state['still'], axis, whole, state['change'][axis] / count)
            seen = True
    state['still']['samples'] += seen
    state['still']['zeros'] += seen and is_zero(rate)


@kernel
def forget_still(state: Quantisation) -> None:
    """Forget the last rates that might have been a rest."""
    forget_counts_at_rest(state['still'])


@kernel
def rest_finds_cut(state: Quantisation) -> bool:
    """Take in that the last still rates were a rest; return whether rests show now that it cuts.

    Motion may show later that it does not, and then has the last word.
    """
    rests = state['rests']
    add_counts_at_rest(state['still'], rests)
    if rests['samples'] < max(state['next_look'], LEAST_SAMPLES):
        return False
    state['next_look'] = NEXT_LOOK * rests['samples']
    evidence = evidence_of_cut(rests)
    state['rest_has_told'] = abs(evidence) > SURE
    if evidence > SURE:
        state['truncated'] = True
        state['wide_zero'] = state['whole_neighbours'] = LARGEST_EVIDENCE
        return True
    if rests['samples'] > MOST_SAMPLES:
        forget_counts_at_rest(rests)
        state['next_look'] = 0
    return False


@kernel
def loss_by_cut(state: Quantisation, axis: int) -> tuple[float, float]:
    """Return what the cut takes from the mean rate of an axis at rest, in rad/s.

    The second value is the factor by which half a count more makes the variance larger.
    """
    _, mean, variance = moments_at_rest(state['rests'], axis, 0.0)
    _, decoded, decoded_variance = moments_at_rest(state['rests'], axis, 0.5)
    growth = max(decoded_variance, COUNT_VARIANCE) / max(variance, COUNT_VARIANCE)
    return known_count(state, axis) * (decoded - mean), growth


@kernel
def is_refuted(state: Quantisation) -> bool:
    """Take the last changes in where the count is known; return whether it is none after all.

    Two sensors that take turns differ by their biases, which look like a count. Once one of them
    measures alone, its changes are parts of that. It is enough to look at some of the changes.
    """
    for axis in range(3):
        change, count = abs(state['change'][axis]), known_count(state, axis)
        if not LEAST_COUNT < change < (1.0 + SAME_COUNT) * count:
            continue
        smaller = change < (1.0 - SAME_COUNT) * count
        state['parts'][axis] = max(state['parts'][axis] + (1 if smaller else -1), 0)
        if state['parts'][axis] >= CERTAIN_VOTES:
            return True
    return False


@kernel
def forget_counts(state: Quantisation) -> None:
    """Search for the counts anew, and for how they are cut."""
    state['absent'] = state['truncated'] = state['rest_has_told'] = False
    forget_counts_at_rest(state['still'])
    forget_counts_at_rest(state['rests'])
    state['next_look'] = 0
    state['wide_zero'] = state['whole_neighbours'] = 0.0
    for axis in range(3):
        state['count'][axis] = 0.0
        state['votes'][axis] = state['changes'][axis] = state['parts'][axis] = 0


@kernel
def _look_for_count(state: Quantisation, axis: int, change: float) -> None:
    """Vote for the smallest change of which the others are multiples."""
    steps = change / state['count'][axis] if state['votes'][axis] > 0 else 0.0
    if steps > LARGEST_STEPS:
        return
    state['changes'][axis] += 1
    if abs(steps - 1.0) < SAME_COUNT:
        state['votes'][axis] += 1
    elif steps < 1.0 or abs(steps - math.floor(steps + 0.5)) > PART:
        state['votes'][axis] -= 1
        if state['votes'][axis] <= 0:
            state['count'][axis] = change
            state['votes'][axis] = 1
    if state['changes'][axis] == LONGEST_SEARCH:
        _end_search(state)


@kernel
def _end_search(state: Quantisation) -> None:
    state['absent'] = True
    for axis in range(3):
        searching = state['changes'][axis] < LONGEST_SEARCH
        if searching or state['votes'][axis] >= CERTAIN_VOTES:
            state['absent'] = False


@kernel
def _note_landing(state: Quantisation, axis: int, change: float, rate: PerAxis) -> bool:
    """Take in that the rate of an axis has come from afar; return whether that says anything."""
    # On the way through zero, not back from an outlier to where the bias is.
    on_the_way = change * state['change'][axis] > 0.25 * change * change
    counts = abs(rate[axis]) / state['count'][axis]
    whole = math.floor(counts + 0.5)
    # Zeros on all axes are of a sensor that has nothing to report.
    if is_zero(rate) or not on_the_way or abs(counts - whole) > PART:
        return False
    wide, neighbours = state['wide_zero'], state['whole_neighbours']
    wide += ZERO_IF_WIDE if whole == 0.0 else OTHER_IF_WIDE
    if whole > 0.0:
        neighbours += BESIDE_IF_WHOLE if whole == 1.0 else NEXT_IF_WHOLE
    state['wide_zero'] = min(max(wide, -LARGEST_EVIDENCE), LARGEST_EVIDENCE)
    state['whole_neighbours'] = min(max(neighbours, -LARGEST_EVIDENCE), LARGEST_EVIDENCE)
    return True


@kernel
def needs_half_counts(state: Quantisation, choice: int) -> bool:
    """Return whether half a count is to be added to the rates; `choice` is a member of `Choice`."""
    return bool(choice == Choice.TRUNCATE or (choice == Choice.AUTO and state['truncated']))


@kernel
def add_half_counts(state: Quantisation, rate: PerAxis) -> None:
    """Put rates (3,) in rad/s into the middle of what their count can have been before the cut."""
    for axis in range(3):
        half = 0.5 * known_count(state, axis)
        if rate[axis] > half:
            rate[axis] += half
        elif rate[axis] < -half:
            rate[axis] -= half


@kernel
def known_count(state: Quantisation, axis: int) -> float:
    """Return what a count of an axis is worth in rad/s, 0 where it is not known."""
    return float(state['count'][axis] if state['votes'][axis] >= CERTAIN_VOTES else 0.0)


@kernel
def likely_count(state: Quantisation, axis: int) -> float:
    """Return what a count of an axis is likely to be worth in rad/s, 0 where nothing is likely."""
    searching = state['changes'][axis] < LONGEST_SEARCH
    least = LIKELY_VOTES if searching else CERTAIN_VOTES
    return float(state['count'][axis] if state['votes'][axis] >= least else 0.0)


@kernel
def variance_of_cut(state: Quantisation) -> float:
    """Return the variance in (rad/s)^2 that a bias has which was learned from cut rates."""
    largest = 0.0
    for axis in range(3):
        largest = max(largest, known_count(state, axis))
    return float(0.25 * largest * largest)


@kernel
def variance_of_rounding(state: Quantisation, axis: int, noise: PerAxis) -> float:
    """Return the variance in (rad/s)^2 that rounding leaves in the mean rate of a rest of any time.

    `noise` (3,) is the variance of the rates at rest, in (rad/s)^2, with that of their rounding.
    Noise of variance s^2 counts spreads a rate over several counts, so that their mean is off by a
    sine of its place within a count, of 1 / pi exp(-2 (pi s)^2) counts; without any it is that of
    the nearest one. The noise is that of the calmest axis: one at the border of two counts shows
    their distance.
    """
    count, spread = known_count(state, axis), math.inf
    if count == 0.0:
        return 0.0
    for i in range(3):
        own = known_count(state, i)
        if own > 0.0:
            spread = min(spread, noise[i] / (own * own) - COUNT_VARIANCE)
    if spread > 1.0:  # the usual case, of less than a millionth of a count
        return 0.0
    left = math.exp(-4.0 * math.pi * math.pi * max(spread, 0.0))
    return COUNT_VARIANCE * count * count * left
