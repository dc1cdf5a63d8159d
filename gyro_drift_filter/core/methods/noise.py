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

"""The sensor's own noise, learned while the robot runs: its variance R and its correlation.

R is learned over blocks of samples at rest (`rest/` finds it), and never from innovations, so
that motion can't be booked as noise: that is what undoes equation (16) of the paper in motion.
Noise that is correlated from sample to sample is an AR(2) process: as far as two samples tell the
next one, it is predicted.

Before the first rest motion may be in all that is measured, so R is kept low. The third differences
of white noise have 20 times its variance. A block that looks like white noise gives the geometric
mean of its variance and of what its third differences show; any other, and every block at low
rates, gives a small share of the latter, up to what a quiet sensor has. R falls in motion where
these show less. Fast motion looks like noise, too, where a block holds few samples or these lie far
apart, so such a block counts for no more than the blocks before it allow, and only if it is as
quiet as common gyroscopes.
"""

import math
from enum import IntEnum
from typing import TYPE_CHECKING, Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.sample import smallest_change

if TYPE_CHECKING:
    from gyro_drift_filter.core.settings import Settings

NOISE_BLOCK_SECONDS = 0.5
# `forgetting_factor` is the weight that the statistics keep over this time, in s. A block counts as
# NOISE_BLOCK_SECONDS even where it is longer, as at low rates noise is correlated over its samples.
FORGETTING_SECONDS = 0.1
LEAST_NOISE_BLOCK = 50  # samples, where the rate is so low that NOISE_BLOCK_SECONDS hold fewer
FIRST_NOISE_BLOCK = 16  # samples, until anything is known of the noise
KNOWN_BLOCKS = 10  # that a noise level given by the user is worth
LEAST_THIRDS = 10  # third differences, without which a block says nothing

# Before the first rest a block may be noise alone where third differences carry at least this share
# of its variance, and where that is no larger than the noise of any gyroscope. A body moves at up
# to some 25 Hz: where that is more than a quarter of the sample rate, one in 30 blocks of fast
# motion looks as white as noise. There only a block counts that is no louder than common
# gyroscopes. At rates below 50 Hz none does, as nearly all motion looks white.
WHITE = 0.3
LONGEST_DENSE_PERIOD, LONGEST_WHITE_PERIOD = 0.0104, 0.0204  # s
LARGEST_NOISE = 0.2  # rad/s
LARGEST_COMMON_DENSITY = 0.002  # rad/s per root of Hz, twice that of the noisiest common ones
# The variance of each white block is an upper bound of the noise's, as motion can only add to it. R
# is the mean of these bounds, and at most this many times the lowest one.
LARGEST_BOUND = 2.0
# Of what third differences show of another block before the first rest, the share that is taken for
# noise: a hand in motion shows 5 to 200 times the variance of a quiet sensor's noise. Too low costs
# smoothing until a block looks like noise, too high costs motion.
UNKNOWN_SHARE = 0.03
# A block can raise the variance no further than by this factor.
RISE = 4.0
# No MEMS gyroscope is quieter at 100 Hz, in rad/s; so is R until something is known. With less, as
# of a simulator, the fastest mode would not follow a body that is shaken.
LEAST_NOISE = 1e-4
# Too little smoothing costs nothing in motion, and too much costs motion. So a share of motion is
# taken for no more than the noise of a quiet common gyroscope at 50 Hz, in rad/s.
QUIET_NOISE = 4e-4
LARGEST_CORRELATION = 0.995  # that a block can tell
# Where more than this share of the variance can be predicted, the autocorrelation is lowered as if
# white noise were added, which leaves a share of 0.55 to 0.78: with more, a smooth motion would be
# predicted as noise, too.
LARGEST_UNALTERED = 0.72
LEAST_ROUGHNESS = 0.003
# Autocorrelation and roughness are means over ten blocks at the most: this is the weight of one.
LEAST_WEIGHT = 0.1
# White noise has no mean autocorrelation of ten blocks below minus this by chance, as that is six
# standard deviations. What has alternates from sample to sample, as a vibration near half the
# sample rate does: as if it did not, it would be noise of all frequencies, slow ones among them.
CHANCE = 0.2
# In one of 10,000 blocks of 50 samples of noise, third differences show less than its variance by
# this factor. So noise of more than this many times what they show is not there.
LEAST_SHOWN = 4.0

