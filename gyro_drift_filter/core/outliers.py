"""Outliers told from motion: a doubtful sample is held back until those after it say what it was.

A sample far outside the prediction is not believed, and the prediction stands in for it. Then there
are three ways on. Back near the prediction: it was an outlier, and leaves no trace. A smooth growth
with the same sign, or a run of agreeing samples longer than outliers last: it was motion, and the
filter starts again at the sample at hand. Neither: that sample is held back as well, for a bounded
number of samples.

This stands in place of the paper's equations (18) to (20), whose band compares squares of rates and
so grows tight as the robot turns. Here the threshold counts predicted standard deviations, the same
at every rate of turn.
"""

import math
from typing import Any

import numpy as np

from gyro_drift_filter.core.compiled import compiled

RETURN = 0.5  # back by half the jump: the jump was an outlier
SPREAD_POWER = 1.5  # what an extrapolation over n samples may miss grows as n to this power
GROWTH = 1.3  # motion that has only begun goes on growing by this factor a sample ...
GROWTH_LIMIT = 300.0  # rad/s^2: ... and by no more than an arm can do
GROWTH_START = 4.0  # thresholds: a motion begins with a smaller step than that
AGREEMENT = 150.0  # rad/s^2: held samples that differ by more are no motion
SAME = 0.01  # standard deviations of the noise: repeats closer than this ...
SAME_SAMPLES = 14  # ... so many times are a constant, whatever was learned before

BELIEVE, HOLD, RESTART = 0, 1, 2

OUTLIER_LIMITS = np.dtype(
    [
        ('threshold', np.float64),  # predicted standard deviations
        ('least_jump', np.float64),  # rad/s
        ('growth_limit', np.float64),  # rad/s
        ('agreement', np.float64),  # rad/s
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
    ],
    align=True,
)


@compiled
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
    limits['agreement'] = AGREEMENT * period
    limits['run'] = run
    limits['longest_hold'] = 2 * run + 2


@compiled
def judge(
    doubt: Any, sample: float, prediction: float, spread: float, dropout: bool, limits: Any
) -> int:
    """Decide on a sample: BELIEVE, HOLD back, or RESTART, believed after all.

    Arguments: sample and prediction in rad/s; the typical size of an innovation, in rad/s; whether
    the sample is a drop-out of the sensor.
    """
    innovation = sample - prediction
    size = abs(innovation)
    jump = limits['threshold'] * spread
    if doubt['held'] == 0:
        return HOLD if dropout or (size > limits['least_jump'] and size > jump) else BELIEVE
    if doubt['held'] >= limits['longest_hold']:
        return RESTART
    if dropout:
        return RESTART if doubt['agreeing'] >= limits['run'] else HOLD
    offset = doubt['offset']
    held_jump = limits['threshold'] * doubt['spread']
    near = size <= held_jump * (1.0 + doubt['held']) ** SPREAD_POWER
    away = size > 0.5 * jump and size > RETURN * abs(offset) and offset != 0.0
    if near and not away:
        return BELIEVE
    change = abs(sample - doubt['sample'])
    grows = innovation * offset > 0.0 and size > GROWTH * abs(offset)
    if grows and change < limits['growth_limit'] and abs(offset) < GROWTH_START * held_jump:
        return RESTART
    if change <= max(limits['agreement'], jump) and doubt['agreeing'] >= limits['run']:
        return RESTART
    return HOLD


@compiled
def note_held(
    doubt: Any, sample: float, prediction: float, spread: float, dropout: bool, limits: Any
) -> None:
    """Note a sample that is held back; arguments as for `judge`."""
    change = abs(sample - doubt['sample'])
    if doubt['held'] == 0:
        doubt['spread'] = spread
        doubt['agreeing'] = 0
    elif dropout != (doubt['offset'] == 0.0) or (
        not dropout and change > max(limits['agreement'], limits['threshold'] * spread)
    ):
        doubt['agreeing'] = 0
    doubt['held'] += 1
    doubt['agreeing'] += 1
    doubt['offset'] = 0.0 if dropout else sample - prediction


@compiled
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
