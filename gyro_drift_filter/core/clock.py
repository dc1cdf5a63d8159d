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

from typing import Any

import numpy as np

from gyro_drift_filter.accelerate.kernels import kernel

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
LEAST_DEVIATION = 1e-9  # as processors are slow with numbers next to zero

# A new period within these shares of the old one, or of the rate that was given, is the same.
SAME_PERIOD = 0.01
SAME_RATE = 0.1

RESTART = -1

CLOCK = np.dtype(
    [
        ('period', np.float64),  # s
        ('stamp', np.int64),  # ns, of the last stamped sample
        ('started', np.bool_),
        ('irregularity', np.float64),  # mean |step - period| / period
        ('steps', np.int64),  # forward steps seen, up to MEMORY_STEPS
        ('block_stamp', np.int64),  # ns, at the begin of the block
        ('block_samples', np.int64),
        ('block_missing', np.int64),
        ('block_gaps', np.int64),
        ('block_periods', np.float64, (BLOCKS,)),  # s
        ('blocks', np.int64),
        # counts
        ('gaps', np.int64),
        ('missing_samples', np.int64),
        ('restarts', np.int64),
        ('zero_stamps', np.int64),
        ('same_stamps', np.int64),
        ('backward_stamps', np.int64),
    ],
    align=True,
)


@kernel
def start_clock(clock: Any, sample_rate: float) -> None:
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
def is_regular(clock: Any) -> bool:
    """Tell whether the stamps come at even steps, so that a long step means missing samples."""
    return bool(clock['irregularity'] < REGULAR)


@kernel
def advance_clock(clock: Any, stamp: int, sample_rate: float, gap_limit: float) -> int:
    """Move the clock to `stamp` (ns) and return the number of samples missing before it.

    Returns `RESTART` where the time jumped by more than `gap_limit` (s) in either direction.
    """
    if stamp == 0:
        clock['zero_stamps'] += 1
        return 0
    if not clock['started']:
        clock['started'] = True
        clock['stamp'] = stamp
        _begin_block(clock)
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
        _begin_block(clock)
        return RESTART if abs(elapsed) > gap_limit else 0
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
def _begin_block(clock: Any) -> None:
    clock['block_stamp'] = clock['stamp']
    clock['block_samples'] = 0
    clock['block_missing'] = 0
    clock['block_gaps'] = 0


@kernel
def _learn_regularity(clock: Any, deviation: float) -> None:
    weight = 1.0 / MEMORY_STEPS
    if clock['steps'] < MEMORY_STEPS - PRIOR_STEPS:
        clock['steps'] += 1
        weight = 1.0 / (PRIOR_STEPS + clock['steps'])
    limited = min(max(abs(deviation), LEAST_DEVIATION), LARGEST_DEVIATION)
    clock['irregularity'] += weight * (limited - clock['irregularity'])


@kernel
def _learn_period(clock: Any, sample_rate: float) -> None:
    """Take the period from the block where it is full, or from its begin while it is the first."""
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
        _begin_block(clock)
    elif sample_rate > 0.0:
        return
    if sample_rate > 0.0 and abs(period * sample_rate - 1.0) < SAME_RATE:
        period = 1.0 / sample_rate
    elif abs(period / clock['period'] - 1.0) < SAME_PERIOD:
        return
    clock['period'] = period


@kernel
def _median(values: Any, count: int) -> float:
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
