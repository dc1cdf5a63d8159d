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

"""The acceleration that rest sees: without the reads that failed, and without spikes.

A read that failed gives no number, or one value on all axes: the last acceleration that was
measured stands in for it. Or it gives a wrong value on a single axis, in one measurement. So where
an axis jumps by more than noise does, its last value stands in until the next measurement: what
moves a body lasts, or shows in its rates. Else one wrong value in a hundred would hide every rest,
as a block has a dozen.

An accelerometer that measures less than twice in a block shows no noise in it, or a jump alone. So
what comes later than half a block after the last change is not felt, as if there were no
accelerometer.
"""

from typing import TypedDict

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, kernel, record
from gyro_drift_filter.core.rest.spikes import (
    LARGEST_SIZE,
    SPIKE_COUNTS,
    SPIKE_RATIO,
    USUAL_SAMPLES,
)
from gyro_drift_filter.core.sample import (
    LARGEST_ACCELERATION,
    is_one_value,
    is_zero,
    smallest_change,
)

FINEST_RESOLUTION = 1e-5  # m/s^2, of any accelerometer; less is rounding of a calibration
# A coarse accelerometer at rest may stay the same for long, and then changes by one count.
MORE_THAN_A_COUNT = 1.5
# So many more changes that come late than in time, and an accelerometer is slow: by fewer, the
# delays of messages would make it slow and fast by turns.
LATE_CHANGES = 8


class Force(TypedDict):
    """What an accelerometer has measured, in m/s^2, and what of it rest sees."""

    felt: PerAxis  # what rest sees; 0 before the first
    measured: PerAxis  # the last one that was measured; 0 before the first
    samples_since_change: int  # missing ones and those that are not trusted among them
    doubted: CountPerAxis  # 1 where an axis has jumped with it, and another value stands in
    usual: PerAxis  # change from one measurement to the next
    seen: int  # changes that are in it, up to `USUAL_SAMPLES`
    resolution: PerAxis  # the smallest change; 0 before the first
    late: int  # changes that came late less those that came in time, up to `LATE_CHANGES`
    slow: bool  # so many have come late that nothing is felt until as many more come in time


FORCE = record(Force)


@kernel
def forget_force(force: Force) -> None:
    """Begin with the next acceleration: what came before it is of another time."""
    for axis in range(3):
        force['felt'][axis] = force['measured'][axis] = 0.0
        force['doubted'][axis] = 0


@kernel
def note_force(force: Force, acceleration: PerAxis, longest: int) -> None:
    """Note an acceleration (3,) in m/s^2, and the smallest change of it.

    The next one of an accelerometer that is fast enough comes within `longest` samples. What stays
    for longer is no single wrong measurement. Who has no accelerometer has zeros all the time.
    """
    first, failed = is_zero(force['measured']), is_one_value(acceleration)
    comes_late = False
    if failed or _is_repeat(force, acceleration):
        # Of an accelerometer that measures more slowly than the gyroscope.
        force['samples_since_change'] += 1
        if failed or force['samples_since_change'] < longest or force['late'] > 0:
            return
    else:
        comes_late = not first and _note_pace(force, acceleration, longest)
        if not first and not comes_late:
            force['seen'] = min(force['seen'] + 1, USUAL_SAMPLES)
        force['samples_since_change'] = 0
    for axis in range(3):
        now = acceleration[axis]
        if not abs(now) <= LARGEST_ACCELERATION:
            continue
        if not comes_late:
            changes = not first and force['samples_since_change'] == 0
            jumps = changes and _note_change(force, axis, now)
            force['doubted'][axis] = 1 if jumps and force['doubted'][axis] == 0 else 0
            if force['doubted'][axis] == 0:
                force['felt'][axis] = now
        force['measured'][axis] = now


@kernel
def _is_repeat(force: Force, acceleration: PerAxis) -> bool:
    """Return whether no axis has another value than the last one that was measured."""
    for axis in range(3):
        now = acceleration[axis]
        if abs(now) <= LARGEST_ACCELERATION and now != force['measured'][axis]:
            return False
    return True


@kernel
def _note_pace(force: Force, acceleration: PerAxis, longest: int) -> bool:
    """Note whether an acceleration that has changed comes within `longest` samples of the last.

    Return whether it is not felt, as it comes later, or has done so of late.
    """
    late, changed = force['samples_since_change'] >= longest, False
    for axis in range(3):
        step = abs(acceleration[axis] - force['measured'][axis])
        changed = changed or step > MORE_THAN_A_COUNT * force['resolution'][axis]
    if changed:
        change = 1 if late else -1
        force['late'] = min(max(force['late'] + change, 0), LATE_CHANGES)
        if force['late'] == LATE_CHANGES:
            force['slow'] = True
        elif force['late'] == 0:
            force['slow'] = False
    return force['slow'] or (late and force['late'] > 0)


@kernel
def _note_change(force: Force, axis: int, now: float) -> bool:
    """Note by how much an axis has changed; return whether that is more than noise does."""
    before, usual = force['measured'][axis], force['usual'][axis]
    step, change = abs(now - before), abs(now - force['felt'][axis])
    if before != 0.0 and step > FINEST_RESOLUTION:
        force['resolution'][axis] = smallest_change(force['resolution'][axis], step)
    counted = min(change, LARGEST_SIZE * usual) if usual > 0.0 else change
    force['usual'][axis] += (counted - usual) / force['seen']
    # Nothing is usual for a device that has given one value so far.
    least = max(SPIKE_RATIO * usual, SPIKE_COUNTS * force['resolution'][axis])
    return force['seen'] == USUAL_SAMPLES and usual > 0.0 and change > least
