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

"""How good, as drivers deliver: one simulated motion through the habits of drivers and sensors.

    python -m benchmark.drivers [--seed N] [--only WORLD ...] [--check]

A ratio of 1.00 means no better and no worse than what the driver gave, its true bias taken off.
What the columns say stands in `LEGEND`; the limits stand in `bars_drivers.json`.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from benchmark.figures import rms, tell_misses
from benchmark.quality import falls_short, read_bars
from benchmark.scenarios import motion, noise, stamps
from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.rotations import from_vectors, running_products

BARS = read_bars('bars_drivers.json')
LEGEND = """\
move, rest  rms error of the filtered rates in motion and at rest after 30 s, over that of what the
            driver gave
lost        deg by which the heading after two minutes is further off than that of what it gave
bias        what is left of the bias in the last quarter, as a share of it
flags       share of samples in motion that were flagged as outliers
"""
_DEVIATION = 0.006  # rad/s, of the noise
_SECONDS = 120.0
_WARM = 30.0  # s
_SPEEDS = (1.0, 0.5, 1.5, 1.0)


@dataclass
class Delivery:
    """What a driver delivers, and what is true.

    Attributes:
        rate: Messages a second.
        stamps: (n,) in ns.
        given: (n, 3) what the driver gives, in rad/s.
        truth: (n, 3) in rad/s.
        acceleration: (n, 3) in m/s^2.
        rest: (n,), True where the body is at rest.
        bias: (3,) in rad/s.
    """

    rate: float
    stamps: Integers
    given: Floats
    truth: Floats
    acceleration: Floats
    rest: Bools
    bias: Floats

    def keep(self, kept: Bools) -> None:
        """Drop all messages but some."""
        for name in ('stamps', 'given', 'truth', 'acceleration', 'rest'):
            setattr(self, name, getattr(self, name)[kept])


def deliver(rate: float, speed: float, random: np.random.Generator) -> Delivery:
    """Return what an ideal driver delivers: even stamps, white noise, no bias."""
    trial = motion(_SECONDS, rate, random, speed)
    n = len(trial.truth)
    given = trial.truth + noise(n, rate, _DEVIATION, 'white', random)
    even, bias = stamps(n, rate), np.zeros(3)
    return Delivery(rate, even, given, trial.truth, trial.acceleration, trial.rest, bias)


def lag(values: Floats, share: float) -> Floats:
    """Return (n, 3) values after two first-order lags."""
    for _ in range(2):
        start = (1.0 - share) * values[:1]
        values = lfilter([share], [1.0, share - 1.0], values, axis=0, zi=start)[0]
    return values


def _plain(speed: float, random: np.random.Generator) -> Delivery:
    return deliver(100.0, speed, random)


def _decimated(speed: float, random: np.random.Generator) -> Delivery:
    """Every second sample of a sensor whose motion reaches beyond the new Nyquist frequency."""
    delivery = deliver(100.0, speed, random)
    delivery.keep(np.arange(len(delivery.stamps)) % 2 == 0)
    delivery.rate = 50.0
    return delivery


def _arrival(speed: float, random: np.random.Generator) -> Delivery:
    """Stamped on arrival, late by 1.5 ms on the mean."""
    delivery = deliver(200.0, speed, random)
    late = random.exponential(1.5e6, len(delivery.stamps)).astype(np.int64)
    delivery.stamps = np.maximum.accumulate(delivery.stamps + late)
    return delivery


def _polled(speed: float, random: np.random.Generator) -> Delivery:
    """One message in five repeats the rates; now and then the bus hangs for three more."""
    delivery = deliver(100.0, speed, random)
    n = len(delivery.stamps)
    held = np.arange(n) % 5 == 4
    for k in random.choice(np.arange(500, n - 4), n // 200, replace=False):
        held[k : k + 3] = True
    for k in np.flatnonzero(held):
        delivery.given[k] = delivery.given[k - 1]
    return delivery


def _polled_fast(speed: float, random: np.random.Generator) -> Delivery:
    """Deliver each of 100 samples a second ten times, all six values."""
    delivery = deliver(1000.0, speed, random)
    latest = np.arange(len(delivery.stamps)) // 10 * 10
    delivery.given, delivery.acceleration = delivery.given[latest], delivery.acceleration[latest]
    return delivery


def _clipped(speed: float, random: np.random.Generator) -> Delivery:
    """Deliver a range of 250 deg/s; judge where the motion is within it."""
    delivery = deliver(100.0, 2.0 * speed, random)
    limit = np.radians(250.0)
    delivery.given = np.clip(delivery.given, -limit, limit)
    return delivery


def _calibrated(speed: float, random: np.random.Generator) -> Delivery:
    """Do the same, and add a hundredth of the other axes: a driver that calibrates."""
    delivery = _clipped(speed, random)
    mixed = np.eye(3) + 0.01 * np.array([[0.0, 1.0, -1.0], [-1.0, 0.0, 1.0], [1.0, -1.0, 0.0]])
    delivery.given, delivery.truth = delivery.given @ mixed.T, delivery.truth @ mixed.T
    return delivery


def _low_passed(speed: float, random: np.random.Generator) -> Delivery:
    """Deliver the sensor's own low-pass at some 8 Hz, slow motion, and a bias."""
    delivery = deliver(100.0, 0.1 * speed, random)
    delivery.truth, given = lag(delivery.truth, 0.45), lag(delivery.given, 0.45)
    delivery.bias = np.radians([1.0, -0.5, 0.7])
    delivery.given = given + delivery.bias
    return delivery


