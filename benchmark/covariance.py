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

"""How honest `angular_velocity_covariance` is, where the truth is known: simulated and real data.

    python -m benchmark.covariance [--data FOLDER] [--seed N]

The table says for each recording in which share of the samples the filtered rate errs by no more
than two published deviations, over all axes; for errors as of the normal distribution that is 95 %.
The last column does the same for the bias alone. FOLDER holds real recordings; this package has
none of them.
"""

import argparse
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmark.drivers import WORLDS
from benchmark.scenarios import motion, noise, stamps
from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.cli.printing import table
from gyro_drift_filter.core import Filter, Parameters

TURN_ON_DEVIATION = Parameters().bias_turn_on_deviation
_SECONDS = 90.0
# Rates in Hz, and noise in rad/s with its kind.
_RATES = (50.0, 100.0, 400.0, 1000.0)
_NOISES = ((5e-3, 'autoregressive'), (1e-3, 'quantised'), (1e-4, 'white'), (0.05, 'white'))
# What is beyond the range is not measured, and no error of the filter.
_WORLDS = [world for world in WORLDS if world not in {'clipped', 'calibrated'}]
_COLUMNS = ('before', 'at rest', 'moving', 'after', 'bias before', 'bias after')


class Recording(NamedTuple):
    """A recording with known truth.

    Attributes:
        name: Of the recording.
        stamps: (n,) in ns.
        rates: (n, 3) as measured, in rad/s.
        acceleration: (n, 3) in m/s^2.
        truth: (n, 3) in rad/s, NaN where the rates themselves are not known well enough.
        rest: (n,), True where the body is at rest.
        bias: (3,) in rad/s, NaN where it is not known.
    """

    name: str
    stamps: Integers
    rates: Floats
    acceleration: Floats
    truth: Floats
    rest: Bools
    bias: Floats

    def part(self, first: int, count: int | None = None) -> 'Recording':
        """Return so many samples from one on, or all that follow it."""
        span = slice(first, None if count is None else first + count)
        return self._replace(
            stamps=self.stamps[span],
            rates=self.rates[span],
            acceleration=self.acceleration[span],
            truth=self.truth[span],
            rest=self.rest[span],
        )

    def from_motion(self, rate: float) -> 'Recording':
        """Return what follows 1.5 s after the begin of the first motion, for a rate in Hz."""
        first = int(np.flatnonzero(~self.rest)[0] + 1.5 * rate)
        return self.part(first)._replace(name='  from mid-motion')

    def with_bias(self, bias: Floats) -> 'Recording':
        """Return the same of a sensor that has this bias (3,) in rad/s."""
        return self._replace(rates=self.rates + (bias - self.bias), bias=bias)


def judge(recording: Recording) -> dict[str, float]:
    """Return the shares of a recording by the names of the columns, NaN where nothing is known.

    Before and after are meant of the first rest that the filter has found.
    """
    result, without = (
        Filter(parameters).run(recording.stamps, recording.rates, recording.acceleration)
        for parameters in (Parameters(), Parameters(bias_enabled=False))
    )
    variance = result['angular_velocity_variance']
    # The rest of it is the same where the bias is left in.
    bias_variance = variance - without['angular_velocity_variance']
    after = np.maximum.accumulate(result['at_rest']) > 0
    inside = _inside(result['angular_velocity'] - recording.truth, variance)
    bias_inside = _inside(result['bias'] - recording.bias, bias_variance)
    return {
        'before': _share(inside[~after]),
        'at rest': _share(inside[after & recording.rest]),
        'moving': _share(inside[after & ~recording.rest]),
        'after': _share(inside[after]),
        'bias before': _share(bias_inside[~after]),
        'bias after': _share(bias_inside[after]),
    }


def _inside(error: Floats, variance: Floats) -> Floats:
    """Return 1 where an error is within two deviations, 0 where not, NaN where it is not known."""
    return np.where(np.isnan(error), np.nan, error * error <= 4.0 * variance)


def _share(inside: Floats) -> float:
    known = inside[~np.isnan(inside)]
    return float(known.mean()) if known.size else np.nan


def simulated(
    rate: float, deviation: float, kind: str, random: np.random.Generator, seconds: float = _SECONDS
) -> Iterator[Recording]:
    """Yield a simulated sensor with a turn-on bias of its own, from rest and from mid-motion on.

    Args:
        rate: In Hz.
        deviation: Standard deviation of the noise in rad/s.
        kind: Of the noise, see `benchmark.scenarios.noise`.
        random: Source of random numbers.
        seconds: Length.
    """
    trial = motion(seconds, rate, random)
    n = len(trial.truth)
    rates = trial.truth + noise(n, rate, deviation, kind, random)
    name = f'{rate:g} Hz, {kind}, {deviation:g} rad/s'
    whole = Recording(
        name, stamps(n, rate), rates, trial.acceleration, trial.truth, trial.rest, np.zeros(3)
    )
    yield whole.with_bias(turn_on_bias(random))
    yield whole.from_motion(rate).with_bias(turn_on_bias(random))