# At lags of one and two samples.
LAGS = 2
PerLag = Annotated[NDArray[np.float64], np.float64, (LAGS,)]


class Bound(IntEnum):
    """What R is taken from before the first rest."""

    NONE = 0
    OF_MOTION = 1  # a share of what is rough in motion
    OF_NOISE = 2  # a block that looks like noise alone


class NoiseCoefficients(TypedDict):
    """What is derived from settings and sample period; for all axes."""

    block_samples: int
    block_forgetting: float  # b of equation (13), from one block to the next
    # (rad/s)^2, up to which a block that looks white may be noise alone, before the first rest
    largest_white: float


class NoiseBlock(TypedDict):
    """Sums over a block of samples, each of them less the first one."""

    count: int  # samples in it
    index: int  # of the next sample in it, where held and missing ones count, too
    run: int  # samples in a row, those before it among them
    origin: float  # the first sample, rad/s
    sum: float
    squares: float
    index_sum: float
    index_squares: float
    moment: float  # sum of the products of sample and index
    first_difference_count: int
    first_differences: float  # sum of squares
    second_lag_count: int
    second_lag_differences: float  # sum of squares, to the sample before the last
    third_difference_count: int
    third_differences: float  # sum of squares
    before: PerAxis  # the three samples before, newest first


class Noise(TypedDict):
    """What is known of the noise of one axis, and the block of samples under way."""

    variance: float  # R, (rad/s)^2
    autocorrelation: PerLag  # of samples one apart, phi of equation (2), and two apart
    # Mean of the first of these, where a negative one counts as 0: by chance it is negative in half
    # of all blocks of white noise, and predicting such noise costs smoothing.
    correlation: float
    # How a sample of it follows from the last one and from the one before, the share of its
    # variance that these predict, and how it follows where only the last one is known.
    coefficients: PerLag
    predicted: float
    coefficient_alone: float
    roughness: float  # share of R that no smooth prediction can follow
    blocks: int  # k of equation (13); 0 where the noise is not known yet
    seen: bool  # a block at rest has been learned from
    # before the first rest
    bound: int  # a member of Bound: what R is taken from
    bounds: int  # how many blocks of that kind there were
    lowest: float  # (rad/s)^2, that they gave
    # the last block, which counts where the next one is at rest, too
    waiting: bool  # noise alone was shown as it ended
    waiting_variance: float
    waiting_autocorrelation: PerLag
    waiting_roughness: float
    resolution: float  # rad/s, the smallest change seen; 0 before the first
    block: NoiseBlock


NOISE = record(Noise)


@kernel
def derive_noise(settings: 'Settings', period: float, coefficients: NoiseCoefficients) -> None:
    """Fill the coefficients for a sample period in s."""
    coefficients['block_samples'] = max(LEAST_NOISE_BLOCK, int(NOISE_BLOCK_SECONDS / period))
    exponent = NOISE_BLOCK_SECONDS / FORGETTING_SECONDS
    coefficients['block_forgetting'] = settings['forgetting_factor'] ** exponent
    coefficients['largest_white'] = LARGEST_NOISE**2
    if period > LONGEST_WHITE_PERIOD:
        coefficients['largest_white'] = 0.0
    elif period > LONGEST_DENSE_PERIOD:
        coefficients['largest_white'] = LARGEST_COMMON_DENSITY**2 / (2.0 * period)


