"""Time: the sample period learned from the stamps, and how many samples a gap has swallowed.

A filter step stands for one sample period, whatever the stamps say: drivers stamp late and deliver
in bursts. The stamps serve two ends, to learn the period and to find gaps.

- The period is the time per sample over blocks of two seconds, the median of the last five blocks.
- While the stamps come regularly, a step of several periods means that samples are missing. While
  they come in bursts it means nothing, and is not counted as a gap.

Every effect of a stamp is counted:

==================  ==========================================================================
stamp               effect
==================  ==========================================================================
zero                one step; the clock is left alone (the driver does not stamp)
same, same rates    a repeat: no step, the result of the sample before once more
same, new rates     one step (a coarse clock)
backward            one step, and the clock goes on from there; beyond `gap_limit` a restart
forward             one step, after a prediction for each missing sample where stamps are regular;
                    beyond `gap_limit` a restart
==================  ==========================================================================
"""

from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import kernel, record

BLOCKS = 5
BLOCK_SECONDS = 2.0
BLOCK_SAMPLES = 20

# The period in use before anything is known, in s: for stamps that are all zero.
UNKNOWN_PERIOD = 0.01
SHORTEST_PERIOD, LONGEST_PERIOD = 1.0e-4, 1.0

# Mean deviation of a step from the period, relative to it, up to which stamps count as regular.
# Jitter of a timer stays below 0.1; samples delivered in bursts are near 1. A driver has to show
# that it is regular: it starts at 1 with the weight of `PRIOR_STEPS` steps.
REGULAR = 0.4
PRIOR_STEPS = 20
MEMORY_STEPS = 100
LARGEST_DEVIATION = 2.0
LEAST_DEVIATION = 1e-9  # as processors are slow with denormal numbers

# A new period within these shares of the old one, or of the rate that was given, is the same.
SAME_PERIOD = 0.01
SAME_RATE = 0.1

# The bias walks no further than in this time, whatever the stamps say, in s.
LONGEST_ABSENCE = 86_400.0

# In place of a number of missing samples: time has jumped.
TIME_JUMP = -1

BlockPeriods = Annotated[NDArray[np.float64], np.float64, (BLOCKS,)]


class Clock(TypedDict):
    """The sample period, and where in time the filter stands."""

    period: float  # s
    stamp: int  # ns, of the last stamped sample
    started: bool
    irregularity: float  # mean |step - period| / period
    steps: int  # forward steps seen, up to MEMORY_STEPS
    block_stamp: int  # ns, at the start of the block
    block_samples: int
    block_missing: int
    block_gaps: int
    block_periods: BlockPeriods  # s
    blocks: int
    # counts
    gaps: int
    missing_samples: int
    restarts: int
    zero_stamps: int
    same_stamps: int
    backward_stamps: int


CLOCK = record(Clock)


@kernel
def start_clock(clock: Clock, sample_rate: float) -> None:
    """Set a zeroed clock up; `sample_rate` in Hz, 0 where it is to be learned."""
    clock['period'] = period_of(sample_rate)
    clock['irregularity'] = 1.0


@kernel
def period_of(sample_rate: float) -> float:
    """Return the sample period in s of a rate in Hz, 0 where the rate is to be learned."""
    if sample_rate <= 0.0:
        return UNKNOWN_PERIOD
    return min(max(1.0 / max(sample_rate, 1.0 / LONGEST_PERIOD), SHORTEST_PERIOD), LONGEST_PERIOD)


@kernel
def is_regular(clock: Clock) -> bool:
    """Return whether the stamps come at even steps, so that a long step means missing samples."""
    return bool(clock['irregularity'] < REGULAR)


@kernel
def elapsed_seconds(clock: Clock, stamp: int) -> float:
    """Return the time in s from the last sample to a stamp (ns), as far as the stamps say."""
    if stamp == 0 or not clock['started']:
        return float(clock['period'])
    return float(min(max((stamp - clock['stamp']) * 1e-9, 0.0), LONGEST_ABSENCE))


