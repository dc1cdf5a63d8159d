"""Outliers told from motion: a doubtful sample is held back until those after it say what it was.

A sample far outside the prediction is not believed, and the prediction stands in for it. Then there
are three ways on. Back near the prediction: it was an outlier, and leaves no trace. A smooth growth
with the same sign, or a run of agreeing samples longer than outliers last: it was motion, and the
filter starts again at the sample at hand. Neither: that sample is held back as well, for a bounded
number of samples. A jump that comes with a jolt of the accelerometer is a knock, and believed as
soon as the next sample agrees; a message that is corrupted as a whole does not come back.

This stands in place of the paper's equations (18) to (20), whose band compares squares of rates and
so grows tight as the robot turns. Here the threshold counts predicted standard deviations, the same
at every rate of turn.
"""

import math
from typing import Any

import numpy as np

from gyro_drift_filter.accelerate.kernels import kernel

RETURN = 0.5  # back by half the jump: the jump was an outlier
SPREAD_POWER = 1.5  # what an extrapolation over n samples may miss grows as n to this power
GROWTH = 1.3  # motion that has only begun goes on growing by this factor a sample ...
GROWTH_LIMIT = 500.0  # rad/s^2: ... and by no more than an arm can do
GROWTH_START = 4.0  # thresholds: a motion begins with a smaller step than that
AGREEMENT = 0.25  # of the jump: held samples that differ by more are no motion,
AGREEMENT_LIMIT = 150.0  # rad/s^2: nor those that differ by more than this
BODY_LIMIT = 1000.0  # rad/s^2: no body does more, so a jump beyond needs ...
BODY_LIMIT_SAMPLES = 2  # ... so many samples more to be believed
SAME = 0.01  # standard deviations of the noise: repeats closer than this ...
SAME_SAMPLES = 14  # ... so many times are a constant, whatever was learned before

CROWDED = 0.25  # share of held samples above which the doubt is wrong, not the samples ...
CROWDED_MEMORY = 0.025  # ... with this weight of a sample in the share
LEAST_SHARE = 1e-9  # as processors are slow with numbers next to zero

JOLT = 15.0  # usual changes of the acceleration from sample to sample: something was hit
JOLT_MEMORY = 0.05  # weight of a sample in the usual change
JOLT_FLOOR = 0.05  # m/s^2, the least usual change: below lies the resolution
JOLT_SAMPLES = 2  # the gyroscope may lag behind the accelerometer by a sample
JOLT_LIMIT = 6.0  # rad/s: what a hit may do to the rate at once
FIRST_CHANGE = 10.0  # m/s^2, the usual change until it is known
LARGEST_CHANGE = 5.0  # usual changes: more than this in a sample counts as this much

BELIEVE, HOLD, RESTART = 0, 1, 2

OUTLIER_LIMITS = np.dtype(
    [
        ('threshold', np.float64),  # predicted standard deviations
        ('least_jump', np.float64),  # rad/s
        ('growth_limit', np.float64),  # rad/s
        ('agreement_limit', np.float64),  # rad/s
        ('body_limit', np.float64),  # rad/s
        ('run', np.int64),  # samples: the longest run of equal outliers
        ('longest_hold', np.int64),  # samples
    ]
)

DOUBT = np.dtype(
    [
        ('held', np.int64),  # samples held back in a row
        ('agreeing', np.int64),  # of them, the last ones that agree
        ('offset', np.float64),  # innovation of the last one in rad/s, 0 after a drop-out
        ('spread', np.float64),  # rad/s: typical innovation when the first one came
        ('sample', np.float64),  # the last sample as it came, rad/s
        ('repeats', np.int64),  # how often it has come before
        ('share_held', np.float64),  # of the last samples, not counting drop-outs
    ],
    align=True,
)


JOLTS = np.dtype(
    [
        ('acceleration', np.float64),  # of the last sample along one axis, m/s^2
        ('usual_change', np.float64),  # from sample to sample, m/s^2
        ('counts', np.int64),  # samples for which the last jolt still counts
    ]
)


def derive_limits(
    threshold: float, acceleration: float, run: int, period: float, limits: Any
) -> None:
    """Fill a record of OUTLIER_LIMITS for a sample period in s.

    Arguments: threshold in predicted standard deviations; the acceleration in rad/s^2 below which
    a jump is never doubted; the longest run of outliers in samples.
    """
    limits['threshold'] = threshold
    limits['least_jump'] = acceleration * period
    limits['growth_limit'] = GROWTH_LIMIT * period
    limits['agreement_limit'] = AGREEMENT_LIMIT * period
    limits['body_limit'] = BODY_LIMIT * period
    limits['run'] = run
    limits['longest_hold'] = 2 * run + 2


@kernel
def feel_jolt(jolt: Any, acceleration: float) -> bool:
    """Note the acceleration along one axis (m/s^2); tell whether it has just jumped.

    A knock turns the sensor as suddenly as a spike would, but shakes the accelerometer as well.
    Without an accelerometer (zero throughout, or NaN) nothing is ever felt.
    """
    change = abs(acceleration - jolt['acceleration'])
    jolt['acceleration'] = acceleration
    jolt['counts'] = max(jolt['counts'] - 1, 0)
    if not change < np.inf:
        return False
    usual = max(jolt['usual_change'], JOLT_FLOOR)
    if change > JOLT * usual:
        jolt['counts'] = JOLT_SAMPLES
    limited = min(change, LARGEST_CHANGE * usual)
    jolt['usual_change'] = usual + JOLT_MEMORY * (limited - usual)
    return bool(jolt['counts'] > 0)


