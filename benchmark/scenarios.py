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

"""Simulated gyroscopes with truth: rests, slow turns, hand-like motion, taps and outliers."""

from dataclasses import dataclass

import numpy as np
from scipy import signal
from scipy.spatial.transform import Rotation

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.gravity import GRAVITY

START = 1_600_000_000_000_000_000

# Motion is made at this rate in Hz and sampled from it, so that all sample rates see the same.
_FINE = 4000.0
# A body that is moved by hand or motor has little above this; so the truth is known at any rate.
_MOTION_BAND = 25.0
_STILL = 1e-3  # rad/s
_STILL_SECONDS = 0.2


@dataclass(frozen=True)
class Trial:
    """A motion without noise.

    Attributes:
        truth: (n, 3) in rad/s.
        acceleration: (n, 3) in m/s^2.
        rest: (n,), True where the body has stood still for a while, and will.
    """

    truth: Floats
    acceleration: Floats
    rest: Bools

    def since(self, first: int) -> 'Trial':
        """Return what follows from a sample on."""
        return Trial(self.truth[first:], self.acceleration[first:], self.rest[first:])


def stamps(n: int, rate: float) -> Integers:
    """Return (n,) even stamps in ns."""
    return START + np.round(np.arange(n) * 1e9 / rate).astype(np.int64)


def bursty_stamps(n: int, rate: float, random: np.random.Generator) -> Integers:
    """Return (n,) stamps as a driver gives that hands over up to 40 samples at a time."""
    sizes = random.integers(1, 40, n)
    ends = np.cumsum(sizes)
    block = np.searchsorted(ends, np.arange(n), side='right')
    last = ends[block]
    place = np.arange(n) - (last - sizes[block])
    return START + np.round(last * 1e9 / rate + place * 0.2e9 / rate).astype(np.int64)


def noise(n: int, rate: float, deviation: float, kind: str, random: np.random.Generator) -> Floats:
    """Return (n, 3) of sensor noise in rad/s, with a slow wander of the bias.

    Args:
        n: Samples.
        rate: In Hz.
        deviation: Standard deviation in rad/s.
        kind: 'white', 'autoregressive' (phi 0.218, as in the paper) or 'quantised' (white, in
            steps of 0.15 standard deviations).
        random: Source of random numbers.
    """
    values = random.standard_normal((n + 100, 3))
    if kind == 'autoregressive':
        values = signal.lfilter([1.0], [1.0, -0.218], values, axis=0)
    values = values[100:] * (deviation / values[100:].std(axis=0))
    wander = np.cumsum(random.standard_normal((n, 3)), axis=0)
    values += deviation * 1e-4 * np.sqrt(100.0 / rate) * wander
    if kind == 'quantised':
        step = 0.15 * deviation
        values = np.round(values / step) * step
    return np.asarray(values)


def motion(seconds: float, rate: float, random: np.random.Generator, speed: float = 1.0) -> Trial:
    """Return a trial: half a minute of rest, then spells of motion with rests between them.

    Shares and lengths are those of the recordings of hand motion that the method was made with:
    rests of 8 to 12 s between longer spells of motion.

    Args:
        seconds: Length.
        rate: Sample rate in Hz.
        random: Source of random numbers.
        speed: Scale of the rates.
    """
    n = int(seconds * _FINE)
    truth = np.zeros((n, 3))
    spells = (_by_hand, _by_hand, _fast, _turn, _turn, _tap, _wobble)
    at = 25.0 + random.uniform(0.0, 5.0)
    while at < seconds - 10.0:
        length = min(random.uniform(8.0, 20.0), seconds - at - 5.0)
        first, m = int(at * _FINE), int(length * _FINE)
        spell = spells[random.integers(len(spells))]
        truth[first : first + m] += speed * spell(np.arange(m) / _FINE, random)
        at += length + random.uniform(8.0, 12.0)
    truth = _low_pass(truth, min(_MOTION_BAND, rate / 4), order=6)
    truth = truth[np.round(np.arange(int(seconds * rate)) * _FINE / rate).astype(int)]
    acceleration = _gravity(truth, rate) + 0.05 * np.gradient(truth, 1 / rate, axis=0)[:, [1, 2, 0]]
    acceleration += 0.02 * random.standard_normal(truth.shape)
    margin = int(_STILL_SECONDS * rate)
    still = np.pad((np.abs(truth) < _STILL).all(axis=1), margin, mode='edge').astype(float)
    rest = np.convolve(still, np.ones(2 * margin + 1), 'valid') > 2 * margin + 0.5
    return Trial(truth, acceleration, rest)


