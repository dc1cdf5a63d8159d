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

"""Recordings of moves and rests, and how a filter is run over them."""

import numpy as np
from scipy import signal

from support.messages import START, even_stamps
from support.sensor import at_rest, by_hand


def run(filter_, rates, accelerations, rate=100.0, start=START):
    """Return the results of a filter for rates and accelerations (n, 3) at even stamps."""
    return filter_.run(even_stamps(len(rates), rate, start), rates, accelerations)


def moving_and_resting(random, spells, bias):
    """Return rates and accelerations of spells (seconds, whether it moves)."""
    parts = []
    for seconds, moves in spells:
        rates, accelerations = at_rest(random, seconds)
        if moves:
            turn, push = by_hand(random, seconds)
            rates, accelerations = rates + turn, accelerations + push
        parts.append((rates, accelerations))
    rates, accelerations = (np.concatenate(part) for part in zip(*parts, strict=True))
    return rates + bias(np.arange(len(rates)) / 100.0), accelerations


def shaken(random, seconds):
    """Return what makes the accelerometer alone five times as noisy."""
    n = round(100 * seconds)
    return np.zeros((n, 3)), 0.1 * random.standard_normal((n, 3))


def slow_noise(random, count):
    """Return noise (count, 3) at 10 Hz that has passed two low-passes of 0.08 Hz."""
    share = 0.05
    lags = [share**2], np.convolve([1.0, share - 1.0], [1.0, share - 1.0])
    return signal.lfilter(*lags, 0.012 * random.standard_normal((count + 300, 3)), axis=0)[300:]


def between(seconds, rate, spans):
    """Return (n,) from 0 to 1, which is 1 in the spans of time, and takes a second to change."""
    time = np.arange(round(seconds * rate)) / rate
    return np.max([np.clip(np.minimum(time - a, b - time), 0.0, 1.0) for a, b in spans], axis=0)
