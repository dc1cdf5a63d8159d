"""The bias of the gyroscope, tracked at rest: one small Kalman filter per axis.

The measurement is the mean rate of a package of rest (`rest.py`), its noise what such means scatter
by. In between the bias walks at random. It either wanders, as fast as `bias.random_walk` allows, or
is steady and walks a tenth as fast; how likely either is each package tells before it is learned
from. So one that is steady is an average over many packages, and one that begins to wander, as a
sensor that warms up, is followed at once.

A constant slow turn can't be told from a bias by an IMU alone, so a package is believed only where

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

from gyro_drift_filter.core.compiled import compiled
from gyro_drift_filter.core.rest import (
    MOVED,
    NOTHING,
    REST,
    WHOLE,
    close_block,
    mean_variance,
    next_package,
    note_sample,
    package_mean,
    package_variance,
    start_rest,
)

_AXES = (3,)

# A package is believed within so many deviations of where the bias can be.
GATE = 3.5
# Several packages in a row, up to so many, have to lie closer: they tell a turn of the bias's size.
RECENT_GATE, RECENT = 3.0, 8
# The variance of the random walk of a steady bias, as a share of that of one that wanders.
STEADY_SHARE = 0.01
# A bias wanders with this probability before anything is known. Of what is known this share is
# forgotten with a package before which it may have wandered far, as it may have begun to.
WANDERING, FORGOTTEN = 0.02, 0.05
# Logarithm of a ratio of likelihoods: more tells no more, and overflows.
LARGEST_EVIDENCE = 50.0
# A rate of rest that is not believed is the bias after all if it stays for so long.
LONGEST_TURN = 90.0  # s
# After a slow turn so many packages of rest in a row have to agree before they are believed: a turn
# to and fro passes the bias.
DOUBTED = 2
# It stays where a package lies within so many deviations of those before.
SAME = 4.0

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
        ('wandering', np.float64),
        # of the state, that ended as it was taken in; 0 where it was not
        ('walked', np.float64),
        ('jumped', np.float64),
    ],
    align=True,
)

BIAS = np.dtype(
    [
        ('rest', REST),
        ('known', np.bool_),
        ('bias', np.float64, _AXES),  # rad/s
        ('variance', np.float64, _AXES),  # (rad/s)^2
        ('wandering', np.float64),  # probability that the bias wanders
        # (rad/s)^2, since the last package
        ('walked', np.float64),  # variance that a random walk has added, where the bias wanders
        ('jumped', np.float64),  # and what else may have moved it
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


@compiled
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
    state['wandering'] = WANDERING
    state['doubt'] = 0
    state['temperature'] = np.nan
    state['walked'] = 0.0
    state['jumped'] = 0.0
    state['turn_seconds'] = 0.0


@compiled
def leave_rest(state: Any) -> None:
    """Forget the rest under way: time has jumped, or the filter starts anew. The bias is kept."""
    start_rest(state['rest'])
    _forget_stillness(state)


@compiled
def _forget_stillness(state: Any) -> None:
    state['recent_count'] = 0
    state['beyond'] = False
    state['still_seconds'] = 0.0
    state['still_blocks'] = 0.0
    for axis in range(3):
        state['still_sum'][axis] = 0.0


@compiled
def bias_variance(state: Any, axis: int) -> float:
    """Return the variance of the bias at present, in (rad/s)^2."""
    return _variance(state, axis, STEADY_SHARE + (1.0 - STEADY_SHARE) * state['wandering'])


@compiled
def _variance(state: Any, axis: int, share: float) -> float:
    """Return the variance of a bias whose random walk has this share of the variance allowed."""
    return float(state['variance'][axis] + share * state['walked'] + state['jumped'])


@compiled
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
    state['walked'] += random_walk * random_walk * elapsed
    believed = believed and state['hint'] != MOVES
    if not note_sample(rest, sample, believed, missing, lengths):
        return
    run = rest['run']
    found = close_block(rest, lengths)
    if found != NOTHING:
        _take_package(state, found == MOVED, largest, lengths['block_seconds'], calibration_time)
    if rest['run'] < run:
        _forget_stillness(state)


@compiled
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


@compiled
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
    # As `bias_variance`, for all axes at once.
    share = STEADY_SHARE + (1.0 - STEADY_SHARE) * state['wandering']
    deviation: NDArray[np.float64] = np.sqrt(
        state['variance'] + share * state['walked'] + state['jumped']
    )
    return deviation


@compiled
def calibrate_bias(state: Any) -> None:
    """Take the mean of the stillness under way for the bias, whatever the bias was."""
    for axis in range(3):
        blocks = state['still_blocks']
        state['bias'][axis] = state['still_sum'][axis] / blocks
        state['variance'][axis] = mean_variance(state['rest'], axis, blocks)
    # What came before tells nothing against it.
    state['recent_count'] = 0
    state['doubt'] = 0
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
        state['jumped'] += coefficient * change * coefficient * change
    state['temperature'] = temperature


@compiled
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
            spread = _variance(state, axis, 1.0) + package_variance(rest, axis)
            if distance * distance > GATE * GATE * spread:
                state['jumped'] = max(state['jumped'], distance * distance)
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


@compiled
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
    last['wandering'] = state['wandering']
    last['walked'] = 0.0
    last['jumped'] = 0.0


@compiled
def _turned(state: Any) -> int:
    """Return how many of the last packages lie together where no bias can have come, 0 for none."""
    recent = state['recent']
    for axis in range(3):
        total = noise = 0.0
        reach = state['walked'] + state['jumped']
        for i in range(state['recent_count']):
            package, count = recent[i], i + 1.0
            total += package['mean'][axis]
            noise += package['noise'][axis]
            reach += package['walked'] + package['jumped']
            distance = total / count - package['bias'][axis]
            spread = package['variance'][axis] + reach + noise / (count * count)
            gate = GATE if i == 0 else RECENT_GATE
            if distance * distance > gate * gate * spread:
                return i + 1
    return 0


@compiled
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
    state['wandering'] = before['wandering']
    for i in range(count):
        package = recent[i]
        state['walked'] += package['walked']
        state['jumped'] += package['jumped']
        package['walked'] = 0.0
        package['jumped'] = 0.0
        package['wandering'] = before['wandering']
        for axis in range(3):
            package['bias'][axis] = before['bias'][axis]
            package['variance'][axis] = before['variance'][axis]


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
    state['recent_count'] = 0
    return True


@compiled
def _learn(state: Any) -> None:
    """Take the package into the bias."""
    rest = state['rest']
    if state['known']:
        _judge_wandering(state)
        _update(state)
        state['recent'][0]['walked'] = state['walked']
        state['recent'][0]['jumped'] = state['jumped']
    else:
        for axis in range(3):
            state['bias'][axis] = package_mean(rest, axis)
            state['variance'][axis] = package_variance(rest, axis)
    _settle(state)


@compiled
def _judge_wandering(state: Any) -> None:
    """Learn whether the bias wanders from how well the package was foretold: Bayes' rule."""
    rest = state['rest']
    evidence = far = 0.0
    for axis in range(3):
        noise = package_variance(rest, axis)
        innovation = package_mean(rest, axis) - state['bias'][axis]
        wandering = _variance(state, axis, 1.0) + noise
        steady = _variance(state, axis, STEADY_SHARE) + noise
        evidence += 0.5 * innovation * innovation * (1.0 / steady - 1.0 / wandering)
        evidence += 0.5 * math.log(steady / wandering)
        far += state['walked'] / wandering / 3.0
    prior = state['wandering'] + FORGOTTEN * far * (WANDERING - state['wandering'])
    likelihood = math.exp(min(max(evidence, -LARGEST_EVIDENCE), LARGEST_EVIDENCE))
    state['wandering'] = prior * likelihood / (prior * likelihood + 1.0 - prior)


@compiled
def _update(state: Any) -> None:
    """Update the bias as one that wanders and as a steady one, and take the mean of the two.

    This is the generalised pseudo-Bayesian estimator of first order.
    """
    rest, probability = state['rest'], state['wandering']
    for axis in range(3):
        noise = package_variance(rest, axis)
        innovation = package_mean(rest, axis) - state['bias'][axis]
        wandering, steady = _variance(state, axis, 1.0), _variance(state, axis, STEADY_SHARE)
        gain, steady_gain = wandering / (wandering + noise), steady / (steady + noise)
        apart = (gain - steady_gain) * innovation
        state['bias'][axis] += steady_gain * innovation + probability * apart
        state['variance'][axis] = (
            probability * (1.0 - gain) * wandering
            + (1.0 - probability) * (1.0 - steady_gain) * steady
            + probability * (1.0 - probability) * apart * apart
        )


@compiled
def _settle(state: Any) -> None:
    """Begin to count anew what the bias may have done since it was learned."""
    state['known'] = True
    state['beyond'] = False
    state['packages'] += 1
    state['walked'] = 0.0
    state['jumped'] = 0.0
    state['turn_seconds'] = 0.0
