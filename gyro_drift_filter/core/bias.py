"""The bias of the gyroscope, tracked at rest: one small Kalman filter per axis.

The measurement is the mean rate of a package of rest (`rest.py`), its noise what such means scatter
by. Between rests the bias walks at random. A constant slow turn can't be told from a bias by an IMU
alone, so a package is believed only where

- its mean is within `bias.max` on all axes, and
- it lies where the bias can have come since the last one, by the deviation of the bias, and so do
  the last ones of this rest together, however many of them.

A rate that stays elsewhere at rest for long, or that comes back after motion, is the bias after
all: the filter had learned a turn.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate.kernels import kernel
from gyro_drift_filter.core.rest import (
    MOVED,
    NOTHING,
    REST,
    WHOLE,
    close_block,
    next_package,
    note_sample,
    package_mean,
    package_variance,
    start_rest,
    variance_of_mean,
)

_AXES = (3,)

# A package is believed within so many deviations of where the bias can be.
GATE = 3.5
# Several packages in a row, up to so many, have to lie closer: they tell a turn of the bias's size.
RECENT_GATE, RECENT = 3.0, 8
# At rest the bias walks slower than in motion, in which it may also warm up: share of the variance.
# With more a quiet sensor's bias follows the slow part of its noise.
REST_SHARE = 0.003
# How fast the bias walks is learned from how well it was foretold: this share per package, down to
# this share of the variance that the parameter allows.
LEARNING, LEAST_WALK, LARGEST_SURPRISE = 0.4, 0.003, 4.0
# A rate of rest that is not believed is the bias after all if it stays for so long.
LONGEST_TURN = 90.0  # s
# After a slow turn so many packages of rest in a row have to agree before they are believed: a turn
# to and fro passes the bias.
DOUBTED = 2
# It stays where a package lies within so many deviations of those before.
SAME = 4.0

LARGEST_STEP = 1.0  # rad/s: no change of temperature moves the bias by more

# What the robot says of itself: nothing, that it moves, that it stands; good for so long.
SILENT, MOVES, STANDS = 0, 1, 2
HINT_SECONDS = 1.0

PACKAGE = np.dtype(
    [
        ('mean', np.float64, _AXES),  # rad/s
        ('noise', np.float64, _AXES),  # variance of the mean, (rad/s)^2
        # of the bias before it was taken in
        ('bias', np.float64, _AXES),
        ('variance', np.float64, _AXES),
        # of the state, that ended as it was taken in; 0 where it was not
        ('growth', np.float64),
        ('reach', np.float64),
    ],
    align=True,
)

BIAS = np.dtype(
    [
        ('rest', REST),
        ('known', np.bool_),
        ('bias', np.float64, _AXES),  # rad/s
        ('variance', np.float64, _AXES),  # (rad/s)^2
        ('walk', np.float64),  # share of the random walk's variance that the bias takes
        ('growth', np.float64),  # (rad/s)^2, of the variance since the last package
        ('reach', np.float64),  # (rad/s)^2, the same with all of the random walk
        ('recent', PACKAGE, (RECENT,)),  # packages of this rest, the last one first
        ('recent_count', np.int64),
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


@kernel
def start_bias(state: Any, bias: Any, variance: Any) -> None:
    """Begin with a bias (3,) in rad/s and its variance (3,), infinite where nothing is known."""
    leave_rest(state)
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


@kernel
def leave_rest(state: Any) -> None:
    """Forget the rest under way: time has jumped, or the filter starts anew. The bias is kept."""
    start_rest(state['rest'])
    _forget_stillness(state)


@kernel
def _forget_stillness(state: Any) -> None:
    state['recent_count'] = 0
    state['beyond'] = False
    state['still_seconds'] = 0.0
    state['still_blocks'] = 0.0
    for axis in range(3):
        state['still_sum'][axis] = 0.0


@kernel
def bias_variance(state: Any, axis: int) -> float:
    """Return the variance of the bias at present, in (rad/s)^2."""
    return float(state['variance'][axis] + state['growth'])


@kernel
def track_bias(
    state: Any,
    sample: Any,
    believed: bool,
    missing: int,
    elapsed: float,
    lengths: Any,
    largest: float,
    random_walk: float,
    calibration_time: float,
) -> None:
    """Take a record of SAMPLE in; `missing` ones before it.

    `elapsed` in s since the last sample; `lengths` a record of LENGTHS; `largest` is bias.max in
    rad/s, `random_walk` in rad/s/sqrt(s), `calibration_time` in s.
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
    if not note_sample(rest, sample, believed, missing, lengths):
        return
    run = rest['run']
    found = close_block(rest, lengths)
    if found != NOTHING:
        _take_package(state, found == MOVED, largest, lengths['block_seconds'], calibration_time)
    if rest['run'] < run:
        _forget_stillness(state)


@kernel
def _take_package(
    state: Any, moved: bool, largest: float, block_seconds: float, calibration_time: float
) -> None:
    """Learn from a package that is ready; `moved` where the rest ended with it."""
    rest = state['rest']
    if state['hint'] == MOVES:
        next_package(rest, True)
        return
    if moved:
        # By itself: the begin of the motion may be in it.
        state['recent_count'] = 0
    else:
        _note_stillness(state, block_seconds, calibration_time)
    if _is_bias(state, moved, largest, block_seconds):
        _learn(state)
        state['rest_seconds'] = 0.0
        next_package(rest, moved)
    else:
        next_package(rest, True)
        rest['at_rest'] = False