@kernel
def advance_clock(clock: Clock, stamp: int, sample_rate: float, gap_limit: float) -> int:
    """Move the clock to `stamp` (ns) and return the number of samples missing before it.

    Returns `TIME_JUMP` where the time jumped by more than `gap_limit` (s) in either direction.
    """
    if stamp == 0:
        clock['zero_stamps'] += 1
        return 0
    if not clock['started']:
        clock['started'] = True
        clock['stamp'] = stamp
        _start_block(clock)
        return 0
    elapsed = (stamp - clock['stamp']) * 1e-9
    clock['stamp'] = stamp
    if elapsed == 0.0:
        clock['same_stamps'] += 1
        clock['block_samples'] += 1
        return 0
    if elapsed < 0.0:
        clock['backward_stamps'] += 1
    if elapsed > gap_limit:
        clock['gaps'] += 1
    if abs(elapsed) > gap_limit:
        clock['restarts'] += 1
    if elapsed < 0.0 or elapsed > gap_limit:
        _start_block(clock)
        return TIME_JUMP if abs(elapsed) > gap_limit else 0
    missing = 0
    if is_regular(clock) and elapsed >= 1.5 * clock['period']:
        missing = int(np.rint(elapsed / clock['period'])) - 1
    if missing > 0:
        clock['gaps'] += 1
        clock['missing_samples'] += missing
        clock['block_gaps'] += 1
        clock['block_missing'] += missing
    clock['block_samples'] += 1
    _learn_period(clock, sample_rate)
    _learn_regularity(clock, elapsed / clock['period'] - 1.0 - missing)
    return missing


@kernel
def _start_block(clock: Clock) -> None:
    clock['block_stamp'] = clock['stamp']
    clock['block_samples'] = 0
    clock['block_missing'] = 0
    clock['block_gaps'] = 0


@kernel
def _learn_regularity(clock: Clock, deviation: float) -> None:
    weight = 1.0 / MEMORY_STEPS
    if clock['steps'] < MEMORY_STEPS - PRIOR_STEPS:
        clock['steps'] += 1
        weight = 1.0 / (PRIOR_STEPS + clock['steps'])
    limited = min(max(abs(deviation), LEAST_DEVIATION), LARGEST_DEVIATION)
    clock['irregularity'] += weight * (limited - clock['irregularity'])


@kernel
def _learn_period(clock: Clock, sample_rate: float) -> None:
    """Take the period from the block where it is full, or from its start while it is the first."""
    samples = clock['block_samples']
    span = (clock['stamp'] - clock['block_stamp']) * 1e-9
    full = span >= BLOCK_SECONDS and samples >= BLOCK_SAMPLES
    power_of_two = samples & (samples - 1) == 0
    if not full and (clock['blocks'] > 0 or not power_of_two):
        return
    missing = clock['block_missing']
    # More missing than received, or a gap in every third step: these are no gaps, the driver has
    # changed its rate or delivers in long bursts.
    if missing >= samples or 3 * clock['block_gaps'] >= samples:
        missing = 0
    period = min(max(span / (samples + missing), SHORTEST_PERIOD), LONGEST_PERIOD)
    if full:
        clock['block_periods'][clock['blocks'] % BLOCKS] = period
        clock['blocks'] += 1
        period = _median(clock['block_periods'], min(clock['blocks'], BLOCKS))
        _start_block(clock)
    elif sample_rate > 0.0:
        return
    if sample_rate > 0.0 and abs(period * sample_rate - 1.0) < SAME_RATE:
        period = 1.0 / sample_rate
    elif abs(period / clock['period'] - 1.0) < SAME_PERIOD:
        return
    clock['period'] = period


@kernel
def _median(values: BlockPeriods, count: int) -> float:
    """Return the median of the first `count` values; numba's own takes two seconds to compile."""
    middle = (count - 1) // 2
    low = high = 0.0
    for i in range(count):
        less = 0
        for k in range(count):
            # Equal values count in their order.
            if values[k] < values[i] or (values[k] == values[i] and k < i):
                less += 1
        if less == middle:
            low = values[i]
        if less == count // 2:
            high = values[i]
    return 0.5 * (low + high)