@kernel
def start_noise(noise: Noise, deviation: float, phi: float) -> None:
    """Begin with a standard deviation in rad/s, 0 where it is to be learned.

    `phi` is the correlation of consecutive samples that goes with it, of AR(1) noise.
    """
    known = deviation > 0.0
    correlation = min(max(phi, 0.0), LARGEST_CORRELATION) if known else 0.0
    noise['variance'] = max(deviation, LEAST_NOISE) ** 2
    noise['blocks'] = KNOWN_BLOCKS if known else 0
    noise['seen'] = False
    noise['bound'] = Bound.NONE
    noise['waiting'] = False
    # Of third differences, x(k) - 3 x(k-1) + 3 x(k-2) - x(k-3), of AR(1) noise.
    roughness = 1.0 - correlation * (1.5 - correlation * (0.6 - 0.1 * correlation))
    noise['roughness'] = max(roughness, LEAST_ROUGHNESS)
    noise['autocorrelation'][0] = correlation
    noise['autocorrelation'][1] = correlation * correlation
    noise['correlation'] = correlation
    _derive_prediction(noise)
    noise['resolution'] = 0.0
    restart_block(noise)


@kernel
def is_begun(noise: Noise) -> bool:
    """Return whether R is that of noise, if only of a block that looked like it."""
    return bool(noise['bound'] == Bound.OF_NOISE or noise['blocks'] > 0)


@kernel
def largest_variance(noise: Noise) -> float:
    """Return how large the variance of the noise may be, in (rad/s)^2.

    R is less before the first rest: a share of what may be motion, or nothing is known at all.
    Where a block was constant, R is the larger one.
    """
    if is_begun(noise):
        return noise['variance']
    if noise['bound'] == Bound.NONE:
        return LARGEST_NOISE**2
    return float(max(LEAST_SHOWN * noise['lowest'] / UNKNOWN_SHARE, noise['variance']))


@kernel
def usual_deviation(noise: Noise) -> float:
    """Return by how much samples differ by noise alone, in rad/s: no less than a step."""
    return float(max(math.sqrt(noise['variance']), noise['resolution']))


@kernel
def exceeds_step(noise: Noise) -> bool:
    """Return whether the noise changes by more than a step of the resolution from sample to sample.

    Then a measured rate hardly ever comes twice. Behind a low-pass it may, as the part of the noise
    that no smooth prediction can follow is small there.
    """
    step = noise['resolution']
    return bool(step * step < noise['roughness'] * noise['variance'])


@kernel
def restart_block(noise: Noise) -> None:
    """Forget the block under way."""
    block = noise['block']
    block['count'] = block['index'] = block['run'] = 0
    block['sum'] = block['squares'] = 0.0
    block['index_sum'] = block['index_squares'] = block['moment'] = 0.0
    block['first_difference_count'] = 0
    block['first_differences'] = 0.0
    block['second_lag_count'] = 0
    block['second_lag_differences'] = 0.0
    block['third_difference_count'] = 0
    block['third_differences'] = 0.0


@kernel
def forget_blocks(noise: Noise) -> None:
    """Forget the block under way, and the one that waits."""
    restart_block(noise)
    noise['waiting'] = False
    noise['waiting_variance'] = 0.0


@kernel
def interrupt_block(noise: Noise) -> None:
    """Pass over a sample that is missing or not accepted; the block goes on after it."""
    block = noise['block']
    block['run'] = 0
    if block['count'] > 0:
        block['index'] += 1


@kernel
def learn_noise_from_sample(
    noise: Noise, sample: float, noise_alone: bool, coefficients: NoiseCoefficients
) -> None:
    """Take an accepted sample (rad/s) into the block, and the block into R when it is full.

    `noise_alone` is whether the last samples are that (`rest/`), as far as is known before this
    one.
    """
    block = noise['block']
    if block['run'] >= 1:
        change = abs(sample - block['before'][0])
        noise['resolution'] = smallest_change(noise['resolution'], change)
    _add_sample(block, sample)
    length = coefficients['block_samples'] if is_begun(noise) else FIRST_NOISE_BLOCK
    if block['count'] >= length and block['third_difference_count'] >= LEAST_THIRDS:
        _judge_block(noise, noise_alone, coefficients)
        run = block['run']
        restart_block(noise)
        block['run'] = run  # differences go on across the border of two blocks


