"""The bias of the gyroscope, tracked at rest: one small Kalman filter per axis.

The measurement is the mean rate of a package of rest (`rest.py`), its noise what such means scatter
by. Between rests the bias walks at random. A constant slow turn can't be told from a bias by an IMU
alone, so a package is believed only where

- its mean is within `bias.max` on all axes, and
- it lies where the bias can have come since the last one, by the deviation of the bias.

A rate that stays elsewhere at rest for long, or that comes back after motion, is the bias after
all: the filter had learned a turn.
"""

import math
from typing import Any

import numpy as np

from gyro_drift_filter.core.compiled import compiled
from gyro_drift_filter.core.rest import (
    MOVED,
    NOTHING,
    REST,
    block_seconds,
    close_block,
    next_package,
    note_sample,
    package_mean,
    package_variance,
    start_rest,
)

_AXES = (3,)

# A package is believed within so many deviations of where the bias can be.
GATE = 3.5
# At rest the bias walks slower than in motion, in which it may also warm up: share of the variance.
REST_SHARE = 0.02
# How fast the bias walks is learned from how well it was foretold: this share per package, down to
# this share of the variance that the parameter allows.
LEARNING, LEAST_WALK, LARGEST_SURPRISE = 0.4, 0.003, 4.0
# A rate of rest that is not believed is the bias after all if it stays for so long.
LONGEST_TURN = 90.0  # s
# After a slow turn so many packages of one rest have to agree before they are believed: a turn to
# and fro passes the bias.
DOUBTED = 2
# It stays where a package lies within so many deviations of those before.
SAME = 4.0

# What the robot says of itself: nothing, that it moves, that it stands; good for so long.
SILENT, MOVES, STANDS = 0, 1, 2
HINT_SECONDS = 1.0

BIAS = np.dtype(
    [
        ('rest', REST),
        ('known', np.bool_),
        ('bias', np.float64, _AXES),  # rad/s
        ('variance', np.float64, _AXES),  # (rad/s)^2
        ('walk', np.float64),  # share of the random walk's variance that the bias takes
        ('growth', np.float64),  # (rad/s)^2, of the variance since the last package
        ('reach', np.float64),  # (rad/s)^2, the same with all of the random walk
        ('hint', np.int64),
        ('hint_seconds', np.float64),  # until it is forgotten
        ('temperature', np.float64),  # in deg C, at the last growth for it; NaN before the first
        # the stillness under way, whether its rate is believed to be the bias or not
        ('still_seconds', np.float64),
        ('still_blocks', np.float64),
        ('still_sum', np.float64, _AXES),  # rad/s
        ('rest_seconds', np.float64),  # since the last rest
        ('doubt', np.int64),  # packages of rest to go until one is believed after a slow turn
        ('turn', np.float64, _AXES),  # rad/s, rate of rest that was not believed
        ('turn_seconds', np.float64),  # for how long
        ('beyond', np.bool_),  # stillness under way has a rate beyond the largest bias
        # counts
        ('packages', np.int64),  # that the bias was learned from
        ('beyond_max', np.int64),  # at rest with a rate that no bias has
        ('turning', np.int64),  # at rest with a rate that the bias can't have come to
    ],
    align=True,
)


@compiled
def start_bias(state: Any, bias: Any, variance: Any) -> None:
    """Begin with a bias (3,) in rad/s and its variance (3,), infinite where nothing is known."""
    start_rest(state['rest'])
    state['known'] = True
    for axis in range(3):
        state['bias'][axis] = bias[axis]
        state['variance'][axis] = variance[axis]
        if not variance[axis] < np.inf:
            state['known'] = False
            state['variance'][axis] = 0.0
    state['walk'] = 1.0
    state['doubt'] = 0
    state['temperature'] = np.nan
    state['growth'] = 0.0
    state['reach'] = 0.0
    state['turn_seconds'] = 0.0


@compiled
def bias_variance(state: Any, axis: int) -> float:
    """Return the variance of the bias at present, in (rad/s)^2."""
    return float(state['variance'][axis] + state['growth'])


@compiled
def track_bias(
    state: Any,
    rate: Any,
    acceleration: Any,
    believed: bool,
    missing: int,
    elapsed: float,
    period: float,
    largest: float,
    random_walk: float,
    calibration_time: float,
) -> None:
    """Take a sample in: rate (3,) in rad/s, acceleration (3,) in m/s^2; `missing` ones before it.

    `elapsed` in s since the last sample, `period` in s; `largest` is bias.max in rad/s,
    `random_walk` in rad/s/sqrt(s), `calibration_time` in s.
    """
    rest = state['rest']
    state['hint_seconds'] -= elapsed
    if state['hint_seconds'] <= 0.0:
        state['hint'] = SILENT
    state['rest_seconds'] = 0.0 if rest['at_rest'] else state['rest_seconds'] + elapsed
    walked = random_walk * random_walk * elapsed
    state['reach'] += walked
    state['growth'] += walked * state['walk'] * (REST_SHARE if rest['at_rest'] else 1.0)
    believed = believed and state['hint'] != MOVES
    note_sample(rest, rate, acceleration, believed, missing, period)
    run = rest['run']
    found = close_block(rest, period)
    if rest['run'] < run:
        state['beyond'] = False
        if state['doubt'] > 0:
            state['doubt'] = DOUBTED
        state['still_seconds'] = 0.0
        state['still_blocks'] = 0.0
        for axis in range(3):
            state['still_sum'][axis] = 0.0
    if found == NOTHING:
        return
    if state['hint'] == MOVES:
        next_package(rest, True)
        return
    if found != MOVED:
        _note_stillness(state, period, calibration_time)
    if _is_bias(state, largest, period):
        _learn(state)
        next_package(rest, found == MOVED)
    else:
        next_package(rest, True)
        rest['at_rest'] = False