def turn_on_bias(random: np.random.Generator) -> Floats:
    """Return a bias (3,) in rad/s, as a sensor that is switched on may have it."""
    return TURN_ON_DEVIATION * random.standard_normal(3)


def of_drivers(random: np.random.Generator, worlds: Iterable[str] = _WORLDS) -> Iterator[Recording]:
    """Yield worlds of drivers, see `benchmark.drivers`, with a turn-on bias each."""
    for world in worlds:
        found = WORLDS[world](1.0, random)
        data = found.given, found.acceleration, found.truth, found.rest, found.bias
        yield Recording(world, found.stamps, *data).with_bias(turn_on_bias(random))


def motion_by_hand(folder: Path, random: np.random.Generator) -> Iterator[Recording]:
    """Yield real hand motion with the real noise of a motionless sensor, and a turn-on bias.

    The motion is band-limited, so that it is known; what is left of the reference's own noise is a
    hundredth of that which is added.
    """
    source = np.load(folder / 'static' / 'adis16405.npz')['rate'].astype(float)
    source -= source.mean(axis=0)
    for path in sorted((folder / 'motion').glob('*.npz')):
        data = np.load(path)
        truth, rate, n = data['rate'].astype(float), float(data['fs']), len(data['rate'])
        first = random.integers(0, len(source) - n)
        rates, acceleration = truth + source[first : first + n], data['acc'].astype(float)
        rest, bias = data['rest'], np.zeros(3)
        whole = Recording(path.stem, stamps(n, rate), rates, acceleration, truth, rest, bias)
        yield whole.with_bias(turn_on_bias(random))
        yield whole.from_motion(rate).with_bias(turn_on_bias(random))


def motionless(folder: Path) -> Iterator[Recording]:
    """Yield real motionless sensors. The turn of the earth counts as bias."""
    for path in sorted((folder / 'static').glob('*.npz')):
        data = np.load(path)
        rates, n = data['rate'].astype(float), len(data['rate'])
        times, acceleration = stamps(n, float(data['fs'])), data['acc'].astype(float)
        # Their bias wanders, so the rate is known better than it.
        bias, at_rest = np.full(3, np.nan), np.ones(n, bool)
        yield Recording(path.stem, times, rates, acceleration, np.zeros((n, 3)), at_rest, bias)


def tracked(folder: Path) -> Iterator[Recording]:
    """Yield recordings of drones and hands beside a reference of the orientation.

    The derivative of an orientation is far noisier than a gyroscope, so that only the bias is known
    from it: the constant one that explains the orientation best over the whole recording.
    """
    for path in sorted((folder / 'dead_reckoning').glob('*.npz')):
        data = np.load(path)
        rates, acceleration = data['rate'].astype(float), data['acc'].astype(float)
        unknown, moving = np.full(rates.shape, np.nan), np.zeros(len(rates), bool)
        bias = data['hindsight_bias'].astype(float)
        yield Recording(path.stem, data['t'], rates, acceleration, unknown, moving, bias)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--data', type=Path, metavar='FOLDER', help='real recordings')
    parser.add_argument('--seed', type=int, default=0)
    options = parser.parse_args()
    random = np.random.default_rng(options.seed)
    groups = [
        [r for rate in _RATES for level in _NOISES for r in simulated(rate, *level, random)],
        [*of_drivers(random)],
    ]
    if options.data:
        groups += [
            [*motion_by_hand(options.data, random)],
            [*motionless(options.data)],
            [*tracked(options.data)],
        ]
    rows = [['share within two deviations, %', *_COLUMNS]]
    for group in groups:
        shares = [judge(recording) for recording in group]
        for recording, found in zip(group, shares, strict=True):
            rows.append([recording.name, *(_shown(found[name]) for name in _COLUMNS)])
        known = ([s[name] for s in shares if not np.isnan(s[name])] for name in _COLUMNS)
        rows.append(['MEAN', *(_shown(float(np.mean(some))) if some else '-' for some in known)])
    print(table(rows))


def _shown(share: float) -> str:
    return '-' if np.isnan(share) else f'{100.0 * share:.1f}'


if __name__ == '__main__':
    main()