def _dropped(speed: float, random: np.random.Generator) -> Delivery:
    """One message in 50 missing, and ten gaps of 0.2 s."""
    delivery = deliver(100.0, speed, random)
    n = len(delivery.stamps)
    kept = random.random(n) > 0.02
    for k in random.choice(np.arange(500, n - 20), 10, replace=False):
        kept[k : k + 20] = False
    delivery.keep(kept)
    return delivery


def _jittered(speed: float, random: np.random.Generator) -> Delivery:
    """Stamps off by up to 40 % of the period."""
    delivery = deliver(100.0, speed, random)
    delivery.stamps += np.round(random.uniform(-4e6, 4e6, len(delivery.stamps))).astype(np.int64)
    return delivery


def _coarse(speed: float, random: np.random.Generator) -> Delivery:
    """Deliver counts of 0.5 deg/s, rounded."""
    delivery = deliver(100.0, speed, random)
    count = np.radians(0.5)
    delivery.given = np.round(delivery.given / count) * count
    return delivery


def _shaken(speed: float, random: np.random.Generator) -> Delivery:
    """4 deg/s of turn-on bias beside the vibration of a motor, from power-on."""
    delivery = deliver(100.0, speed, random)
    tone = np.sin(2.0 * np.pi * 37.3 * np.arange(len(delivery.stamps)) / delivery.rate)[:, None]
    delivery.bias = np.radians([1.0, -2.0, 4.0])
    shake = 7.0 * _DEVIATION * tone * np.array([1.0, -0.7, 0.5])
    delivery.given += shake + delivery.bias
    delivery.acceleration += 3.0 * tone * np.array([0.2, 0.5, 0.3])
    return delivery


WORLDS: dict[str, Callable[[float, np.random.Generator], Delivery]] = {
    'plain': _plain,
    'decimated': _decimated,
    'arrival': _arrival,
    'polled': _polled,
    'polled fast': _polled_fast,
    'clipped': _clipped,
    'calibrated': _calibrated,
    'low-passed': _low_passed,
    'dropped': _dropped,
    'jittered': _jittered,
    'coarse': _coarse,
    'shaken': _shaken,
}

# A rate is judged where all are within so many deg/s of a range of 250.
_WITHIN = {'clipped': 245.0, 'calibrated': 240.0}


def score(world: str, seed: int) -> dict[str, list[float]]:
    """Return the figures of a world by name, one for each of its trials."""
    figures: dict[str, list[float]] = {}
    for number, speed in enumerate(_SPEEDS):
        random = np.random.default_rng([seed, number])
        delivery = WORLDS[world](speed, random)
        filter_ = Filter(Parameters())
        out = filter_.run(delivery.stamps, delivery.given, delivery.acceleration)
        for name, value in _judge(world, delivery, out).items():
            figures.setdefault(name, []).append(value)
    return figures


def _judge(world: str, delivery: Delivery, out: NDArray[np.void]) -> dict[str, float]:
    truth, given = delivery.truth, delivery.given - delivery.bias
    filtered = out['angular_velocity'].copy()
    if world in _WITHIN:
        outside = np.abs(truth).max(axis=1) > np.radians(_WITHIN[world])
        filtered[outside], given[outside] = truth[outside], truth[outside]
    warm = np.arange(len(truth)) > _WARM * delivery.rate
    moving, at_rest = warm & ~delivery.rest, warm & delivery.rest
    end = _orientation(delivery, truth)
    errors = [
        np.degrees((_orientation(delivery, rates) * end.inv()).magnitude())
        for rates in (filtered, given)
    ]
    figures = {
        'move': rms((filtered - truth)[moving]) / rms((given - truth)[moving]),
        'rest': rms((filtered - truth)[at_rest]) / rms((given - truth)[at_rest]),
        'lost': float(errors[0] - errors[1]),
        'flags': float((out['outlier'][moving] > 0).any(axis=1).mean()),
    }
    if delivery.bias.any():
        late = at_rest & (np.arange(len(truth)) > 0.75 * len(truth))
        figures['bias'] = rms((filtered - truth)[late].mean(axis=0)) / rms(delivery.bias)
    return figures


def _orientation(delivery: Delivery, rates: Floats) -> Rotation:
    """Return the rotation that rates (n, 3) in the body's axes add up to, by the stamps."""
    steps = np.diff(delivery.stamps, prepend=delivery.stamps[0]) * 1e-9
    return Rotation.from_quat(running_products(from_vectors(rates * steps[:, None]))[-1])


def misses(world: str, figures: dict[str, list[float]]) -> list[str]:
    """Return a text for each bar of a world that does not hold."""
    named = {f'{world}.{name}': values for name, values in figures.items()}
    bars = {name: bar for name, bar in BARS.items() if name.startswith(f'{world}.')}
    return list(falls_short(named, bars))


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--seed', type=int, default=7)
    parser.add_argument('--only', nargs='*', default=list(WORLDS), metavar='WORLD')
    parser.add_argument('--check', action='store_true', help='fail where a bar does not hold')
    options = parser.parse_args(arguments)
    if unknown := set(options.only) - set(WORLDS):
        raise GyroDriftFilterError(
            f'there is no world {", ".join(sorted(unknown))}: there are {", ".join(WORLDS)}'
        )
    names = ('move', 'rest', 'lost', 'bias', 'flags')
    rows, short = [['median / worst', *names]], []
    for world in options.only:
        tell(f'scoring {world} ...')
        figures = score(world, options.seed)
        short += misses(world, figures)
        cells = (figures.get(name) for name in names)
        rows.append([world, *(f'{np.median(v):.3g} / {max(v):.3g}' if v else '-' for v in cells)])
    print(table(rows))
    print()
    print(LEGEND)
    return tell_misses(short, check=options.check)


if __name__ == '__main__':
    sys.exit(main())
