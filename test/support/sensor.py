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

"""A simulated sensor: at rest, and moved by hand."""

from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy import signal

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.rotations import from_vectors, inverse, rotate, running_products
from gyro_drift_filter.simulation.experiments import autoregressive

# As of the ADIS16405 at 100 Hz, in rad/s.
NOISE, PHI = 6.1e-3, 0.167
GRAVITY = np.array([0.0, 0.0, 9.81])
DEGREE = np.pi / 180


def at_rest(
    random: np.random.Generator,
    seconds: float,
    bias: Sequence[float] | Floats = (0.0, 0.0, 0.0),
    rate: float = 100.0,
) -> tuple[Floats, Floats]:
    """Return rates and accelerations (n, 3) of a motionless sensor."""
    n = round(seconds * rate)
    rates = autoregressive(random, n, PHI, NOISE * np.sqrt(1 - PHI**2))
    return rates + np.asarray(bias), GRAVITY + 0.02 * random.standard_normal((n, 3))


def by_hand(
    random: np.random.Generator, seconds: float, rate: float = 100.0
) -> tuple[Floats, Floats]:
    """Return rates and accelerations (n, 3) that smooth motion adds."""
    n = round(seconds * rate)
    window = np.minimum(1.0, np.minimum(np.arange(n), np.arange(n)[::-1]) / (0.3 * rate))[:, None]
    motion = [motion_below(2.0, random, n, rate) for _ in '12']
    return window * motion[0] / motion[0].std(), window * 2.0 * motion[1] / motion[1].std()


def motion_below(hertz: float, random: np.random.Generator, n: int, rate: float) -> Floats:
    """Return rates (n, 3) of random motion up to a frequency in Hz, of any size."""
    sections = low_pass(hertz, rate).copy()  # scipy takes no array that can't be written to
    return np.asarray(signal.sosfiltfilt(sections, random.standard_normal((n, 3)), axis=0))


@cache
def low_pass(hertz: float, rate: float) -> Floats:
    """Return the sections of a Butterworth filter, whose design takes longer than its use."""
    sections: Floats = signal.butter(3, hertz, fs=rate, output='sos')
    sections.flags.writeable = False
    return sections


def turning_gravity(rates: Floats, rate: float) -> Floats:
    """Return gravity (n, 3) in the axes of a body that turns at rates (n, 3) from upright on."""
    turned = running_products(from_vectors(rates / rate))
    return rotate(inverse(turned), np.array([0.0, 0.0, 9.81]))


def fast_turn(n: int, rate: float) -> Floats:
    """Return rates (n, 3) of fast motion to and fro about all axes."""
    time = np.arange(n) / rate
    return np.column_stack(
        [size * np.sin(2 * np.pi * hertz * time) for size, hertz in ((6, 1.3), (4, 2.1), (9, 0.7))]
    )


def idling(
    random: np.random.Generator, seconds: float, bias: Sequence[float] | Floats
) -> tuple[Floats, Floats]:
    """Return rates and accelerations of a body that its motors shake, faster than it could move."""
    rates, accelerations = at_rest(random, seconds, bias)
    shake = np.diff(random.standard_normal((len(rates) + 1, 3)), axis=0)
    return rates + 0.02 * shake, accelerations + 0.5 * shake


def taking_off(
    random: np.random.Generator, seconds: float, bias: Sequence[float] | Floats, idles: float = 2.0
) -> tuple[Floats, Floats]:
    """Return rates and accelerations of a body that idles for so many s, and then moves."""
    rates, accelerations = idling(random, seconds, bias)
    turn, push = by_hand(random, seconds - idles)
    first = round(100 * idles)
    rates[first:] += turn
    accelerations[first:] += push
    return rates, accelerations
