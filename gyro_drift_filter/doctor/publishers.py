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

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.doctor.findings import Finding, fault, sound
from gyro_drift_filter.identify.series import LARGEST_PART, Values, stacked

# Every other sample, in stretches of so many, beside the mean of its neighbours: of two sensors,
# each with its own bias, it is off to one side and to the other in turn. Of one that vibrates near
# half the sample rate it is so for a while, until it is the other way round.
_STRETCH = 200
# The difference has to be that many of its deviations, in that share of the stretches. Noise of any
# spectrum gives it in none, sensors that take turns in all in which no message is lost.
_DEVIATIONS, _SHARE = 8.0, 0.5


def judge_publishers(rates: tuple[Values, ...], connections: int) -> Finding:
    """Say whether rates, three columns (n,), are of one sensor.

    Args:
        rates: In rad/s, in the order in which they were logged.
        connections: Publishers that the recording names for the topic.
    """
    apart = total = 0
    for first in range(0, len(rates[0]), LARGEST_PART // _STRETCH * _STRETCH):
        part = slice(first, first + LARGEST_PART // _STRETCH * _STRETCH)
        values = stacked(rates, part)
        values = values[: len(values) // _STRETCH * _STRETCH].reshape(-1, _STRETCH, 3)
        total += len(values)
        apart += int(_take_turns(values).sum())
    share = apart / total if total else 0.0
    found: dict[str, Any] = {'connections': connections, 'share_apart': share}
    if share > _SHARE:
        return fault(
            'publishers',
            'two sensors or drivers take turns on the topic: every other sample has another bias',
            'remap one of them; see who publishes with `ros2 topic info -v`',
            found,
        )
    if connections > 1:
        return fault(
            'publishers',
            f'the recording names {connections} publishers of the topic',
            'was a driver started anew, or do two publish? See `ros2 topic info -v`',
            found,
        )
    return sound('publishers', 'one publisher', found)


def _take_turns(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return for stretches (s, n, 3) whether their samples are off to both sides in turn."""
    off = values[:, 1:-1] - 0.5 * (values[:, :-2] + values[:, 2:])
    off[:, ::2] *= -1.0
    mean, deviation = off.mean(axis=1), off.std(axis=1) / np.sqrt(off.shape[1])
    return np.asarray((np.abs(mean) > _DEVIATIONS * np.maximum(deviation, 1e-12)).any(axis=1))
