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

"""Where a sensor that is turned by hand lies still.

At rest there is nothing but noise, so a quarter of a second of rest varies as the quietest quarters
of the recording do, on every axis of gyroscope and accelerometer. The first and the last quarter
are left out, as a hand lets go gently. Motion that is too even to be seen so is seen in the means:
gravity moves, or the rate is another one than in all other rests.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.calibrate import CalibrationError
from gyro_drift_filter.calibrate.track import Track
from gyro_drift_filter.gravity import GRAVITY

BLOCK_SECONDS = 0.25
LEAST_BLOCK = 5  # samples, to know how they vary
SHORTEST_SECONDS = 1.0
# A bias wanders while the sensor warms up: longer rests are taken as several.
LONGEST_SECONDS = 20.0
# At least this share of a recording is at rest: its noise is that of the quietest blocks.
QUIETEST = 0.1
# How far the deviation within blocks of some ten samples scatters, and how far means do.
DEVIATIONS, MEANS = 3.0, 6.0
# A table bends and a sensor settles by this.
LARGEST_TILT = np.radians(0.1)
# Beyond what gravity (0.1 deg/s for each g) and warming do to a bias: this is a slow turn.
LARGEST_BIAS_STEP = np.radians(0.5)


@dataclass(frozen=True)
class Rest:
    """The sensor lies still: samples `first` up to, and without, `stop` of a track.

    Attributes:
        first: Index of a sample.
        stop: Index of a sample.
        time: Of its middle in s.
        seconds: Its length.
        rate: (3,) mean in rad/s.
        acceleration: (3,) mean in m/s^2; NaN where there is no accelerometer.
    """

    first: int
    stop: int
    time: float
    seconds: float
    rate: Floats
    acceleration: Floats


@dataclass(frozen=True)
class Rests:
    """The rests of a track.

    Attributes:
        track: The recording: of one sensor, one time after power-on.
        rests: In order.
        moved: Time in s of stretches that looked like rest but moved evenly.
        rate_density: (3,) of the gyroscope's noise, (rad/s)^2 s: the variance of a mean over a
            second.
        acceleration_density: (3,) of the accelerometer's noise, (m/s^2)^2 s.
    """

    track: Track
    rests: tuple[Rest, ...]
    moved: tuple[float, ...]
    rate_density: Floats
    acceleration_density: Floats


def find_rests(track: Track) -> Rests:
    """Return the rests of a track, and its noise: without any, that of its quietest blocks.

    Raises:
        CalibrationError: It is shorter than a block.
    """
    period = track.period
    size = max(LEAST_BLOCK, round(BLOCK_SECONDS / period))
    values = track.rates
    if track.accelerations is not None:
        values = np.hstack([values, track.accelerations])
    count = len(values) // size
    if count == 0:
        raise CalibrationError(
            f'its {len(values)} samples last for {track.seconds[-1]:.2g} s: too short for a rest'
        )
    blocks = values[: count * size].reshape(count, size, -1)
    means, deviations = blocks.mean(axis=1), blocks.std(axis=1)
    # Where counts are coarser than the noise, it is rounding that makes the deviation.
    level = np.maximum(np.quantile(deviations, QUIETEST, axis=0), _resolution(values) / 12**0.5)
    still = (deviations <= DEVIATIONS * level).all(axis=1)
    lost = np.add.reduceat(track.broken, np.arange(0, count * size, size)) > 0
    still &= ~lost[:count]
    steps = np.diff(means, axis=0)[still[1:] & still[:-1]]
    noise = level / size**0.5
    if len(steps):
        # A deviation is 1.4826 times the median size of normal values; a step is one of two means.
        noise = np.maximum(noise, 1.4826 * np.median(np.abs(steps), axis=0) / 2**0.5)
    density = noise**2 * size * period
    rests, moved = [], []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still, [0]])))
    for first, stop in edges.reshape(-1, 2):
        near = np.abs(means[first:stop] - np.median(means[first:stop], axis=0)) < MEANS * noise
        inside = np.flatnonzero(near[:, :3].all(axis=1))
        if not len(inside):
            continue
        first, stop = first + inside[0] + 1, first + inside[-1]
        if (stop - first) * size * period < SHORTEST_SECONDS:
            continue
        if _tilts(means[first:stop, 3:], noise[3:]):
            moved.append(float(track.seconds[first * size]))
            continue
        pieces = min(int(np.ceil((stop - first) * size * period / LONGEST_SECONDS)), stop - first)
        cuts = np.linspace(first * size, stop * size, pieces + 1).astype(int)
        rests += [_rest(track, a, b) for a, b in pairwise(cuts)]
    rests, turning = _of_one_rate(rests)
    acceleration_density = density[3:] if track.accelerations is not None else np.full(3, np.nan)
    moved = sorted(moved + turning)
    return Rests(track, tuple(rests), tuple(moved), density[:3], acceleration_density)


def _resolution(values: Floats) -> Floats:
    """Return the smallest step of each column."""
    out = np.zeros(values.shape[1])
    for k, column in enumerate(values.T):
        steps = np.diff(np.unique(column[:20_000]))
        out[k] = steps.min() if len(steps) else 0.0
    return out


def _tilts(means: Floats, noise: Floats) -> bool:
    """Tell whether gravity is another one in the second half of a rest, from means of blocks."""
    half = len(means) // 2
    if not (half and means.shape[1]):
        return False
    step = np.abs(means[:half].mean(axis=0) - means[-half:].mean(axis=0))
    return bool(
        (step > np.maximum(MEANS * noise * (2 / half) ** 0.5, LARGEST_TILT * GRAVITY)).any()
    )


def _rest(track: Track, first: int, stop: int) -> Rest:
    seconds = track.seconds[[first, stop - 1]]
    gravity = np.full(3, np.nan)
    if track.accelerations is not None:
        gravity = track.accelerations[first:stop].mean(axis=0)
    rate = track.rates[first:stop].mean(axis=0)
    return Rest(first, stop, float(seconds.mean()), float(np.ptp(seconds)), rate, gravity)


def _of_one_rate(rests: list[Rest]) -> tuple[list[Rest], list[float]]:
    """Return the rests without those that turn about the vertical, and the times of these."""
    if not rests:
        return [], []
    rates = np.array([rest.rate for rest in rests])
    off = np.abs(rates - np.median(rates, axis=0))
    limit = np.maximum(LARGEST_BIAS_STEP, 10.0 * np.median(off, axis=0))
    turning = (off > limit).any(axis=1)
    kept = [rest for rest, turns in zip(rests, turning, strict=True) if not turns]
    return kept, [rest.time for rest, turns in zip(rests, turning, strict=True) if turns]
