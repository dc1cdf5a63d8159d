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

"""How the clock of the stamps runs beside that of the recorder."""

import math
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.doctor.findings import Finding, fault, sound, unknown
from gyro_drift_filter.identify.series import LARGEST_PART, Values, parts, value_at
from gyro_drift_filter.identify.timing import EARLIEST
from gyro_drift_filter.phrases import plain

# Between two clocks by crystals there are 200 ppm at most, and what shows at all takes a hundredth
# of a second; a clock that is set jumps by more than messages take.
_DRIFT, _DRIFT_SECONDS = 2e-4, 0.01
_CLOCK_STEP = 0.1
# A step stands out by this factor from how offsets move otherwise: no delay that scatters does.
_STANDS_OUT = 10.0
# Recorders log within a tenth of a second, busy ones in two. The future begins behind what clocks
# of two machines are off by.
_OFFSET, _AHEAD = 1.0, 0.005
_YEAR = 3.2e7  # s: no sensor stamps so late, so its clock counts from another time
# Seconds of a stamp have 32 bits: behind the largest, in January 2038, comes the least.
_OVERFLOW = 2.0**32
# The clocks are compared in so many parts of the recording, each of so many samples at least.
_BLOCKS = 100
_LEAST_BLOCK = 20


def judge_log_clock(stamps: Values, log_times: Values) -> Finding:
    """Say how the clock of the stamps runs beside that of the recorder; (n,) each, in ns.

    The recorder can't log a message before it was stamped, and how long it takes varies: the least
    difference of each block of the recording is the difference of the clocks.
    """
    name = 'clock'
    offsets, places = _least_offsets(stamps, log_times)
    if not len(offsets):
        return unknown(name, 'too few samples to compare stamps with log times')
    if not offsets.any() and _are_equal(stamps, log_times):
        return unknown(
            name,
            'log times are the stamps (a converted recording), so delays can not be seen',
        )
    seconds = float(places[-1] - places[0])
    drift, spread = _slope(places, offsets)
    offset = float(np.median(offsets))
    values: dict[str, Any] = {
        'offset_seconds': offset,
        'drift_ppm': 1e6 * drift,
        'drift_ppm_deviation': 1e6 * spread,
    }
    if jump := _jump(offsets, values):
        return jump
    if abs(drift) > _DRIFT + 3.0 * spread and abs(drift) * seconds > _DRIFT_SECONDS:
        return fault(
            'clock drift',
            f'the clock of the stamps runs {1e6 * abs(drift):.0f} ppm '
            f'{"slower" if drift > 0 else "faster"} than the log times: '
            f'{1e3 * abs(drift) * seconds:.0f} ms over the recording',
            "stamps of the sensor's own clock have to be mapped to the computer's; rates that are "
            'integrated by them are off by the same share',
            values,
        )
    begin, logged = (1e-9 * float(value_at(times, 0)) for times in (stamps, log_times))
    if abs(offset) > _OFFSET or offset < -_AHEAD:
        return _apart(offset, begin, logged, values)
    unset = '; both before 2007, as in a simulation or where none was set'
    return sound(
        name,
        f'logged {plain(1e3 * offset, 2)} ms after the stamp, clocks within '
        f'{max(1e6 * abs(drift), 1.0):.0f} ppm{unset if logged < EARLIEST else ""}',
        values,
    )


def _jump(offsets: Floats, values: dict[str, Any]) -> Finding | None:
    """Return by how much one clock jumps against the other; None where it does not."""
    steps = _steps(offsets)
    step = float(np.max(np.abs(np.diff(offsets)), initial=0.0))
    if step <= _CLOCK_STEP or max(step, abs(steps.sum())) <= 0.5 * float(np.ptp(offsets)):
        return None
    was_set = 'a clock was set while recording (NTP, PTP)'
    advice, times = f'{was_set}: wait for its synchronisation before recording', ''
    if len(steps) > 1:
        advice = (
            f'is it of a recording that was played again and again, or of several? Else {was_set}'
        )
        times = f', {len(steps)} times'
    if abs(step - _OVERFLOW) < _OFFSET:
        advice = (
            'seconds of stamps have 32 bits and overflow in January 2038: set the clock of the '
            'stamps right, or divide the recording there'
        )
    return fault(
        'clock steps',
        f'the clock of the stamps jumps against the log times by {plain(step)} s at once{times}',
        advice,
        values | {'step_seconds': step},
    )


def _apart(offset: float, begin: float, logged: float, values: dict[str, Any]) -> Finding:
    """Say what an offset in s means, by the first stamp and the first log time in s."""
    side = 'before' if offset > 0 else 'after'
    text = f'stamps are {plain(abs(offset))} s {side} the log times'
    if logged < EARLIEST and offset < 0:
        text = 'log times are before 2007: the clock of the recorder was not set'
    if 0.0 <= begin < EARLIEST and offset > _YEAR:
        text = f'stamps begin at {plain(begin, 4)} s: they count from the start of sensor or driver'
    advice = 'stamps lie in the future: look at the clocks of sensor and recorder'
    if offset > 0:
        advice = (
            'the sensor has a clock of its own or stamps late: a fusion by stamps with other '
            'sensors will fail'
        )
    return fault('clock offset', text, advice, values)


def _least_offsets(stamps: Values, log_times: Values) -> tuple[Floats, Floats]:
    """Return the least log time after the stamp in s of up to 100 blocks, and their times in s."""
    n = len(stamps)
    count = min(_BLOCKS, n // _LEAST_BLOCK)
    offsets, places, begin = np.empty(count), np.empty(count), 0
    for k in range(count):
        where = slice(k * n // count, min((k + 1) * n // count, k * n // count + LARGEST_PART))
        stamp = np.asarray(stamps[where], np.int64)
        log = np.asarray(log_times[where], np.int64)
        begin = begin or int(log[0])
        least = int(np.argmin(log - stamp))
        offsets[k] = (log[least] - stamp[least]) * 1e-9
        places[k] = (log[least] - begin) * 1e-9
    return offsets, places


def _steps(offsets: Floats) -> Floats:
    """Return the steps in s by which offsets (b,) jump, beside how they move otherwise."""
    if len(offsets) < 2:
        return np.zeros(0)
    moves = np.diff(offsets)
    moves -= np.median(moves)
    usual = float(np.median(np.abs(moves)))
    return np.asarray(moves[np.abs(moves) > max(_CLOCK_STEP, _STANDS_OUT * usual)])


def _are_equal(stamps: Values, log_times: Values) -> bool:
    pairs = zip(parts(stamps), parts(log_times), strict=True)
    return all(bool((stamp == log_time).all()) for stamp, log_time in pairs)


def _slope(places: Floats, offsets: Floats) -> tuple[float, float]:
    """Return the slope of a line through the offsets, and its standard deviation."""
    if len(places) < 3 or np.ptp(places) == 0.0:
        return 0.0, math.inf
    coefficients, covariance = np.polyfit(places - places.mean(), offsets, 1, cov=True)
    return float(coefficients[0]), math.sqrt(float(covariance[0, 0]))