def _gravity(truth: Floats, rate: float) -> Floats:
    """Return gravity in the axes of a body that turns at the rates `truth`, (n, 3) in m/s^2."""
    stride = max(1, round(rate / 100.0))
    turns = Rotation.from_rotvec(truth[::stride] * stride / rate).inv().as_matrix()
    coarse = np.empty((len(turns), 3))
    vector = np.array([0.0, 0.0, GRAVITY])
    for k, turn in enumerate(turns):
        coarse[k] = vector
        vector = turn @ vector
    index, known = np.arange(len(truth)), np.arange(len(turns)) * stride
    return np.column_stack([np.interp(index, known, coarse[:, axis]) for axis in range(3)])


def _low_pass(values: Floats, hertz: float, order: int = 3) -> Floats:
    sections = signal.butter(order, hertz, fs=_FINE, output='sos')
    # Rates of zero would make it decay to numbers so small that processors take twenty times as
    # long for them. A constant passes a low-pass unchanged.
    return np.asarray(signal.sosfiltfilt(sections, values + 1.0, axis=0) - 1.0)


def _edges(time: Floats, seconds: float) -> Floats:
    """Return a smooth rise and fall within `seconds` of either end."""
    share = np.clip(np.minimum(time, time[-1] - time) / seconds, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * share))


def _by_hand(
    time: Floats, random: np.random.Generator, hertz: float = 2.0, size: float = 2.0
) -> Floats:
    rates = _low_pass(random.standard_normal((len(time), 3)), random.uniform(0.5, 1.5) * hertz)
    tremor = _low_pass(random.standard_normal((len(time), 3)), 12.0)
    rates = rates / rates.std() + 0.02 * tremor / tremor.std()
    window = _edges(time, random.uniform(0.1, 0.5))[:, None]
    return np.asarray(
        size * random.uniform(0.2, 1.5) * random.uniform(0.3, 1.0, 3) * window * rates
    )


def _fast(time: Floats, random: np.random.Generator) -> Floats:
    return _by_hand(time, random, hertz=3.5, size=4.0)


def _turn(time: Floats, random: np.random.Generator) -> Floats:
    """Return a steady turn, as wheels make it, between 0.02 and 1.5 rad/s."""
    window = _edges(time, random.uniform(0.1, 0.6))[:, None]
    size = random.choice([0.02, 0.1, 0.5, 1.5])
    return np.asarray(size * window * random.standard_normal(3))


def _wobble(time: Floats, random: np.random.Generator) -> Floats:
    wave = np.sin(2 * np.pi * random.uniform(1.0, 6.0) * time) * _edges(time, 0.1)
    return np.asarray(random.uniform(0.2, 3.0) * wave[:, None] * random.standard_normal(3))


def _tap(time: Floats, random: np.random.Generator) -> Floats:
    """Knocks on a hand-held body, each a ringing that dies away within a tenth of a second."""
    rates = 0.2 * _by_hand(time, random)
    for begin in random.uniform(0.0, time[-1] - 0.8, max(1, int(time[-1]))):
        since = np.clip(time - begin, 0.0, None)
        for axis in range(3):
            ring = np.exp(-since / random.uniform(0.03, 0.1))
            wave = np.sin(2 * np.pi * random.uniform(6.0, 16.0) * since)
            rates[:, axis] += random.normal(0.0, 1.2) * ring * wave
    return rates