@kernel
def _add_sample(block: NoiseBlock, sample: float) -> None:
    """Add a sample (rad/s) to the sums of the block."""
    before, run = block['before'], block['run']
    if block['count'] == 0:
        block['origin'] = sample
    if run >= 1:
        first = sample - before[0]
        block['first_differences'] += first * first
        block['first_difference_count'] += 1
    if run >= 2:
        second = sample - before[1]
        block['second_lag_differences'] += second * second
        block['second_lag_count'] += 1
    if run >= 3:
        third = sample - 3.0 * before[0] + 3.0 * before[1] - before[2]
        block['third_differences'] += third * third
        block['third_difference_count'] += 1
    before[2], before[1], before[0] = before[1], before[0], sample
    deviation, index = sample - block['origin'], 1.0 * block['index']
    block['sum'] += deviation
    block['squares'] += deviation * deviation
    block['index_sum'] += index
    block['index_squares'] += index * index
    block['moment'] += deviation * index
    block['count'] += 1
    block['index'] += 1
    block['run'] = run + 1


@kernel
def _judge_block(noise: Noise, noise_alone: bool, coefficients: NoiseCoefficients) -> None:
    """Take blocks into the statistics, weighted as in equation (13), in place of (16).

    A motion is noticed some time after it has begun, so a block waits for the next one.
    """
    block = noise['block']
    rough = block['third_differences'] / (20.0 * block['third_difference_count'])
    if noise['blocks'] > 0:
        # It falls at once where even the roughness, motion's included, is far below it, as where a
        # motor has stopped; a mean over blocks would take seconds.
        noise['variance'] = min(noise['variance'], LEAST_SHOWN * rough / noise['roughness'])
    # When the first rest is found, it has already lasted for longer than a block.
    if noise_alone and (
        noise['waiting'] or (not noise['seen'] and noise['waiting_variance'] > 0.0)
    ):
        _learn_from_rest(noise, coefficients['block_forgetting'])
    _let_wait(noise, rough)
    noise['waiting'] = noise_alone
    # In motion R never rises.
    if not noise_alone and noise['blocks'] == 0:
        variance = noise['waiting_variance']
        white = rough > WHITE * variance and variance <= coefficients['largest_white']
        if white:
            # It may be motion in part, or noise that is correlated: R lies between the two.
            between = min(variance, math.sqrt(rough * variance))
            if noise['bound'] == Bound.OF_MOTION:
                between = min(between, LEAST_SHOWN * noise['lowest'] / UNKNOWN_SHARE)
            _bound_noise(noise, between, Bound.OF_NOISE)
        else:
            _bound_noise(noise, UNKNOWN_SHARE * rough, Bound.OF_MOTION)
            if noise['bound'] == Bound.OF_NOISE:
                noise['variance'] = min(noise['variance'], LEAST_SHOWN * rough)
    noise['variance'] = max(noise['variance'], LEAST_NOISE**2)
    if noise['seen']:
        # A sensor of coarse steps that shows no noise still errs by a step's rounding.
        rounding = noise['resolution'] * noise['resolution'] / 12.0
        noise['variance'] = max(noise['variance'], rounding)


@kernel
def _bound_noise(noise: Noise, variance: float, bound: Bound) -> None:
    """Take a bound for R, if none of a better kind is known: the lowest, or the mean near it."""
    if bound < noise['bound']:
        return
    if bound > noise['bound']:
        noise['bound'] = bound
        noise['bounds'] = 0
        noise['lowest'] = variance
    noise['bounds'] += 1
    noise['lowest'] = min(noise['lowest'], variance)
    mean = noise['variance'] + (variance - noise['variance']) / noise['bounds']
    largest = LARGEST_BOUND if bound == Bound.OF_NOISE else 1.0
    noise['variance'] = min(mean, largest * noise['lowest'])
    if bound == Bound.OF_MOTION:
        noise['variance'] = min(noise['variance'], QUIET_NOISE**2)


