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

"""How good: every candidate on the same simulated motion with truth, one table.

    python -m benchmark.quality [--rate HZ] [--noise RAD_PER_S] [--kind KIND] [--seed N] [--check]

A ratio of 1.00 means no better and no worse than the raw signal. What the columns say stands in
`LEGEND`; the limits that the default method is held to stand in `bars.json`.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmark.candidates import CANDIDATES, Candidate, Filtered, Recording
from benchmark.figures import rms, tell_misses
from benchmark.scenarios import (
    Trial,
    add_outliers,
    bridge,
    bursty_stamps,
    motion,
    noise,
    stamps,
)
from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.gravity import GRAVITY

# Limits of the median, where there is one, and of the worst.
Bar = tuple[float | None, float]


def read_bars(file: str) -> dict[str, Bar]:
    """Return the bars by name, of a file beside this one."""
    bars = json.loads(Path(__file__).with_name(file).read_text())
    return {name: (median, worst) for name, (median, worst) in bars.items()}


BARS = read_bars('bars.json')
# At 50 Hz the same seconds hold half the samples, so that the mean of a rest is less certain.
_BARS_AT_50_HZ: dict[str, Bar] = {'slow.rmse': (None, 0.42), 'motion.rest': (None, 0.25)}
LEGEND = """\
static      std(filtered) / std(raw) of a motionless gyroscope, after 20 s
bursty      the same with the stamps of a driver that delivers in bursts
slow        rms error / that of the raw rates in slow turns of 2, 1 and 0.5 deg/s; gain: the share
            of the turn that comes through
motion      rms error / that of the raw rates, rests and motion; rest, move: the samples of each
spikes      the same trials with outliers: rms error / that of someone who is told which samples are
            outliers and bridges them