@compiled
def _note_stillness(state: Any, period: float, calibration_time: float) -> None:
    """Keep the mean rate of the last stillness, of one to two times `calibration_time` s."""
    rest = state['rest']
    if state['still_seconds'] > 2.0 * calibration_time:
        state['still_seconds'] *= 0.5
        state['still_blocks'] *= 0.5
        for axis in range(3):
            state['still_sum'][axis] *= 0.5
    state['still_seconds'] += rest['blocks'] * block_seconds(period)
    state['still_blocks'] += rest['blocks']
    for axis in range(3):
        state['still_sum'][axis] += rest['blocks'] * package_mean(rest, axis)


@compiled
def calibrate_bias(state: Any) -> None:
    """Take the mean of the stillness under way for the bias, whatever the bias was."""
    for axis in range(3):
        blocks = state['still_blocks']
        state['bias'][axis] = state['still_sum'][axis] / blocks
        state['variance'][axis] = state['rest']['signals'][axis]['scatter'] / blocks
    _settle(state)


@compiled
def warm_bias(state: Any, temperature: float, step: float, coefficient: float) -> None:
    """Widen the bias for a change of temperature (deg C) of more than `step` since the last one.

    `coefficient` is how far the bias may move, in rad/s per K.
    """
    if not abs(temperature) < np.inf:
        return
    change = temperature - state['temperature']
    if abs(change) <= step:
        return
    if abs(change) < np.inf:
        moved = coefficient * change * coefficient * change
        state['growth'] += moved
        state['reach'] += moved
    state['temperature'] = temperature


@compiled
def _is_bias(state: Any, largest: float, period: float) -> bool:
    """Tell whether the package is rest: its rate is one that the bias can have."""
    rest = state['rest']
    for axis in range(3):
        if abs(package_mean(rest, axis)) > largest:
            state['beyond_max'] += 1
            state['beyond'] = True
            return False
    if not state['known']:
        return True
    farthest = 0.0
    for axis in range(3):
        distance = package_mean(rest, axis) - state['bias'][axis]
        spread = state['variance'][axis] + state['reach'] + package_variance(rest, axis)
        if distance * distance > GATE * GATE * spread:
            farthest = max(farthest, distance * distance)
    if state['hint'] == STANDS:
        # It stands there by the robot's own word, so that is how far the bias has come.
        state['growth'] = max(state['growth'], farthest)
        return True
    if farthest > 0.0:
        state['turning'] += 1
        state['doubt'] = DOUBTED
        return _stays(state, rest['blocks'] * block_seconds(period))
    state['doubt'] = max(state['doubt'] - 1, 0)
    return bool(state['doubt'] == 0)


@compiled
def _stays(state: Any, seconds: float) -> bool:
    """Tell whether rest has had this rate, which is not the bias, for too long to be a turn."""
    rest = state['rest']
    for axis in range(3):
        mean = package_mean(rest, axis)
        distance = mean - state['turn'][axis]
        if distance * distance > SAME * SAME * 2.0 * package_variance(rest, axis):
            state['turn_seconds'] = 0.0
    for axis in range(3):
        state['turn'][axis] = package_mean(rest, axis)
    state['turn_seconds'] += seconds
    if state['turn_seconds'] < LONGEST_TURN:
        return False
    state['known'] = False
    return True


@compiled
def _learn(state: Any) -> None:
    """Take the package into the bias, and how well it was foretold into the random walk."""
    rest = state['rest']
    surprise = share = 0.0
    for axis in range(3):
        mean, noise = package_mean(rest, axis), package_variance(rest, axis)
        if state['known']:
            variance = state['variance'][axis] + state['growth']
            innovation, spread = mean - state['bias'][axis], variance + noise
            surprise += innovation * innovation / spread / 3.0
            share += state['growth'] / spread / 3.0
            gain = variance / spread
            state['bias'][axis] += gain * innovation
            state['variance'][axis] = (1.0 - gain) * variance
        else:
            state['bias'][axis] = mean
            state['variance'][axis] = noise
    if state['known']:
        exponent = LEARNING * share * (min(surprise, LARGEST_SURPRISE) - 1.0)
        state['walk'] = min(max(state['walk'] * math.exp(exponent), LEAST_WALK), 1.0)
    _settle(state)


@compiled
def _settle(state: Any) -> None:
    """Begin to count anew what the bias may have done since it was learned."""
    state['known'] = True
    state['beyond'] = False
    state['packages'] += 1
    state['growth'] = 0.0
    state['reach'] = 0.0
    state['turn_seconds'] = 0.0
