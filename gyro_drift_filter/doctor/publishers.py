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

"""Whether two sensors take turns on one topic."""

from dataclasses import replace
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats
from gyro_drift_filter.core.sample import LARGEST_RATE
from gyro_drift_filter.doctor.findings import Finding, fault, sound
from gyro_drift_filter.identify.series import LARGEST_PART, Values, stacked

# Every other sample, in stretches of so many, beside the mean of its neighbours: of two sensors,
# each with its own bias, it is off to one side and to the other in turn. Of one that vibrates near
# half the sample rate it is so for a while, until it is the other way round.
_STRETCH = 200
# The difference has to be that many of its deviations, in that share of the stretches. Noise of any
# spectrum gives it in none, sensors that take turns in all in which no message is lost.
_DEVIATIONS, _SHARE = 8.0, 0.5
# Samples that are looked at together: three columns of them are one part's worth.
_TOGETHER = LARGEST_PART // 3


class TakenTurns:
    """Sees rates in the order in which they were logged, and whether two sensors take turns."""

    def __init__(self) -> None:
        """Start before the first sample."""
        self._waiting: Floats = np.empty((0, 3))  # for the rest of a stretch
        self._apart = self._stretches = 0

    def take(self, rates: Floats) -> None:
        """See the next rates (n, 3) in rad/s."""
        usable = np.where(np.abs(rates) <= LARGEST_RATE, rates, np.nan)
        rates = np.concatenate([self._waiting, usable])
        end = len(rates) // _STRETCH * _STRETCH
        stretches = rates[:end].reshape(-1, _STRETCH, 3)
        self._stretches += len(stretches)
        self._apart += int(_take_turns(stretches).sum())
        self._waiting = rates[end:]

    @property
    def share(self) -> float:
        """Of the stretches, in how many every other sample has another bias."""
        return self._apart / self._stretches if self._stretches else 0.0

    def faults(self) -> list[Finding]:
        """Return a line where two sensors take turns."""
        if self.share <= _SHARE:
            return []
        return [
            fault(
                'publishers',
                'two sensors or drivers take turns on the topic: every other sample has another '
                'bias',
                'remap one of them; see who publishes with `ros2 topic info -v`. If one does, it '
                'is a vibration at exactly half the sample rate',
                {'share_apart': self.share},
            )
        ]


def judge_publishers(rates: tuple[Values, ...], connections: int) -> Finding:
    """Say whether rates, three columns (n,), are of one sensor.

    Args:
        rates: In rad/s, in the order in which they were logged.
        connections: Publishers that the recording names for the topic.
    """
    turns = TakenTurns()
    for first in range(0, len(rates[0]), _TOGETHER):
        turns.take(stacked(rates, slice(first, first + _TOGETHER)))
    found: dict[str, Any] = {'connections': connections, 'share_apart': turns.share}
    if faults := turns.faults():
        return replace(faults[0], values=found)
    if connections > 1:
        return fault(
            'publishers',
            f'the recording names {connections} publishers of the topic',
            'was a driver started anew, or do two publish? See `ros2 topic info -v`',
            found,
        )
    return sound('publishers', 'one publisher', found)


def _take_turns(values: Floats) -> Bools:
    """Return for stretches (s, n, 3) whether their samples are off to both sides in turn."""
    off = values[:, 1:-1] - 0.5 * (values[:, :-2] + values[:, 2:])
    off[:, ::2] *= -1.0
    mean, deviation = off.mean(axis=1), off.std(axis=1) / np.sqrt(off.shape[1])
    return np.asarray((np.abs(mean) > _DEVIATIONS * np.maximum(deviation, 1e-12)).any(axis=1))
