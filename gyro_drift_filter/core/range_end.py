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

"""Whether a rate is at the end of the measuring range, where the sensor clips it.

The rate stays the same there, or, where the driver calibrates, moves by no more than the other axes
are mixed in.
"""

from typing import TYPE_CHECKING, Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, kernel
from gyro_drift_filter.core.rest.noise import deviation_of_values
from gyro_drift_filter.core.rest.records import Rest
from gyro_drift_filter.core.sample import is_usable

if TYPE_CHECKING:
    from gyro_drift_filter.core.sensor_checks import SensorChecks

# A rate that comes CLIPPED_SAMPLES times in a row is the end of the range if the step to it was
# more than so many steps of the resolution, which it is not at the top of a turn, if it led away
# from zero, as the end is met from below, and if no larger rate was held like this. It exceeds
# CLIPPED_RATE (rad/s): the smallest range is 75 deg/s. Drivers subtract a bias, so that each side
# has its own end.
CLIPPED_RATE = 1.25
CLIPPED_STEPS = 10.0
CLIPPED_SAMPLES = 3
# A driver that calibrates mixes a little of the other axes into a rate at the end of its range, so
# that it moves. But it stops abruptly: its change falls to 1 / CORNER from one sample to the next,
# from more than CORNER deviations of the noise. And the noise is gone: FLAT_SAMPLES times in a row
# the change varies by less than FLAT deviations, as noise does by chance in one of six.
CORNER, FLAT, FLAT_SAMPLES = 20.0, 0.5, 5
MIXED = 0.06  # the largest share of other axes, which moves the end of the range by as much

# The sides of positive and of negative rates.
ABOVE, BELOW = 0, 1
PerSide = Annotated[NDArray[np.float64], np.float64, (2, 3)]


class RangeEnd(TypedDict):
    """The end of the measuring range of each axis, and what tells it from a turn."""

    at_limit: CountPerAxis  # 1 where the rate is at the end of the range, else 0
    largest: PerSide  # largest |rate| so far that was the end of the range, rad/s; 0 before
    clipped_calibrated: CountPerAxis  # 1 where `_note_flat` found the end of the range, else 0
    passed: PerAxis  # largest |rate| that four samples in a row reached, rad/s
    last_change: PerAxis  # last change of the rate that was not 0, rad/s
    step: PerAxis  # change of the rate with the last sample, rad/s
    step_before: PerAxis  # and with the one before
    flat: CountPerAxis  # samples without noise since the rate has stopped
    clipped: CountPerAxis  # samples at the end, from the third in a row on; 0 if it was none


@kernel
def note_range_end(
    checks: 'SensorChecks', axis: int, rate: float, change: float, same: bool, rest: Rest
) -> bool:
    """Note a rate in rad/s; return whether it is at the end of the range.

    `change` is that since the sample before, or the rate of an axis that has never changed. `same`:
    no axis has changed.
    """
    size, side, ends = abs(rate), _side(rate), checks['range_end']
    earlier, before = ends['step_before'][axis], ends['step'][axis]
    _note_steps(checks, axis, rate, change)
    if size <= CLIPPED_RATE or _is_far_passed(ends, axis, size):
        ends['flat'][axis] = 0
        return False
    if ends['clipped_calibrated'][axis] and size > (1.0 + MIXED) * _largest(ends, axis):
        _forget_range_end(ends, axis)
    if _note_flat(ends, axis, size, before - earlier, deviation_of_values(rest, axis)):
        ends['largest'][side, axis] = max(ends['largest'][side, axis], size)
        ends['clipped_calibrated'][axis] = 1
        ends['clipped'][axis] += 1
        return True
    resolution = checks['resolution'][axis]
    stays = ends['at_limit'][axis] == 1 and change == 0.0
    if not stays and not _is_known_end(ends, axis, size, resolution):
        # Behind a rate that is no number nobody knows whether it stays.
        if same or change != 0.0 or not _may_be_end(ends, axis, rate, resolution):
            return False
        ends['largest'][side, axis] = size
    if checks['equal'][axis] + 1 >= CLIPPED_SAMPLES:
        ends['clipped'][axis] += 1
    return True


@kernel
def _side(rate: float) -> int:
    """Return the side of a rate."""
    return ABOVE if rate > 0.0 else BELOW


@kernel
def _largest(ends: RangeEnd, axis: int) -> float:
    """Return the larger one of the ends of both sides."""
    return float(max(ends['largest'][ABOVE, axis], ends['largest'][BELOW, axis]))