caught      share of spikes and bursts that were flagged, in all and at rest
flags       share of samples flagged that are none, at rest and in motion
nis         normalised innovation squared, which should be 1: worst axis, at rest and in motion
"""
SETTLED = 20.0  # s
_SECONDS = 120.0


@dataclass(frozen=True)
class World:
    """The data of one benchmark: a sensor and what it goes through."""

    sample_rate: float
    deviation: float
    noise: Floats
    trials: list[Trial]
    seed: int


def make_world(sample_rate: float, deviation: float, kind: str, seed: int) -> World:
    """Return a world.

    Args:
        sample_rate: In Hz.
        deviation: Standard deviation of the noise, in rad/s.
        kind: Of the noise, see `benchmark.scenarios.noise`.
        seed: Of all random numbers.
    """
    random = np.random.default_rng(seed)
    n = round(_SECONDS * sample_rate)
    return World(
        sample_rate,
        deviation,
        noise(2 * n, sample_rate, deviation, kind, random),
        [motion(_SECONDS, sample_rate, random, speed) for speed in (1.0, 0.5, 1.5, 1.0)],
        seed,
    )


class Scored:
    """Run a candidate on the worlds' recordings and collect its figures by name."""

    def __init__(self, candidate: Candidate, world: World) -> None:
        self._candidate = candidate
        self._world = world
        self.figures: dict[str, list[float]] = {}

    def _add(self, name: str, value: float | None) -> None:
        if value is not None:
            self.figures.setdefault(name, []).append(value)

    def _filter(
        self,
        rates: Floats,
        acceleration: Floats | None = None,
        times: Integers | None = None,
    ) -> Filtered:
        n, world = len(rates), self._world
        if acceleration is None:
            acceleration = np.tile([0.0, 0.0, GRAVITY], (n, 1))
        if times is None:
            times = stamps(n, world.sample_rate)
        return self._candidate(
            Recording(times, rates, acceleration, world.sample_rate, world.deviation)
        )

    def static(self) -> None:
        """Score a motionless recording, even and in bursts."""
        world = self._world
        random = np.random.default_rng([world.seed, 1])
        n = len(world.noise) // 2
        raw = world.noise[:n] + world.deviation * random.normal(0.0, 3.0, 3)
        late = np.arange(n) >= SETTLED * world.sample_rate
        times = {'static': None, 'bursty': bursty_stamps(n, world.sample_rate, random)}
        for name, stamps_ in times.items():
            out = self._filter(raw, times=stamps_)
            ratio = out.rates[late].std(axis=0) / raw[late].std(axis=0)
            self._add(f'{name}.std', float(ratio.mean()))
            if name == 'static':
                still = (np.diff(out.rates, axis=0) == 0).all(axis=1)
                self._add('static.frozen', float(still.mean()))
                self._add('static.flags', _share(out.flags, late))
                self._add('static.nis', _worst_nis(out.normalised, late))

    def slow(self) -> None:
        """Score turns about the vertical that no dead band may swallow."""
        world = self._world
        n = len(world.noise) // 2
        time = np.arange(n) / world.sample_rate
        sine = np.sin(2 * np.pi * 0.1 * (time - 20.0))
        turns = [(size, sine, time >= 20.0) for size in (2.0, 1.0, 0.5)]
        # A body does not turn all at once.
        begins = np.clip((time - 20.0) / 0.1, 0.0, 1.0)
        turns.append((0.5, begins, (time >= 20.0) & (time < 50.0)))
        raw_noise = world.noise[:n]
        for degrees, shape, on in turns:
            truth = np.zeros((n, 3))
            truth[:, 2] = np.radians(degrees) * shape * on
            out = self._filter(truth + raw_noise).rates[on, 2]
            true, raw = truth[on, 2], (truth + raw_noise)[on, 2]
            self._add('slow.rmse', rms(out - true) / rms(raw - true))
            self._add('slow.gain', float(np.dot(out, true) / np.dot(raw, true)))

    def motion(self) -> None:
        """Rests and motion, from rest and from mid-motion; then with outliers."""
        world = self._world
        for number, whole in enumerate(world.trials):
            moving = int(np.flatnonzero(~whole.rest)[0] + 1.5 * world.sample_rate)
            for begin in (0, moving):
                trial = whole.since(begin)
                random = np.random.default_rng([world.seed, number, begin])
                n = len(trial.truth)
                first = random.integers(0, len(world.noise) - n)
                raw_noise = world.noise[first : first + n]
                self._in_motion(trial, raw_noise)
                if begin == 0:
                    self._with_outliers(trial, raw_noise, random)

    def _in_motion(self, trial: Trial, raw_noise: Floats) -> None:
        rest = trial.rest
        out = self._filter(trial.truth + raw_noise, trial.acceleration)
        error = out.rates - trial.truth
        late = np.arange(len(error)) > 5.0 * self._world.sample_rate
        self._add('motion.rmse', rms(error) / rms(raw_noise))
        self._add('motion.rest', rms(error[rest]) / rms(raw_noise[rest]))
        self._add('motion.move', rms(error[~rest]) / rms(raw_noise[~rest]))
        self._add('motion.flags', _share(out.flags, ~rest))
        self._add('motion.nis_rest', _worst_nis(out.normalised, rest & late))
        self._add('motion.nis_move', _worst_nis(out.normalised, ~rest))

    def _with_outliers(self, trial: Trial, raw_noise: Floats, random: np.random.Generator) -> None:
        truth = trial.truth
        raw, mask = add_outliers(truth + raw_noise, random)
        out = self._filter(raw, trial.acceleration)
        oracle = bridge(truth + raw_noise, mask) - truth
        self._add('spikes.ratio', rms(out.rates - truth) / rms(oracle))
        spike = mask & (raw != 0)
        if out.flags is not None:
            self._add('spikes.caught', float(out.flags[spike].mean()))
            self._add('spikes.caught_rest', float(out.flags[spike & trial.rest[:, None]].mean()))


def _share(flags: Bools | None, where: Bools) -> float | None:
    return None if flags is None else float(flags[where].any(axis=1).mean())


