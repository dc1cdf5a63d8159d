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

from gyro_drift_filter.core.compiled import compiled

LEVELS = 22

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

_LEVEL_ARRAY = (LEVELS,)

LADDER = np.dtype(
    [
        ('lag_ratio', np.float64, _LEVEL_ARRAY),  # r
        # Steady-state gains, Q and innovation variance; the variances relative to R.
        ('gain_rate', np.float64, _LEVEL_ARRAY),
        ('gain_slope', np.float64, _LEVEL_ARRAY),
        ('gain_bend', np.float64, _LEVEL_ARRAY),
        ('process_ratio', np.float64, _LEVEL_ARRAY),
        ('innovation_ratio', np.float64, _LEVEL_ARRAY),
        ('innovation_logarithm', np.float64, _LEVEL_ARRAY),
        # The chain. Probability per sample of leaving a level upwards; the share of that which ends
        # one level above; the share of what reaches the level below that goes on to this one.
        ('climb', np.float64, _LEVEL_ARRAY),
        ('climb_first', np.float64, _LEVEL_ARRAY),
        ('climb_on', np.float64, _LEVEL_ARRAY),
        # Probability per sample of leaving it downwards; shares of slope and bend kept on the way.
        ('fall', np.float64, _LEVEL_ARRAY),
        ('keep_slope', np.float64, _LEVEL_ARRAY),
        ('keep_bend', np.float64, _LEVEL_ARRAY),
    ]
)


@compiled
def derive_ladder(period: float, ladder: Any) -> None:
    """Fill a record of LADDER for a sample period in s."""
    times = np.empty(LEVELS)
    slope_error, bend_error = np.empty(LEVELS), np.empty(LEVELS)
    slope_wander, bend_wander = np.empty(LEVELS), np.empty(LEVELS)
    for j in range(LEVELS):
        times[j] = SLOWEST * (period / FASTEST / SLOWEST) ** (j / (LEVELS - 1))
        lag = max(SHORTEST_LAG, min(LAG_PER_TIME * times[j], LONGEST_LAG))
        lag_ratio = math.exp(-period / lag)
        cube = (period / times[j]) * (period / times[j]) * (period / times[j])
        process_ratio = cube * cube
        covariance = _settled_covariance(lag_ratio, process_ratio)
        innovation = covariance[0, 0] + 1.0  # (9), with R = 1
        ladder['lag_ratio'][j] = lag_ratio
        ladder['process_ratio'][j] = process_ratio
        ladder['innovation_ratio'][j] = innovation
        ladder['innovation_logarithm'][j] = math.log(innovation)
        ladder['gain_rate'][j] = covariance[0, 0] / innovation
        ladder['gain_slope'][j] = covariance[0, 1] / innovation
        ladder['gain_bend'][j] = covariance[0, 2] / innovation
        slope_error[j] = covariance[1, 1] - covariance[0, 1] * covariance[0, 1] / innovation  # (12)
        bend_error[j] = covariance[2, 2] - covariance[0, 2] * covariance[0, 2] / innovation
        slope_wander[j], bend_wander[j] = _wander(lag_ratio, process_ratio)
    _derive_chain(times, period, ladder)
    # On a fall to a slower level that level's own slopes are the prior, and the faster level's
    # slope is a measurement of it with the faster level's error.
    ladder['keep_slope'][0] = ladder['keep_bend'][0] = 0.0
    for j in range(1, LEVELS):
        ladder['keep_slope'][j] = slope_wander[j - 1] / (slope_wander[j - 1] + slope_error[j])
        ladder['keep_bend'][j] = bend_wander[j - 1] / (bend_wander[j - 1] + bend_error[j])


@compiled
def _derive_chain(times: NDArray[np.float64], period: float, ladder: Any) -> None:
    """Write the probabilities of climbing and falling between the levels."""
    ratio, climb_on = ladder['innovation_ratio'], ladder['climb_on']
    unforeseen = 1.0 - math.exp(-CLIMBS * period)
    for j in range(LEVELS):
        climb_on[j] = CLIMB_ON
        if j > 0:
            climb_on[j] *= (ratio[j - 1] / ratio[j]) ** CLIMB_ON_POWER
        ladder['climb'][j] = unforeseen * min(1.0, CLIMBS_PER_TIME * period / times[j])
        ladder['fall'][j] = FALLS * min(1.0, FALLS_PER_TIME * period / times[j])
    ladder['climb'][LEVELS - 1] = 0.0
    ladder['fall'][0] = 0.0
    for j in range(LEVELS):
        # The shares of all levels above add up to one.
        shares, share = 1.0, 1.0
        for i in range(j + 2, LEVELS):
            share *= climb_on[i]
            shares += share
        ladder['climb_first'][j] = 1.0 / shares


@compiled
def _settled_covariance(lag_ratio: float, process_ratio: float) -> NDArray[np.float64]:
    """Return what P(k|k-1) of equations (8), (9) and (12) settles to, (3, 3), divided by R.

    The doubling algorithm squares the number of steps in each turn (Anderson and Moore, Optimal
    Filtering, 1979, section 6.7), so that half a second at 4 kHz takes twelve turns.
    """
    forward = np.array([[1.0, 0.0, 0.0], [1.0, lag_ratio, 0.0], [0.0, 1.0, lag_ratio]])  # A'
    drive = np.array([[1.0], [2.0 * lag_ratio], [lag_ratio * lag_ratio]])
    covariance = _product(drive, drive.T) * process_ratio
    information = np.zeros((3, 3))
    information[0, 0] = 1.0
    for _ in range(60):
        weight = _inverse(np.eye(3) + _product(information, covariance))
        carried = _product(weight, forward)
        grown = covariance + _product(forward.T, _product(covariance, carried))
        spread = _product(forward, _product(weight, _product(information, forward.T)))
        information = information + spread
        forward = _product(forward, carried)
        change = np.abs(grown - covariance).max()
        covariance = grown
        if change <= 1e-13 * np.abs(covariance).max():
            break
    return covariance


@compiled
def _wander(lag_ratio: float, process_ratio: float) -> tuple[float, float]:
    """Return the variances of slope and bend that the model itself gives rise to, divided by R."""
    transition = np.array([[lag_ratio, 1.0], [0.0, lag_ratio]])
    drive = np.array([[2.0 * lag_ratio], [lag_ratio * lag_ratio]])
    covariance = _product(drive, drive.T) * process_ratio
    for _ in range(40):
        covariance = covariance + _product(transition, _product(covariance, transition.T))
        transition = _product(transition, transition)
    return covariance[0, 0], covariance[1, 1]


@compiled
def _product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix product; numba's own needs scipy, which the live node does not."""
    c = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for k in range(b.shape[1]):
            for j in range(a.shape[1]):
                c[i, k] += a[i, j] * b[j, k]
    return c


@compiled
def _inverse(m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inverse of a 3x3 matrix, by Gauss and Jordan with row exchange."""
    n = 3
    left, right = m.copy(), np.eye(n)
    for column in range(n):
        pivot = column
        for row in range(column + 1, n):
            if abs(left[row, column]) > abs(left[pivot, column]):
                pivot = row
        for k in range(n):
            left[column, k], left[pivot, k] = left[pivot, k], left[column, k]
            right[column, k], right[pivot, k] = right[pivot, k], right[column, k]
        scale = 1.0 / left[column, column]
        for k in range(n):
            left[column, k] *= scale
            right[column, k] *= scale
        for row in range(n):
            if row != column:
                factor = left[row, column]
                for k in range(n):
                    left[row, k] -= factor * left[column, k]
                    right[row, k] -= factor * right[column, k]
    return right