@kernel
def _forget_range_end(ends: RangeEnd, axis: int) -> None:
    """Forget an end of the range that was none, and the samples that were counted there."""
    for side in range(2):
        ends['largest'][side, axis] = 0.0
    ends['clipped_calibrated'][axis] = 0
    ends['clipped'][axis] = 0


@kernel
def _may_be_end(ends: RangeEnd, axis: int, rate: float, resolution: float) -> bool:
    """Return whether a rate in rad/s that stays the same may be the end of the range."""
    side, change = _side(rate), ends['last_change'][axis]
    outward = change if side == ABOVE else -change
    largest = ends['largest'][side, axis]
    return bool(outward > CLIPPED_STEPS * resolution and abs(rate) >= largest - resolution)


@kernel
def _note_steps(checks: 'SensorChecks', axis: int, rate: float, change: float) -> None:
    """Note a rate beside those before it, and by how much it has changed."""
    ends = checks['range_end']
    if change != 0.0 and is_usable(change):
        ends['last_change'][axis] = change
    if abs(rate) > CLIPPED_RATE:
        _note_passed(checks, axis, rate)  # by the steps before this one
    ends['step_before'][axis] = ends['step'][axis]
    ends['step'][axis] = rate - checks['measured'][axis]


@kernel
def _note_passed(checks: 'SensorChecks', axis: int, rate: float) -> None:
    """Note the rate that this sample and the three before it have passed to one side.

    It is not the end of the range: outliers are fewer. An axis that hangs in a turn shows one rate
    for a while, too, but turns on, and faster. Where other axes are mixed in, they move the end of
    the range. Where they are not, no rate is beyond it.
    """
    ends, first = checks['range_end'], checks['measured'][axis]
    second = first - ends['step'][axis]
    third = second - ends['step_before'][axis]
    if not (rate * first > 0.0 and rate * second > 0.0 and rate * third > 0.0):
        return
    slowest = min(min(abs(rate), abs(first)), min(abs(second), abs(third)))
    ends['passed'][axis] = max(ends['passed'][axis], slowest)
    side, largest = _side(rate), ends['largest']
    is_beyond = slowest > largest[side, axis] + checks['resolution'][axis]
    if _is_far_passed(ends, axis, _largest(ends, axis)):
        _forget_range_end(ends, axis)
    elif is_beyond and not ends['clipped_calibrated'][axis]:
        largest[side, axis] = 0.0
        if _largest(ends, axis) == 0.0:
            ends['clipped'][axis] = 0


@kernel
def _is_far_passed(ends: RangeEnd, axis: int, size: float) -> bool:
    """Return whether rates were faster than this size in rad/s, beyond what other axes mix in."""
    return bool((1.0 - MIXED) * ends['passed'][axis] > (1.0 + MIXED) * size)


@kernel
def _note_flat(ends: RangeEnd, axis: int, size: float, change_before: float, noise: float) -> bool:
    """Note a rate; return whether it has stopped in full motion, and its noise with it.

    By `change_before` the two steps before the last one differ; `noise` is the deviation at rest,
    0 while that is not known; all in rad/s.
    """
    step, before, flat = ends['step'][axis], ends['step_before'][axis], ends['flat']
    stays = 0.0 < abs(step) * FLAT_SAMPLES < MIXED * size  # what stays the same is told by that
    if stays and flat[axis] > 0 and abs(step - before) < FLAT * noise:
        flat[axis] += 1
    else:
        stops = noise > 0.0 and abs(before) > CORNER * max(noise, abs(step))
        # A driver that interpolates gives no noise at any time.
        had_noise = abs(change_before) > FLAT * noise
        flat[axis] = 1 if stays and stops and had_noise else 0
    return bool(flat[axis] > FLAT_SAMPLES)


@kernel
def _is_known_end(ends: RangeEnd, axis: int, size: float, resolution: float) -> bool:
    """Return whether rates were stopped at this size before, on any axis, to either side."""
    if ends['clipped_calibrated'][axis]:
        return bool(size >= (1.0 - MIXED) * _largest(ends, axis))
    for other in range(3):
        for side in range(2):
            end = ends['largest'][side, other]
            near = MIXED * end if ends['clipped_calibrated'][other] else resolution
            if ends['clipped'][other] > 0 and end > 0.0 and abs(size - end) <= near:
                return True
    return False