@kernel
def _let_wait(noise: Noise, rough: float) -> None:
    """Keep what the full block shows."""
    block, n = noise['block'], 1.0 * noise['block']['count']
    centred = block['moment'] - block['index_sum'] * block['sum'] / n
    index_scatter = block['index_squares'] - block['index_sum'] * block['index_sum'] / n
    about_line = (
        block['squares'] - block['sum'] * block['sum'] / n - centred * centred / index_scatter
    )
    shown = about_line / (n - 2.0)
    variance = max(shown, LEAST_NOISE**2)
    # What R has beyond that is no noise that was seen, so it is as uncorrelated as white noise.
    raised = variance - shown
    first = block['first_differences'] / (2.0 * block['first_difference_count'])
    second = block['second_lag_differences'] / (2.0 * block['second_lag_count'])
    autocorrelation = noise['waiting_autocorrelation']
    autocorrelation[0] = _limited(1.0 - (first + raised) / variance)
    autocorrelation[1] = _limited(1.0 - (second + raised) / variance)
    noise['waiting_variance'] = variance
    noise['waiting_roughness'] = min(max(rough / variance, LEAST_ROUGHNESS), 1.0)


@kernel
def _limited(correlation: float) -> float:
    """Return a correlation, no stronger than a block can tell."""
    return min(max(correlation, -LARGEST_CORRELATION), LARGEST_CORRELATION)


@kernel
def autoregression(first: float, second: float) -> tuple[float, float]:
    """Return how AR(2) noise follows from the sample before, and from the one before that.

    By the equations of Yule and Walker, from its autocorrelation.
    """
    partial = _limited((second - first * first) / (1.0 - first * first))
    return first * (1.0 - partial), partial


@kernel
def _derive_prediction(noise: Noise) -> None:
    """Write how the noise of a sample follows from the two before, as far as that is used."""
    first, second = noise['correlation'], noise['autocorrelation'][1]
    if noise['blocks'] * LEAST_WEIGHT >= 1.0 and noise['autocorrelation'][0] < -CHANCE:
        first = noise['autocorrelation'][0]
    a, b = autoregression(first, second)
    predicted = a * first + b * (a * first + b)
    if predicted > LARGEST_UNALTERED:
        # White noise that is added lowers the autocorrelation.
        share = math.sqrt(LARGEST_UNALTERED / predicted)
        first, second = share * first, share * second
        a, b = autoregression(first, second)
        predicted = a * first + b * (a * first + b)
    noise['coefficients'][0], noise['coefficients'][1] = a, b
    noise['predicted'] = predicted
    largest = math.sqrt(LARGEST_UNALTERED)
    noise['coefficient_alone'] = min(max(first, -largest), largest)


@kernel
def prediction_of(noise: Noise) -> tuple[float, float, float]:
    """Return how the noise of the next sample follows from the samples before.

    The coefficients of the last sample and of the one before it, 0 where that was not accepted; and
    the share of the variance that they predict.
    """
    run = noise['block']['run']
    if run >= LAGS:
        return noise['coefficients'][0], noise['coefficients'][1], noise['predicted']
    alone = noise['coefficient_alone'] if run > 0 else 0.0
    return alone, 0.0, alone * alone


@kernel
def _learn_from_rest(noise: Noise, block_forgetting: float) -> None:
    """Take the block that waits into the statistics."""
    variance = noise['waiting_variance']
    noise['seen'] = True
    if noise['blocks'] == 0:
        noise['variance'] = variance
    noise['blocks'] += 1
    # A float exponent, as compiled and plain Python raise to an integer one differently.
    weight = (1.0 - block_forgetting) / (1.0 - block_forgetting ** float(noise['blocks']))  # (13)
    limited = min(variance, RISE * noise['variance'])
    noise['variance'] += weight * (limited - noise['variance'])
    shape_weight = max(1.0 / noise['blocks'], LEAST_WEIGHT)
    waiting, autocorrelation = noise['waiting_autocorrelation'], noise['autocorrelation']
    for lag in range(LAGS):
        autocorrelation[lag] += shape_weight * (waiting[lag] - autocorrelation[lag])
    noise['correlation'] += shape_weight * (max(waiting[0], 0.0) - noise['correlation'])
    _derive_prediction(noise)
    noise['roughness'] += shape_weight * (noise['waiting_roughness'] - noise['roughness'])