@kernel
def start_doubt(doubt: Any, sample: float) -> None:
    """Begin at a sample (rad/s)."""
    doubt['held'] = 0
    doubt['agreeing'] = 0
    doubt['repeats'] = 0
    doubt['share_held'] = 0.0
    doubt['sample'] = sample


@kernel
def judge(
    doubt: Any,
    sample: float,
    prediction: float,
    spread: float,
    dropout: bool,
    jolted: bool,
    limits: Any,
) -> int:
    """Decide on a sample: BELIEVE, HOLD back, or RESTART, believed after all.

    Arguments: sample and prediction in rad/s; the typical size of an innovation, in rad/s; whether
    the sample is a drop-out of the sensor; whether the accelerometer has just been jolted.
    """
    innovation = sample - prediction
    size = abs(innovation)
    jump = limits['threshold'] * spread
    held = doubt['held']
    if doubt['share_held'] > CROWDED and not dropout:
        return BELIEVE if held == 0 else RESTART
    if held == 0:
        return HOLD if dropout or (size > limits['least_jump'] and size > jump) else BELIEVE
    lasted = held >= limits['longest_hold']
    if dropout:
        # One more than other runs: two drop-outs of two samples each may follow each other.
        return RESTART if lasted or doubt['agreeing'] > limits['run'] else HOLD
    offset = doubt['offset']
    held_jump = limits['threshold'] * doubt['spread']
    near = size <= held_jump * (held + 1.0) ** SPREAD_POWER
    # Beyond the prediction on the other side it has come back as well: the prediction was off.
    away = size > 0.5 * jump and size > RETURN * abs(offset) and innovation * offset > 0.0
    if near and not away:
        return BELIEVE
    if jolted and size < JOLT_LIMIT:
        return RESTART
    change = abs(sample - doubt['sample'])
    grows = innovation * offset > 0.0 and size > GROWTH * abs(offset)
    begins = abs(offset) < GROWTH_START * held_jump * (held * 1.0) ** SPREAD_POWER
    alone = doubt['agreeing'] <= 1  # a burst that lasts does not grow
    if grows and begins and alone and change < limits['growth_limit']:
        return RESTART
    alike = change <= _agreement(offset, held_jump, limits)
    run = limits['run'] + (BODY_LIMIT_SAMPLES if abs(offset) > limits['body_limit'] else 0)
    if lasted or (alike and doubt['agreeing'] >= run):
        return RESTART
    return HOLD


@kernel
def note_held(
    doubt: Any, sample: float, prediction: float, spread: float, dropout: bool, limits: Any
) -> None:
    """Note a sample that is held back; arguments as for `judge`."""
    if doubt['held'] == 0:
        # What was known before the first of them: the spread grows while nothing is believed.
        doubt['spread'] = spread
        doubt['agreeing'] = 0
    elif not _continues(doubt, abs(sample - doubt['sample']), dropout, limits):
        doubt['agreeing'] = 0
    doubt['held'] += 1
    doubt['agreeing'] += 1
    doubt['offset'] = 0.0 if dropout else sample - prediction


@kernel
def note_missing(doubt: Any, spread: float) -> None:
    """Note a sample that is missing: as much may have happened as in one that is held back."""
    if doubt['held'] == 0:
        doubt['spread'] = spread
    doubt['held'] += 1
    doubt['agreeing'] = 0
    doubt['offset'] = 0.0


@kernel
def note_verdict(doubt: Any, held: bool) -> None:
    """Keep count of how many samples are held: a vibration must not be held for ever."""
    if held or doubt['share_held'] > LEAST_SHARE:
        doubt['share_held'] += CROWDED_MEMORY * ((1.0 if held else 0.0) - doubt['share_held'])


@kernel
def _continues(doubt: Any, change: float, dropout: bool, limits: Any) -> bool:
    """Tell whether a sample belongs to the same run as the one held before it."""
    after_dropout = doubt['offset'] == 0.0
    if dropout or after_dropout:
        return bool(dropout and after_dropout)
    return change <= _agreement(doubt['offset'], limits['threshold'] * doubt['spread'], limits)


@kernel
def _agreement(offset: float, jump: float, limits: Any) -> float:
    """Return the difference in rad/s up to which two held samples tell the same tale."""
    agreement: float = max(min(AGREEMENT * abs(offset), limits['agreement_limit']), jump)
    return agreement


@kernel
def is_constant(doubt: Any, sample: float, variance: float) -> bool:
    """Tell whether the same value has come so often that it must be the rate.

    Arguments: sample in rad/s, variance of the noise in (rad/s)^2.
    """
    if abs(sample - doubt['sample']) > SAME * math.sqrt(variance):
        doubt['repeats'] = 0
        return False
    doubt['repeats'] += 1
    if doubt['repeats'] < SAME_SAMPLES:
        return False
    doubt['repeats'] = 0
    return True
