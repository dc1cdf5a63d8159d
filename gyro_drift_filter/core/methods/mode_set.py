"""The ladder of method `adaptive`: one model of motion at many strengths, from rest to fast motion.

The model of one axis. The change of the true rate from one sample to the next is white noise that
has passed twice through a first-order lag; the sensor adds noise v of variance R:

    [rate ]      [1  1  0] [rate ]     [1     ]
    [slope]   =  [0  r  1] [slope]  +  [2 r   ] w,      z = rate + v,      r = exp(-period / lag)
    [bend ]      [0  0  r] [bend ]     [r ** 2]

This is the paper's X = A X + Gamma w, Z = H X + v, equations (5) and (6), for motion in place of
drift. What differs between rest and motion is one number, the variance Q of w. So Q takes one of
LEVELS values, and every level has the gain that the paper's equations (8), (9) and (12) settle to
with it. A level is named by the time over which it averages: Q = R (period / time) ** 6.

Which level holds is a hidden Markov chain: motion grows unforeseen, and dies away level by level.

Rates are in rad/s, times in s, slope and bend in rad/s per sample; variances are relative to R.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate.records import in_lines

Array = NDArray[np.float64]

LEVELS = 22
# Arrays over the levels fill vector registers; what is beyond LEVELS has no part in anything.
LANES = 24

# The slowest level averages over SLOWEST s: longer would lag behind a slow turn in strong noise.
# The fastest follows changes of FASTEST ** 3 times the noise per sample.
SLOWEST = 0.7
FASTEST = 25.0

# How long slope and bend last: a multiple of the level's time, but no shorter than a movement of a
# hand, and no longer than it takes to know that a robot is not turning after all, in s.
LAG_PER_TIME = 8.0
SHORTEST_LAG = 0.03
LONGEST_LAG = 0.7

# At the fastest levels motion grows unforeseen CLIMBS times a second; the others last longer, for
# about their own time: the probability per sample is at most that times CLIMBS_PER_TIME * period /
# time. The same for falls: FALLS is the probability per sample, and of going one level further.
CLIMBS = 3.0
CLIMBS_PER_TIME = 3.0
FALLS = 0.1
FALLS_PER_TIME = 4.0

# A climb goes one level further with this probability, times the ratio of the innovation variances
# to this power. A power above one keeps the predicted variance finite however high the ladder is.
CLIMB_ON = 0.75
CLIMB_ON_POWER = 1.2

_LEVEL_ARRAY = (LANES,)

LEAST_PROBABILITY = 1e-30  # of a level

LADDER = in_lines(
    [
        ('lag_ratio', np.float64, _LEVEL_ARRAY),  # r
        # Steady-state gains, Q and innovation variance; the variances relative to R.
        ('gain_rate', np.float64, _LEVEL_ARRAY),
        ('gain_slope', np.float64, _LEVEL_ARRAY),
        ('gain_bend', np.float64, _LEVEL_ARRAY),
        ('process_ratio', np.float64, _LEVEL_ARRAY),
        ('innovation_ratio', np.float64, _LEVEL_ARRAY),
        ('innovation_logarithm', np.float64, _LEVEL_ARRAY),
        ('least_probability', np.float64, _LEVEL_ARRAY),
        # The chain. Probability per sample of staying on a level; of leaving it upwards and ending
        # one level above; the share of what reaches the level below that goes on to this one.
        ('stay', np.float64, _LEVEL_ARRAY),
        ('climb_near', np.float64, _LEVEL_ARRAY),
        ('climb_on', np.float64, _LEVEL_ARRAY),
        # Probability of leaving it downwards and ending one level below; times the share of slope
        # and bend that is kept on the way; share that goes on from the level above, with that.
        ('fall_near', np.float64, _LEVEL_ARRAY),
        ('fall_slope', np.float64, _LEVEL_ARRAY),
        ('fall_bend', np.float64, _LEVEL_ARRAY),
        ('slope_on', np.float64, _LEVEL_ARRAY),
        ('bend_on', np.float64, _LEVEL_ARRAY),
    ]
)


def derive_ladder(period: float, ladder: Any) -> None:
    """Fill a record of LADDER for a sample period in s."""
    steps = [j / (LEVELS - 1) for j in range(LEVELS)]
    times = [SLOWEST * (period / FASTEST / SLOWEST) ** step for step in steps]
    lags = [max(SHORTEST_LAG, min(LAG_PER_TIME * time, LONGEST_LAG)) for time in times]
    lag_ratio = np.array([math.exp(-period / lag) for lag in lags])
    process_ratio = (period / np.array(times)) ** 6
    covariance = _settled_covariance(lag_ratio, process_ratio)
    innovation = covariance[:, 0, 0] + 1.0  # (9), with R = 1
    _fill(ladder['lag_ratio'], lag_ratio)
    _fill(ladder['process_ratio'], process_ratio)
    _fill(ladder['innovation_ratio'], innovation, 1.0)
    _fill(ladder['innovation_logarithm'], np.log(innovation))
    _fill(ladder['least_probability'], np.full(LEVELS, LEAST_PROBABILITY))
    for i, name in enumerate(('gain_rate', 'gain_slope', 'gain_bend')):
        _fill(ladder[name], covariance[:, 0, i] / innovation)
    fall = _derive_chain(times, innovation, period, ladder)
    # On a fall to a slower level that level's own slopes are the prior, and the faster level's
    # slope is a measurement of it with the faster level's error, (12).
    wander = _wander(lag_ratio, process_ratio)
    for i, name in ((1, 'slope'), (2, 'bend')):
        error = covariance[:, i, i] - covariance[:, 0, i] ** 2 / innovation
        own = wander[:-1, i - 1, i - 1]
        keep = own / (own + error[1:])
        _fill(ladder[f'fall_{name}'], np.append(0.0, fall[1:] * keep))
        _fill(ladder[f'{name}_on'], FALLS * keep)


def _fill(lanes: Any, levels: Array, beyond: float = 0.0) -> None:
    """Write what belongs to the levels, up to LEVELS of it, and what is beyond them."""
    lanes[: len(levels)] = levels
    lanes[len(levels) :] = beyond


def _derive_chain(times: list[float], ratio: Array, period: float, ladder: Any) -> Array:
    """Write the probabilities of climbing and falling; return `fall_near`, (LEVELS,)."""
    climb, fall = np.zeros(LEVELS), np.zeros(LEVELS)
    climb_near, fall_near = np.zeros(LEVELS), np.zeros(LEVELS)
    climb_on = np.full(LEVELS, CLIMB_ON)
    unforeseen = 1.0 - math.exp(-CLIMBS * period)
    for j in range(LEVELS):
        if j > 0:
            climb_on[j] *= (ratio[j - 1] / ratio[j]) ** CLIMB_ON_POWER
        climb[j] = unforeseen * min(1.0, CLIMBS_PER_TIME * period / times[j])
        fall[j] = FALLS * min(1.0, FALLS_PER_TIME * period / times[j])
    climb[LEVELS - 1] = fall[0] = 0.0
    for j in range(LEVELS):
        # The shares of all levels above add up to one, and those of all below.
        climb_near[j] = climb[j] / (1.0 + np.cumprod(climb_on[j + 2 :]).sum())
        fall_near[j] = fall[j] * (1.0 - FALLS) / (1.0 - FALLS ** max(j, 1))
    _fill(ladder['stay'], 1.0 - climb - fall)
    _fill(ladder['climb_near'], climb_near)
    _fill(ladder['climb_on'], climb_on)
    _fill(ladder['fall_near'], fall_near)
    return fall_near


def _settled_covariance(lag_ratio: Array, process_ratio: Array) -> Array:
    """Return what P(k|k-1) of equations (8), (9) and (12) settles to, divided by R.

    Of all levels at once, (n,) and (n,) to (n, 3, 3). The doubling algorithm squares the number of
    steps in each turn (Anderson and Moore, Optimal Filtering, 1979, section 6.7), so that half a
    second at 4 kHz takes twelve turns.
    """
    identity = np.eye(3)
    forward = np.zeros((len(lag_ratio), 3, 3))  # A'
    forward[:, 0, 0] = forward[:, 1, 0] = forward[:, 2, 1] = 1.0
    forward[:, 1, 1] = forward[:, 2, 2] = lag_ratio
    drive = np.stack([np.ones_like(lag_ratio), 2.0 * lag_ratio, lag_ratio * lag_ratio], axis=1)
    covariance = drive[:, :, None] * drive[:, None, :] * process_ratio[:, None, None]
    information = np.zeros_like(forward)
    information[:, 0, 0] = 1.0
    for _ in range(60):
        weight = np.linalg.inv(identity + information @ covariance)
        carried = weight @ forward
        grown = covariance + _transposed(forward) @ covariance @ carried
        information = information + forward @ weight @ information @ _transposed(forward)
        forward = forward @ carried
        change = np.abs(grown - covariance).max(axis=(1, 2))
        covariance = grown
        if (change <= 1e-13 * np.abs(covariance).max(axis=(1, 2))).all():
            break
    return covariance


def _wander(lag_ratio: Array, process_ratio: Array) -> Array:
    """Return the covariance of slope and bend that the model itself gives rise to, divided by R.

    Of all levels at once, (n,) and (n,) to (n, 2, 2).
    """
    transition = np.zeros((len(lag_ratio), 2, 2))
    transition[:, 0, 0] = transition[:, 1, 1] = lag_ratio
    transition[:, 0, 1] = 1.0
    drive = np.stack([2.0 * lag_ratio, lag_ratio * lag_ratio], axis=1)
    covariance = drive[:, :, None] * drive[:, None, :] * process_ratio[:, None, None]
    for _ in range(40):
        covariance = covariance + transition @ covariance @ _transposed(transition)
        transition = transition @ transition
    return covariance


def _transposed(matrices: Array) -> Array:
    return matrices.swapaxes(1, 2)