def _worst_nis(normalised: Floats | None, where: Bools) -> float | None:
    if normalised is None:
        return None
    mean = np.maximum(normalised[where].mean(axis=0), 1e-9)
    return float(mean[np.argmax(np.abs(np.log(mean)))])


def score(candidate: Candidate, world: World) -> dict[str, list[float]]:
    """Return the figures of a candidate: one value per recording, by name as in `bars.json`."""
    scored = Scored(candidate, world)
    scored.static()
    scored.slow()
    scored.motion()
    return scored.figures


def larger_is_better(name: str) -> bool:
    """Return whether a figure is a share of what should come through or be caught."""
    return name.endswith(('gain', 'caught', 'caught_rest'))


def worst(name: str, values: list[float]) -> float:
    """Return the worst of a figure's values: the smallest share caught, the NIS furthest from 1."""
    if larger_is_better(name):
        return min(values)
    if '.nis' in name:
        return max(values, key=lambda value: abs(np.log(max(value, 1e-9))))
    return max(values)


def bars_at(rate: float) -> dict[str, Bar]:
    """Return the bars for a sample rate in Hz."""
    return BARS | _BARS_AT_50_HZ if rate <= 50.0 else BARS


def falls_short(figures: dict[str, list[float]], bars: Mapping[str, Bar]) -> Iterator[str]:
    """Yield a line for each bar that does not hold."""
    for name, (median_bar, worst_bar) in bars.items():
        median_, worst_ = float(np.median(figures[name])), worst(name, figures[name])
        if '.nis' in name:
            holds = 1 / worst_bar <= worst_ <= worst_bar
        elif larger_is_better(name):
            holds = worst_ >= worst_bar
        else:
            holds = worst_ <= worst_bar and (median_bar is None or median_ <= median_bar)
        if not holds:
            bar = f'bar {median_bar} / {worst_bar}'
            yield f'{name}: median {median_:.3f}, worst {worst_:.3f}, {bar}'


COLUMNS = (
    ('static', 'static.std'),
    ('bursty', 'bursty.std'),
    ('slow', 'slow.rmse'),
    ('gain', 'slow.gain'),
    ('motion', 'motion.rmse'),
    ('rest', 'motion.rest'),
    ('move', 'motion.move'),
    ('spikes', 'spikes.ratio'),
    ('caught', 'spikes.caught'),
    ('at rest', 'spikes.caught_rest'),
    ('flags rest', 'static.flags'),
    ('flags move', 'motion.flags'),
    ('nis rest', 'motion.nis_rest'),
    ('nis move', 'motion.nis_move'),
)


def main() -> int:
    """Print the table; return 1 where the default method misses a bar and `--check` is given."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--rate', type=float, default=100.0, help='Hz, default %(default)s')
    parser.add_argument('--noise', type=float, default=0.005, help='rad/s, default %(default)s')
    parser.add_argument('--kind', default='autoregressive', help='of noise, default %(default)s')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--only', nargs='*', choices=CANDIDATES, default=list(CANDIDATES))
    parser.add_argument('--check', action='store_true', help='fail where a bar does not hold')
    options = parser.parse_args()
    world = make_world(options.rate, options.noise, options.kind, options.seed)
    rows = [['worst of all', *(title for title, _ in COLUMNS)]]
    short: list[str] = []
    for name in options.only:
        tell(f'scoring {name} ...')
        figures = score(CANDIDATES[name], world)
        rows.append(
            [name]
            + [f'{worst(key, figures[key]):.3g}' if key in figures else '-' for _, key in COLUMNS]
        )
        if name == 'adaptive':
            short = list(falls_short(figures, bars_at(options.rate)))
    print(f'{options.rate:g} Hz, {options.kind} noise of {options.noise:g} rad/s\n')
    print(table(rows), end='\n\n')
    print(LEGEND)
    return tell_misses(short, check=options.check)


if __name__ == '__main__':
    sys.exit(main())