@kernel
def _note_stillness(state: Any, block_seconds: float, calibration_time: float) -> None:
    """Keep the mean rate of the last stillness, of one to two times `calibration_time` s."""
    rest = state['rest']
    if state['still_seconds'] > 2.0 * calibration_time:
        state['still_seconds'] *= 0.5
        state['still_blocks'] *= 0.5
        for axis in range(3):
            state['still_sum'][axis] *= 0.5
    state['still_seconds'] += rest['blocks'] * block_seconds
    state['still_blocks'] += rest['blocks']
    for axis in range(3):
        state['still_sum'][axis] += rest['blocks'] * package_mean(rest, axis)


def bias_deviation(state: Any) -> NDArray[np.float64]:
    """Return the standard deviation of a BIAS at present, (3,) in rad/s."""
    deviation: NDArray[np.float64] = np.sqrt(state['variance'] + state['growth'])
    return deviation


@kernel
def calibrate_bias(state: Any) -> None:
    """Take the mean of the stillness under way for the bias, whatever the bias was."""
    for axis in range(3):
        blocks = state['still_blocks']
        state['bias'][axis] = state['still_sum'][axis] / blocks
        state['variance'][axis] = variance_of_mean(state['rest'], axis, blocks)
    # What came before tells nothing against it.
    state['recent_count'] = 0
    state['doubt'] = 0
    _settle(state)


@kernel
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
        moved = min(coefficient * abs(change), LARGEST_STEP)
        state['growth'] += moved * moved
        state['reach'] += moved * moved
    state['temperature'] = temperature


@kernel
def _is_bias(state: Any, moved: bool, largest: float, block_seconds: float) -> bool:
    """Tell whether the package is rest: its rate is one that the bias can have.

    `moved` where the rest ended with it.
    """
    rest = state['rest']
    for axis in range(3):
        if abs(package_mean(rest, axis)) > largest:
            state['beyond_max'] += 1
            state['beyond'] = True
            return False
    if not state['known']:
        return True
    if state['hint'] == STANDS:
        # It stands there by the robot's own word, so that is how far the bias has come.
        for axis in range(3):
            distance = package_mean(rest, axis) - state['bias'][axis]
            spread = state['variance'][axis] + state['reach'] + package_variance(rest, axis)
            if distance * distance > GATE * GATE * spread:
                state['growth'] = max(state['growth'], distance * distance)
        state['recent_count'] = 0
        return True
    _note_package(state)
    turned = _turned(state)
    if turned > 0 and moved:
        return False  # what is in it of the motion to come tells nothing of the rests to come
    if turned > 0:
        state['turning'] += 1
        state['doubt'] = DOUBTED
        _take_back(state, turned)
        return _stays(state, rest['blocks'] * block_seconds)
    if rest['halves'] == WHOLE:  # else two were needed to find one of rest: that lifts no doubt
        state['doubt'] = max(state['doubt'] - 1, 0)
    return bool(state['doubt'] == 0)


@kernel
def _note_package(state: Any) -> None:
    """Put the package before the others of this rest."""
    recent = state['recent']
    count = min(state['recent_count'], RECENT - 1)
    for i in range(count, 0, -1):
        recent[i] = recent[i - 1]
    state['recent_count'] = count + 1
    last = recent[0]
    for axis in range(3):
        last['mean'][axis] = package_mean(state['rest'], axis)
        last['noise'][axis] = package_variance(state['rest'], axis)
        last['bias'][axis] = state['bias'][axis]
        last['variance'][axis] = state['variance'][axis]
    last['growth'] = 0.0
    last['reach'] = 0.0


@kernel
def _turned(state: Any) -> int:
    """Return how many of the last packages lie together where no bias can have come, 0 for none."""
    recent = state['recent']
    for axis in range(3):
        total = noise = 0.0
        reach = state['reach']
        for i in range(state['recent_count']):
            package, count = recent[i], i + 1.0
            total += package['mean'][axis]
            noise += package['noise'][axis]
            reach += package['reach']
            distance = total / count - package['bias'][axis]
            spread = package['variance'][axis] + reach + noise / (count * count)
            gate = GATE if i == 0 else RECENT_GATE
            if distance * distance > gate * gate * spread:
                return i + 1
    return 0


@kernel
def _take_back(state: Any, count: int) -> None:
    """Unlearn the last `count` packages."""
    if count == 1:
        state['recent_count'] = 0
        return
    recent = state['recent']
    before = recent[count - 1]
    for axis in range(3):
        state['bias'][axis] = before['bias'][axis]
        state['variance'][axis] = before['variance'][axis]
    for i in range(count):
        package = recent[i]
        state['growth'] += package['growth']
        state['reach'] += package['reach']
        package['growth'] = 0.0
        package['reach'] = 0.0
        for axis in range(3):
            package['bias'][axis] = before['bias'][axis]
            package['variance'][axis] = before['variance'][axis]


@kernel
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
    state['recent_count'] = 0
    return True


@kernel
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
        state['recent'][0]['growth'] = state['growth']
        state['recent'][0]['reach'] = state['reach']
    _settle(state)


@kernel
def _settle(state: Any) -> None:
    """Begin to count anew what the bias may have done since it was learned."""
    state['known'] = True
    state['beyond'] = False
    state['packages'] += 1
    state['growth'] = 0.0
    state['reach'] = 0.0
    state['turn_seconds'] = 0.0
