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

"""How much of a slow turn is learned as bias, and how soon a bias that moves is followed.

    python -m benchmark.bias [--seeds N] [--rate HZ]

Simulated: noise of deviation 0.0061 rad/s and correlation 0.167, about that of an ADIS16405 at
100 Hz, gravity with 0.02 m/s^2 of noise.
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.rotations import inverse, rotate
from gyro_drift_filter.simulation.experiments import autoregressive
from gyro_drift_filter.simulation.sensor import DEGREE, Faults
from gyro_drift_filter.simulation.turns import lay_down, sides

NOISE, PHI = 6.1e-3, 0.167
SPEEDS = (0.1, 0.2, 0.3, 0.4, 0.5, 1.0, 2.0, 5.0)  # deg/s
REST, TURN = 10, 60  # s
JUMPS = (0.3, 0.5, 1.0, 2.0, 5.0)  # deg/s
AFTER_JUMP = 30  # s
DRIVE, STAND, MOTION = 300, 10, 20  # s
WARM_UPS, WARMING_SECONDS = (0.5, 1.0, 2.0, 4.0), 240.0  # deg/s, s
# Then fast, the share of the sector that is left at first, and whether it goes on round.
SCANS = (('back', 1.0, False), ('back, from the middle on', 0.5, False), ('on round', 1.0, True))
STOPS, STOP_WARM_UP = (1.0, 1.5, 2.0, 3.0, 5.0), 1.0  # s, deg/s
VIBRATION, PUSH = 0.01, 0.4  # rad/s, m/s^2
HUM, HUM_RATES, HUM_FORCES = 37.3, (0.03, 0.015, 0.021), (0.18, 0.6, 0.24)  # Hz, rad/s, m/s^2
SWINGS, PERIODS = (0.3, 0.5, 1.0), (6, 10, 20, 40)  # deg/s, s
STILL, SWING = 20, 100  # s
ROLLS = ((0.2, 8.0), (0.3, 14.0), (1.0, 30.0))  # deg, s
ROLLED, ROLL_NOISE = 600, 0.25  # s, of NOISE
TILTS, RAMPS, PAUSES = (0.1, 0.2, 0.3), (10.0, 40.0), (1.0, 5.0)  # deg/s, s, s
TILTED, LARGEST_TILT, LOUD = 600, 20.0, 0.1  # s, deg, m/s^2
EARLY_RATES, EARLY_STANDS = (10.0, 20.0, 30.0, 100.0), (3.0, 5.0, 10.0)  # Hz, s
EARLY_BIAS, EARLY_SPEED, EARLY_TURNS = 0.5, 1.5, 8  # deg/s, deg/s
EARLY_TURN, EARLY_PAUSE = 30.0, 10.0  # s
WARM_UP, CYCLE, PAUSE = 600, 60, 3  # s
ROCKED, HINT_EVERY = 30, 0.5  # s
SENSITIVITIES = (0.0, 0.05, 0.1, 0.2)  # deg/s per g
LAID, WAY = 8.0, 6.0  # s
START = 10**18
TURNS = {
    'vertical': {'upright': True, 'silent': False},
    'horizontal': {'upright': False, 'silent': False},
    'horizontal, gyroscope alone': {'upright': False, 'silent': True},
}


def at_rest(random: np.random.Generator, seconds: float, rate: float) -> tuple[Floats, Floats]:
    """Return rates and accelerations (n, 3) of a motionless sensor."""
    n = round(seconds * rate)
    accelerations = 0.02 * random.standard_normal((n, 3))
    accelerations[:, 2] += GRAVITY
    return autoregressive(random, n, PHI, NOISE * np.sqrt(1 - PHI**2)), accelerations


def _biases(
    rates: Floats,
    accelerations: Floats,
    rate: float,
    *,
    silent: bool = False,
    drives: Bools | None = None,
) -> Floats:
    """Return the biases (n, 3); the robot says that it `drives` (n,) or stands, if it does."""
    stamps = START + np.round(np.arange(len(rates)) * 1e9 / rate).astype(np.int64)
    if silent:
        accelerations = np.full_like(accelerations, np.nan)
    filter_, size = Filter(Parameters()), len(rates)
    if drives is not None:
        size = round(HINT_EVERY * rate)
    biases = []
    for first in range(0, len(rates), size):
        if drives is not None:
            filter_.hint(bool(drives[first]))
        part = slice(first, first + size)
        biases.append(filter_.run(stamps[part], rates[part], accelerations[part])['bias'])
    return np.concatenate(biases)


def _roll(accelerations: Floats, angle: Floats) -> None:
    """Turn gravity by angles (n,) in rad about x, in accelerations (n, 3) of an upright body."""
    accelerations[:, 1] += GRAVITY * np.sin(angle)
    accelerations[:, 2] += GRAVITY * (np.cos(angle) - 1.0)


def slow_turn(
    random: np.random.Generator, speed: float, rate: float, *, upright: bool, silent: bool
) -> tuple[float, float]:
    """Return the bias of the axis before and at the end of a turn of `speed` deg/s, in deg/s.

    The true one is zero.

    About the vertical or, not `upright`, a horizontal axis; `silent` without an accelerometer.
    """
    rates, accelerations = at_rest(random, REST + TURN, rate)
    begin, axis = round(REST * rate), 2 if upright else 0
    rates[begin:, axis] += speed * DEGREE
    if not upright:
        time = np.arange(len(rates) - begin) / rate
        _roll(accelerations[begin:], speed * DEGREE * time)
    bias = _biases(rates, accelerations, rate, silent=silent)[:, axis]
    return float(bias[begin - 1]) / DEGREE, float(bias[-1]) / DEGREE


def jump(random: np.random.Generator, size: float, rate: float) -> float:
    """Return after how many s a bias that jumps by `size` deg/s at rest is known; infinite if not.

    It jumps in any direction, and is known where three quarters of the jump are.
    """
    rates, accelerations = at_rest(random, REST + AFTER_JUMP, rate)
    begin, direction = round(REST * rate), random.standard_normal(3)
    step = size * DEGREE * direction / np.linalg.norm(direction)
    rates[begin:] += step
    bias = _biases(rates, accelerations, rate)[begin:]
    unknown = np.flatnonzero(np.linalg.norm(bias - step, axis=1) > 0.25 * size * DEGREE)
    return float(unknown[-1] + 1) / rate if unknown[-1] < len(bias) - 1 else np.inf


def to_and_fro(
    random: np.random.Generator, speed: float, period: float, rate: float
) -> tuple[float, float]:
    """Return how far the bias has changed at most, in deg/s, and the angle lost, in deg.

    In a turn about the vertical to and fro, of `speed` deg/s and `period` s, after a rest.
    """
    rates, accelerations = at_rest(random, STILL + SWING, rate)
    begin = round(STILL * rate)
    time = np.arange(len(rates) - begin) / rate
    rates[begin:, 2] += speed * DEGREE * np.sin(2.0 * np.pi * time / period)
    bias = _biases(rates, accelerations, rate)[:, 2] / DEGREE
    changed = np.abs(bias[begin:] - bias[begin - 1])
    return float(changed.max()), float(np.abs(np.cumsum(bias[begin:])).max() / rate)


def rolled(random: np.random.Generator, size: float, period: float, rate: float) -> float:
    """Return the angle that is lost by the bias, in deg, by a body that rolls to and fro by `size`.

    That is in deg, within `period` s, as a boat does at its mooring, after a rest. Its sensor is
    quieter than in the other trials.
    """
    rates, accelerations = at_rest(random, STILL + ROLLED, rate)
    begin = round(STILL * rate)
    time = np.arange(len(rates) - begin) / rate
    angle = size * DEGREE * np.sin(2.0 * np.pi * time / period)
    rates *= ROLL_NOISE
    rates[begin:, 0] += np.gradient(angle, 1.0 / rate)
    _roll(accelerations[begin:], angle)
    return _largest_angle(_biases(rates, accelerations, rate)[begin:, 0], rate)


def tilting(
    random: np.random.Generator, speed: float, rate: float, *, loud: bool
) -> tuple[Floats, Floats]:
    """Return rates and accelerations (n, 3) of a body that tilts to and fro at `speed` deg/s.

    It does so after a rest, for 10 to 40 s each time, and stops for 1 to 5 s in between, as a slow
    arm or a platform does. Its gyroscope is quieter than in the other trials, and its accelerometer
    is five times as noisy if it is `loud`.
    """
    rates, accelerations = at_rest(random, STILL + TILTED, rate)
    parts, tilt = [np.zeros(round(STILL * rate))], 0.0
    while sum(map(len, parts)) < len(rates):
        seconds = random.uniform(*RAMPS)
        way = -np.sign(tilt) if abs(tilt) > LARGEST_TILT else random.choice([-1.0, 1.0])
        tilt += way * speed * seconds
        parts.append(np.full(round(seconds * rate), way * speed * DEGREE))
        parts.append(np.zeros(round(random.uniform(*PAUSES) * rate)))
    about_x = np.concatenate(parts)[: len(rates)]
    rates *= ROLL_NOISE
    rates[:, 0] += about_x
    _roll(accelerations, np.cumsum(about_x) / rate)
    if loud:
        accelerations += LOUD * random.standard_normal(accelerations.shape)
    return rates, accelerations


def tilted(random: np.random.Generator, speed: float, rate: float, *, loud: bool) -> float:
    """Return the angle that is lost by the bias, in deg, by such a body."""
    biases = _biases(*tilting(random, speed, rate, loud=loud), rate)
    return _largest_angle(biases[round(STILL * rate) :, 0], rate)


def turning_early(random: np.random.Generator, stands: float, rate: float) -> float:
    """Return the heading in deg that the bias of a robot loses which turns soon after power-on.

    It `stands` for so many s, and then turns either way for 30 s and pauses for 10 s in turns.
    """
    cycle = EARLY_TURN + EARLY_PAUSE
    rates, accelerations = at_rest(random, stands + EARLY_TURNS * cycle, rate)
    time = np.arange(len(rates)) / rate - stands
    ways = random.choice([-1.0, 1.0], EARLY_TURNS)[np.maximum(time, 0.0).astype(int) // int(cycle)]
    turns = (time >= 0.0) & (time % cycle < EARLY_TURN)
    rates[:, 2] += EARLY_BIAS * DEGREE + np.where(turns, EARLY_SPEED * DEGREE * ways, 0.0)
    errors = _biases(rates, accelerations, rate)[:, 2] - EARLY_BIAS * DEGREE
    return _largest_angle(errors[round(stands * rate) :], rate)


def jump_in_stand(random: np.random.Generator, size: float, rate: float) -> float:
    """Return the heading that is lost in deg, of a bias that jumps by `size` deg/s.

    About the vertical, while a robot stands that drives and stands in turns.
    """
    time = np.arange(round(DRIVE * rate)) / rate
    jumped = time >= 2 * (STAND + MOTION) + 0.5 * STAND
    return _lost_in_stands(random, np.where(jumped, size * DEGREE, 0.0), rate)


def warm_up_in_stands(random: np.random.Generator, size: float, rate: float) -> float:
    """Return the heading that is lost in deg, of a bias that warms up by `size` deg/s.

    About the vertical, in a robot that drives and stands in turns.
    """
    return _lost_in_stands(random, _warming(size, rate), rate)


def warm_up_in_stops(random: np.random.Generator, stop: float, rate: float, *, hums: bool) -> float:
    """Return the same of a robot on wheels that stops for `stop` s each.

    They vibrate as it drives. It stands for 10 s at first. Then a machine is switched on, if it
    `hums`, and stays on.
    """
    truth = _warming(STOP_WARM_UP, rate)
    return _lost_in_stands(random, truth, rate, stand=stop, vibrates=True, hums=hums)


def _warming(size: float, rate: float) -> Floats:
    """Return a bias (n,) in rad/s that warms up by `size` deg/s."""
    time = np.arange(round(DRIVE * rate)) / rate
    return size * DEGREE * (1.0 - np.exp(-time / WARMING_SECONDS))


def _lost_in_stands(
    random: np.random.Generator,
    truth: Floats,
    rate: float,
    *,
    stand: float = STAND,
    vibrates: bool = False,
    hums: bool = False,
) -> float:
    """Return the heading that is lost in deg, with a bias (n,) in rad/s about the vertical.

    The robot stands for 10 s, and then drives and stands in turns, for `stand` s each time: smooth
    noise of 0.3 rad/s and 0.3 m/s^2, and white noise as well where it vibrates. If it `hums`, a
    machine does so from the end of the first stand on.
    """
    rates, accelerations = at_rest(random, DRIVE, rate)
    time = np.arange(len(rates)) / rate
    since = (time - STAND + stand) % (stand + MOTION) - stand
    window = np.clip(np.minimum(since, MOTION - since) / 0.5, 0.0, 1.0)
    window[: round(STAND * rate)] = 0.0
    motion = 0.3 * window[:, None] * _smooth(random, len(rates), rate)
    if vibrates:
        shaken = window[:, None] > 0.0
        rates += VIBRATION * shaken * random.standard_normal(rates.shape)
        accelerations += PUSH * shaken * random.standard_normal(rates.shape)
    if hums:
        tone = ((time > STAND) * np.sin(2.0 * np.pi * HUM * time))[:, None]
        rates += tone * HUM_RATES
        accelerations += tone * HUM_FORCES
    rates[:, 2] += truth
    biases = _biases(rates + motion, accelerations + motion, rate)
    return _largest_angle(biases[:, 2] - truth, rate)


def _largest_angle(errors: Floats, rate: float) -> float:
    """Return the largest angle in deg that errors (n,) of a bias in rad/s add up to."""
    return float(np.abs(np.cumsum(errors)).max() / rate / DEGREE)


def warm_up_in_rocked_stands(random: np.random.Generator, rate: float, *, hinted: bool) -> float:
    """Return the same of a robot that rocks at 1 Hz while it stands, for 30 s each time.

    As on soft tires: 0.02 rad/s and 0.1 m/s^2. It says that it stands where `hinted`.
    """
    rates, accelerations = at_rest(random, DRIVE, rate)
    time, truth = np.arange(len(rates)) / rate, _warming(STOP_WARM_UP, rate)
    drives = (time >= STAND) & ((time - STAND) % (MOTION + ROCKED) < MOTION)
    wave = np.sin(2.0 * np.pi * time)[:, None] * ((time >= STAND) & ~drives)[:, None]
    motion = 0.3 * drives[:, None] * _smooth(random, len(rates), rate)
    rates += motion + 0.02 * wave * [1.0, 0.6, 0.3]
    accelerations += motion + 0.1 * wave * [0.6, 1.0, 0.0]
    rates[:, 2] += truth
    bias = _biases(rates, accelerations, rate, drives=drives if hinted else None)[:, 2]
    return _largest_angle(bias - truth, rate)


def slow_turns_in_drives(random: np.random.Generator, rate: float, *, steady: bool) -> float:
    """Return the heading that is lost in deg, of a robot that turns slowly between fast turns.

    About the vertical and one way, for 6 to 20 s each at 0.3 to 2 deg/s: each time as fast where
    `steady`. After each four of them it stands. The true bias is zero.
    """
    rates, accelerations = at_rest(random, 2 * DRIVE, rate)
    begin, turns, speed = float(REST), 0, random.uniform(0.3, 2.0)
    while begin < 2 * DRIVE:
        end = begin + random.uniform(6.0, 20.0)
        rates[round(begin * rate) : round(end * rate), 2] += speed * DEGREE
        fast = rates[round(end * rate) : round((end + 5.0) * rate), 2]
        fast += random.choice([-0.8, 0.8]) * np.hanning(round(5.0 * rate))[: len(fast)]
        begin, turns = end + 5.0, turns + 1
        if not steady:
            speed = random.uniform(0.3, 2.0)
        if turns % 4 == 0:
            begin += random.uniform(5.0, 12.0)
    return _largest_angle(_biases(rates, accelerations, rate)[:, 2], rate)


def scan(random: np.random.Generator, left: float, rate: float, *, on: bool) -> float:
    """Return the heading that is lost in deg, of a head that scans a sector slowly again and again.

    It begins where a share of the sector is `left`. Fast, it turns back, or goes `on` round.
    """
    rates, accelerations = at_rest(random, 2 * DRIVE, rate)
    sector, slow, fast = random.uniform(90, 240), random.uniform(3, 8), random.uniform(20, 60)
    turns = scanning(sector * DEGREE, slow * DEGREE, (fast if on else -fast) * DEGREE, rate)
    first = round(REST * rate)
    begin = round((1.0 - left) * sector / slow * rate)
    rates[first:, 2] += np.resize(np.roll(turns, -begin), len(rates) - first)
    return _largest_angle(_biases(rates, accelerations, rate)[:, 2], rate)


def scanning(sector: float, slow: float, fast: float, rate: float) -> Floats:
    """Return one scan in rad/s, of a sector in rad at a `slow` rate; then `fast` back, or round."""
    way = 2.0 * np.pi - sector if fast > 0.0 else -sector
    lengths = round(sector / slow * rate), round(way / fast * rate)
    return np.repeat([slow, fast], lengths)


def _smooth(random: np.random.Generator, n: int, rate: float) -> Floats:
    """Return smooth noise (n, 3) of deviation 1."""
    smooth = np.cumsum(random.standard_normal((n, 3)), axis=0)
    width = round(5 * rate)
    smooth[width:] -= smooth[:-width].copy()
    return np.asarray(smooth / smooth.std())


def on_other_sides(
    random: np.random.Generator, sensitivity: float, rate: float
) -> tuple[float, float]:
    """Return the error of the bias at rest in deg/s, root mean square, and the angle lost in deg.

    Of a sensor that is laid down on 24 sides, and feels gravity by `sensitivity` deg/s per g from
    each axis to each other one. The error is that at the end of each rest.
    """
    poses = sides(random) + sides(random)
    laid = lay_down(random, poses, Faults(np.zeros(3)), rest=LAID, way=WAY, rate=rate)
    felt = sensitivity * DEGREE / GRAVITY * random.standard_normal((3, 3))
    truth = rotate(inverse(laid.orientations), np.array([0.0, 0.0, GRAVITY])) @ felt.T
    given = laid.rates + laid.accelerations @ felt.T
    errors = Filter(Parameters()).run(laid.stamps, given, laid.accelerations)['bias'] - truth
    ends = np.round((LAID + (LAID + WAY) * np.arange(len(poses))) * rate).astype(int) - 1
    lost = np.linalg.norm(errors.sum(axis=0)) / rate
    return float(np.sqrt(np.mean(np.square(errors[ends])))) / DEGREE, float(lost) / DEGREE


def warm_up(random: np.random.Generator, rate: float) -> Floats:
    """Return the errors in deg/s after each rest, (rests, 3), of a bias that moves 1 deg/s.

    Between the rests it moves: smooth noise of 0.3 rad/s and 0.3 m/s^2.
    """
    rates, accelerations = at_rest(random, WARM_UP, rate)
    time = np.arange(len(rates)) / rate
    truth = DEGREE * time / WARM_UP
    since = (time + CYCLE - PAUSE) % CYCLE  # the recording begins with a rest
    rests = since >= CYCLE - PAUSE
    window = np.clip(np.minimum(since, CYCLE - PAUSE - since) / 0.5, 0.0, 1.0)
    motion = 0.3 * (window * ~rests)[:, None] * _smooth(random, len(rates), rate)
    bias = _biases(rates + truth[:, None] + motion, accelerations + motion, rate)
    ends = np.flatnonzero(rests[:-1] & ~rests[1:]) + round(0.5 * rate)
    return np.asarray(bias[ends] - truth[ends, None]) / DEGREE


def warm_up_standing(random: np.random.Generator, rate: float) -> tuple[Floats, Floats]:
    """Return the errors in deg/s, (n, 3), of a sensor that stands all the time.

    First while its bias is steady, the first minute left out, then while it moves 1 deg/s.
    """
    rates, accelerations = at_rest(random, 2 * WARM_UP, rate)
    begin = round(WARM_UP * rate)
    truth = DEGREE * np.maximum(np.arange(len(rates)) - begin, 0) / begin
    bias = _biases(rates + truth[:, None], accelerations, rate)
    errors = (bias - truth[:, None]) / DEGREE
    return errors[round(CYCLE * rate) : begin], errors[begin:]


Rows = Iterator[Sequence[str]]
TABLES: list[tuple[str, Sequence[str], Callable[['Trials'], Rows]]] = []


@dataclass(frozen=True)
class Trials:
    """The same world once for each seed, with samples at a rate in Hz."""

    seeds: int
    rate: float

    def each(self, world: Callable[..., Any], *arguments: float, **flags: bool) -> Iterator[Any]:
        """Yield what a world gives for each seed."""
        for seed in range(self.seeds):
            yield world(np.random.default_rng(seed), *arguments, self.rate, **flags)

    def results(self, world: Callable[..., Any], *arguments: float, **flags: bool) -> Floats:
        """Return what it gives, with a column for each figure where there are several."""
        return np.array(list(self.each(world, *arguments, **flags)))

    def lost(self, world: Callable[..., float], *arguments: float, **flags: bool) -> str:
        """Return the median and the worst of one figure as text."""
        return _median_and_worst(self.results(world, *arguments, **flags))


def _median_and_worst(values: Floats, decimals: int = 1) -> str:
    return f'{np.median(values):.{decimals}f}  {values.max():.{decimals}f}'


def _table(title: str, head: Sequence[str]) -> Callable[[Callable[[Trials], Rows]], None]:
    """List what yields the rows of a table in `TABLES`, with its title and head."""
    return lambda rows: TABLES.append((title, head, rows))


@cache
def _biases_in_turns(trials: Trials) -> dict[float, list[Floats]]:
    """Return the biases before and at the end of a turn, (seeds, 2) for each of `TURNS`."""
    found = {}
    for speed in SPEEDS:
        tell(f'turning at {speed:g} deg/s ...')
        found[speed] = [trials.results(slow_turn, speed, **turn) for turn in TURNS.values()]
    return found


@_table(
    f'by what share of a turn of {TURN} s after {REST} s of rest the bias has changed',
    ['deg/s', *(f'{name}: median  worst' for name in TURNS)],
)
def _changes(trials: Trials) -> Rows:
    for speed, of_turns in _biases_in_turns(trials).items():
        shares = (np.abs(biases[:, 1] - biases[:, 0]) / speed for biases in of_turns)
        yield [f'{speed:g}', *(_median_and_worst(share, 3) for share in shares)]


@_table(
    'error of the bias before the turn and after it, root mean square, deg/s',
    ['deg/s', *(f'{name}: before  after' for name in TURNS)],
)
def _errors(trials: Trials) -> Rows:
    for speed, of_turns in _biases_in_turns(trials).items():
        errors = (np.sqrt(np.mean(np.square(biases), axis=0)) for biases in of_turns)
        yield [f'{speed:g}', *(f'{before:.4f}  {after:.4f}' for before, after in errors)]


@_table(
    f'how far a turn of {SWING} s to and fro after {STILL} s of rest moves the bias at most, '
    'and the\nheading that is lost by the bias, median and worst',
    ['deg/s', 'period (s)', 'bias (deg/s)', 'heading (deg)'],
)
def _swings(trials: Trials) -> Rows:
    for speed, period in product(SWINGS, PERIODS):
        tell(f'turning to and fro at {speed:g} deg/s within {period} s ...')
        moved, lost = trials.results(to_and_fro, speed, period).T
        yield [f'{speed:g}', f'{period}', _median_and_worst(moved, 3), _median_and_worst(lost)]


@_table(
    f'angle that is lost by the bias of a body that rolls for {ROLLED} s after {STILL} s of '
    'rest,\nmedian and worst',
    ['deg', 'period (s)', 'lost (deg)'],
)
def _rolls(trials: Trials) -> Rows:
    for size, period in ROLLS:
        tell(f'rolling to and fro by {size:g} deg within {period:g} s ...')
        yield [f'{size:g}', f'{period:g}', trials.lost(rolled, size, period)]


@_table(
    f'angle that is lost by the bias of a body that tilts and stops in turns for {TILTED} s '
    f'after {STILL} s\nof rest, median and worst',
    ['deg/s', 'lost (deg)', 'noisy accelerometer (deg)'],
)
def _tilts(trials: Trials) -> Rows:
    for speed in TILTS:
        tell(f'tilting to and fro at {speed:g} deg/s ...')
        lost = (trials.lost(tilted, speed, loud=loud) for loud in (False, True))
        yield [f'{speed:g}', *lost]


@_table(
    f'after how long at rest a bias is known that jumps in any direction, up to {AFTER_JUMP} s',
    ['deg/s', 'median (s)', 'known in'],
)
def _jumps_at_rest(trials: Trials) -> Rows:
    for size in JUMPS:
        tell(f'jumping by {size:g} deg/s ...')
        after = trials.results(jump, size)
        known = np.mean(np.isfinite(after))
        yield [f'{size:g}', f'{np.median(after):.1f}', f'{100 * known:.0f} %']


@_table(
    'the heading that is lost, median and worst, where a bias jumps about the vertical, while '
    f'a\nrobot stands, within {DRIVE} s of stands of {STAND} s and {MOTION} s of motion',
    ['deg/s', 'heading (deg)'],
)
def _jumps_in_stands(trials: Trials) -> Rows:
    for size in JUMPS:
        tell(f'jumping by {size:g} deg/s between drives ...')
        yield [f'{size:g}', trials.lost(jump_in_stand, size)]


@_table(
    f'the same where the bias warms up, with a time constant of {WARMING_SECONDS:g} s',
    ['deg/s', 'heading (deg)'],
)
def _warm_ups_in_stands(trials: Trials) -> Rows:
    for size in WARM_UPS:
        tell(f'warming up by {size:g} deg/s between drives ...')
        yield [f'{size:g}', trials.lost(warm_up_in_stands, size)]


@_table(
    f'the same where it warms up by {STOP_WARM_UP:g} deg/s, and the robot vibrates as it '
    'drives, and stops for so long;\nand with a machine that hums from the first stop on',
    ['stop (s)', 'heading (deg)', 'with a machine (deg)'],
)
def _warm_ups_in_stops(trials: Trials) -> Rows:
    for stop in STOPS:
        tell(f'warming up between stops of {stop:g} s ...')
        lost = (trials.lost(warm_up_in_stops, stop, hums=hums) for hums in (False, True))
        yield [f'{stop:g}', *lost]


@_table(
    f'the same where it rocks while it stands, for {ROCKED} s each time',
    ['it says that it stands', 'heading (deg)'],
)
def _warm_ups_in_rocked_stands(trials: Trials) -> Rows:
    for name, hinted in {'no': False, 'yes': True}.items():
        tell(f'warming up in stands in which it rocks, with a hint: {name} ...')
        yield [name, trials.lost(warm_up_in_rocked_stands, hinted=hinted)]


@_table(
    f'the heading that is lost by the bias, median and worst, in {2 * DRIVE} s of slow turns '
    'between fast ones',
    ['slow turns', 'heading (deg)'],
)
def _slow_turns_in_drives(trials: Trials) -> Rows:
    for name, steady in {'all as fast': True, 'of any speed': False}.items():
        tell(f'turning slowly between fast turns, {name} ...')
        yield [name, trials.lost(slow_turns_in_drives, steady=steady)]


@_table(
    f'the heading that is lost by the bias, median and worst, in {2 * DRIVE} s of a head that '
    'scans a sector slowly',
    ['then fast', 'heading (deg)'],
)
def _scans(trials: Trials) -> Rows:
    for name, left, on in SCANS:
        tell(f'scanning slowly, then fast {name} ...')
        yield [name, trials.lost(scan, left, on=on)]


@_table(
    f'a sensor that feels gravity, laid down on 24 sides for {LAID:g} s each: error of the '
    'bias at the end of a\nrest, and the angle that is lost, median and worst',
    ['deg/s per g', 'bias (deg/s)', 'angle (deg)'],
)
def _other_sides(trials: Trials) -> Rows:
    for sensitivity in SENSITIVITIES:
        tell(f'laid down on other sides, with {sensitivity:g} deg/s per g ...')
        error, lost = trials.results(on_other_sides, sensitivity).T
        yield [f'{sensitivity:g}', _median_and_worst(error, 3), _median_and_worst(lost)]


@_table(
    f'heading that is lost by the bias of a robot that stands, and then turns by '
    f'{EARLY_SPEED * EARLY_TURN:g} deg and pauses\nin turns, deg, median and worst',
    ['Hz', *(f'stands for {stands:g} s' for stands in EARLY_STANDS)],
)
def _early_turns(trials: Trials) -> Rows:
    for rate in EARLY_RATES:
        tell(f'turning early at {rate:g} Hz ...')
        at_rate = Trials(trials.seeds, rate)
        lost = (at_rate.lost(turning_early, stands) for stands in EARLY_STANDS)
        yield [f'{rate:g}', *lost]


@_table(
    f'bias that moves 1 deg/s in {WARM_UP} s: after rests of {PAUSE} s every {CYCLE} s, and '
    f'standing\nall the time, after {WARM_UP} s in which it was steady',
    ['error (deg/s)', 'rms', 'worst'],
)
def _warm_ups_at_rest(trials: Trials) -> Rows:
    tell('warming up ...')
    steady, moving = zip(*trials.each(warm_up_standing), strict=True)
    errors_of: dict[str, Any] = {
        'after a rest': trials.results(warm_up),
        'steady': steady,
        'standing': moving,
    }
    for name, errors in errors_of.items():
        rms, worst = np.sqrt(np.mean(np.square(errors))), np.abs(errors).max()
        yield [name, f'{rms:.3f}', f'{worst:.3f}']


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--seeds', type=int, default=100, help='default %(default)s')
    parser.add_argument('--rate', type=float, default=100.0, help='Hz, default %(default)s')
    options = parser.parse_args()
    trials = Trials(options.seeds, options.rate)
    for k, (title, head, rows) in enumerate(TABLES):
        if k > 0:
            print()
        print(f'{title}\n\n{table([head, *rows(trials)])}', flush=True)


if __name__ == '__main__':
    main()
