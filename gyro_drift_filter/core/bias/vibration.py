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

"""How strongly the sensor vibrates in motion.

Motors shake rates and accelerations without a pause. What a body does by itself is smooth over some
hundredths of a second, so that third differences of the values show little of it, and what they do
show has pauses: a hand slows down, a foot stands between two steps. So the vibration is what the
third differences have in the calmest window of a period.
"""

from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.rest.records import SIGNALS

# A foot stands still for longer than a window between two steps, and a hand slows down within a
# period; that of a drone is soon over, as it needs its bias.
WINDOW_SECONDS, PERIOD_SECONDS = 0.1, 2.0
# Values that last longer, in s, do not follow the motion closely enough: below 80 Hz.
LONGEST_VALUE = 0.0125
ORDER = 3
WEIGHTS = 20.0  # the sum of the squares of 1, 3, 3, 1: white noise keeps its variance

Signals = Annotated[NDArray[np.float64], np.float64, (SIGNALS,)]
Differences = Annotated[NDArray[np.float64], np.float64, (SIGNALS, ORDER)]


class Vibration(TypedDict):
    """The third differences of the window and of the period under way: rates, accelerations."""

    last: Differences  # the last value, and its first and second difference
    values: int  # in a row, up to `ORDER`
    # the window under way
    squares: Signals  # sum
    differences: int
    window_seconds: float
    # the period under way; `calmest` is that of the last one until its first window has ended
    calmest: Signals  # mean square of the calmest window, in (rad/s)^2 and (m/s^2)^2
    period_seconds: float


VIBRATION = record(Vibration)


@kernel
def interrupt_vibration(state: Vibration) -> None:
    """Begin a new period: values are missing, or the sensor rests."""
    state['values'] = 0
    state['period_seconds'] = 0.0
    _start_window(state)


@kernel
def _start_window(state: Vibration) -> None:
    state['differences'] = 0
    state['window_seconds'] = 0.0
    for k in range(SIGNALS):
        state['squares'][k] = 0.0


@kernel
def note_vibration(state: Vibration, angle: PerAxis, speed: PerAxis, seconds: float) -> bool:
    """Take the next value in: an angle in rad and a speed in m/s, gained in `seconds`.

    Return whether a period has ended with it.
    """
    if seconds > LONGEST_VALUE:
        state['values'] = 0
        return False
    whole = state['values'] == ORDER
    for k in range(SIGNALS):
        last = state['last'][k]
        difference = (angle[k] if k < 3 else speed[k - 3]) / seconds
        for order in range(ORDER):
            before, last[order] = last[order], difference
            difference -= before
        if whole:
            state['squares'][k] += difference * difference / WEIGHTS
    if not whole:
        state['values'] += 1
        return False
    state['differences'] += 1
    state['window_seconds'] += seconds
    if state['window_seconds'] < WINDOW_SECONDS - 0.5 * seconds:
        return False
    for k in range(SIGNALS):
        square = state['squares'][k] / state['differences']
        if state['period_seconds'] == 0.0 or square < state['calmest'][k]:
            state['calmest'][k] = square
    state['period_seconds'] += state['window_seconds']
    _start_window(state)
    if state['period_seconds'] < PERIOD_SECONDS - 0.5 * WINDOW_SECONDS:
        return False
    state['period_seconds'] = 0.0
    return True