def add_outliers(rates: Floats, random: np.random.Generator) -> tuple[Floats, Bools]:
    """Return rates with outliers as gyro drivers produce them, and where, (n, 3) each.

    Per axis 0.5 % isolated spikes of 2 to 35 rad/s and 0.05 % bursts of three equal ones; and
    0.05 % drop-outs of two samples to exactly zero on all axes.
    """
    out, mask, n = rates.copy(), np.zeros(rates.shape, bool), len(rates)

    def size() -> float:
        return float(random.choice([-1.0, 1.0]) * random.uniform(2.0, 35.0))

    for axis in range(3):
        for k in random.choice(np.arange(200, n), n // 200, replace=False):
            out[k, axis] += size()
            mask[k, axis] = True
        for k in random.choice(np.arange(200, n - 4), n // 2000, replace=False):
            out[k : k + 3, axis] += size()
            mask[k : k + 3, axis] = True
    for k in random.choice(np.arange(200, n - 3), n // 2000, replace=False):
        out[k : k + 2] = 0.0
        mask[k : k + 2] = True
    return out, mask


def bridge(rates: Floats, mask: Bools) -> Floats:
    """Return rates with the marked samples extrapolated from the two before, damped by 0.8.

    This is what someone can do who is told which samples are outliers.
    """
    out = rates.copy()
    for axis in range(3):
        for k in np.flatnonzero(mask[:, axis]):
            out[k, axis] = out[k - 1, axis] + 0.8 * (out[k - 1, axis] - out[k - 2, axis])
    return out


def foot(random: np.random.Generator, rate: float, shake: float) -> tuple[Floats, Floats]:
    """Return rates and accelerations (n, 3) of a foot: each second it swings, and strikes.

    It swings up to 24 rad/s in 0.4 s, stops in 25 ms, and shakes the accelerometer by a deviation
    of `shake` in m/s^2, which decays in 20 ms.
    """
    time = np.arange(round(12 * rate)) / rate
    phase = np.where(time < 3.0, 0.9, time % 1.0)
    swing = np.where(phase < 0.4, 0.5 - 0.5 * np.cos(np.pi * phase / 0.4), 17.0 - 40.0 * phase)
    swing = np.clip(swing, 0.0, 1.0)[:, None]
    struck = np.where(phase > 0.4, shake * np.exp(-(phase - 0.4) / 0.02), 0.0)
    shaken = np.maximum(np.where(phase < 0.4, 1.0, 0.02), struck)[:, None]
    rates = 24.0 * swing * [0.1, 1.0, -0.05] + 0.005 * random.standard_normal((len(time), 3))
    return rates, [0.0, 0.0, GRAVITY] + shaken * random.standard_normal((len(time), 3))


def stopped(random: np.random.Generator, rate: float, shake: float) -> tuple[Floats, Floats]:
    """Return rates and accelerations (n, 3) of a body that is swung against a table every 2 s.

    It gains 18 rad/s in 0.6 s, stops within a sample, rings by a third of that at 11 Hz for 40 ms,
    and shakes the accelerometer by a deviation of `shake` in m/s^2, which decays in 30 ms.
    """
    time = np.arange(round(12 * rate)) / rate
    phase = np.where(time < 3.0, 1.9, time % 2.0) - 0.6
    swing = np.sin(0.5 * np.pi * (phase + 0.6) / 0.6)
    ring = np.cos(2.0 * np.pi * 11.0 * phase) * np.exp(-phase.clip(0.0) / 0.04) / 3.0
    rates = 18.0 * np.where(phase < 0.0, swing, ring)[:, None] * [0.02, 1.0, -0.01]
    struck = np.where(phase < 0.0, 0.5, shake * np.exp(-phase.clip(0.0) / 0.03)).clip(0.02)
    rates += 0.001 * random.standard_normal(rates.shape)
    return rates, [0.0, 0.0, GRAVITY] + struck[:, None] * random.standard_normal(rates.shape)


def spun_up(random: np.random.Generator, rate: float, lever: float) -> tuple[Floats, Floats]:
    """Return rates and accelerations (n, 3) of a body that sways, and is spun up each second.

    A motor turns it by 8 rad/s more within 10 ms, for 0.4 s, about an axis that lies `lever` m from
    the sensor. The rates are means over a sample period.
    """
    fine = 20
    time = (np.arange(round(12 * rate) * fine) + 0.5) / (rate * fine)
    phase = np.where(time < 3.0, 0.9, time % 1.0)
    spun = np.clip(phase / 0.01, 0.0, 1.0) - np.clip((phase - 0.4) / 0.01, 0.0, 1.0)
    sway = np.where(time < 2.0, 0.0, np.sin(2.0 * np.pi * 0.7 * time))
    turned = np.outer(sway, [1.0, 0.5, 0.7]) + np.outer(8.0 * spun, [0.0, 0.0, 1.0])
    rates = turned.reshape(-1, fine, 3).mean(axis=1)
    pushed = lever * np.diff(rates[:, 2], prepend=rates[0, 2]) * rate
    shake = 0.2 * random.standard_normal((len(rates), 3))
    accelerations = shake + np.outer(pushed, [0.0, 1.0, 0.0]) + [0.0, 0.0, GRAVITY]
    return rates + 0.005 * random.standard_normal(rates.shape), accelerations
