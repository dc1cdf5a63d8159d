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

"""Whether the sensor has measured since the last message, or a driver polls it faster than that.

A loop that reads the registers at 1,000 Hz sends each measurement of a sensor with 100 Hz ten
times. Such repeats are no samples: their noise looks correlated, and their rates are those of a
body that turns in steps. So where most measurements come behind two repeats or more, a repeat is no
step of the filter, and the sample period is that of the sensor. Up to two messages for each
measurement the methods see all of them, and `adaptive` predicts what was not measured.

A message is a repeat if its rates are the same to the last bit as before, and that far more often
than by chance. A value of a coarse sensor stays the same now and then although others have changed.
All of them together stay by chance about as often as the product of these shares says. The same
holds for the accelerations. If they have changed, a repeat of the rates alone is believed for some
time only: a coarse gyroscope at rest gives the same rates for long.
"""

from enum import IntEnum
from typing import TypedDict

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, kernel, record
from gyro_drift_filter.core.sample import Sample
from gyro_drift_filter.core.sensor_checks import SensorChecks

# Values that are the same are a repeat where that is less likely by chance than this; or, where the
# sensor is polled faster, than this share of how often they are.
BY_CHANCE, OF_THEM_BY_CHANCE = 1e-3, 0.1
# Before anything is known each value stays the same: as if in so many changes. Of so many changes
# the older ones count half.
PRIOR_CHANGES, MEMORY_CHANGES = 1, 128
# From so many changes on rates that always change are known to.
KNOWN_CHANGES = 10
# Of so many measurements, fewer at the start, the share that comes behind so many repeats: the
# sensor is polled faster from the first share on, and below the second one it no longer is.
FIRST_MEASUREMENTS, MEASUREMENTS, REPEATS = 8, 32, 2
FASTER, NOT_FASTER = 0.5, 0.15
# A bus that hangs says nothing of how fast the sensor is polled: no more messages than this count
# for one measurement.
LARGEST_RATIO = 250
# So many repeats in a row beside accelerations that change are none.
LONGEST_RUN = 30


class Message(IntEnum):
    """What a message is."""

    SAMPLE = 0
    REPEAT = 1  # of the last one, as the sensor is polled faster: no sample
    FIRST_SAMPLE = 2  # since repeats are known to be none


class Stays(TypedDict):
    """How often the values of three axes stay the same although others of them have changed."""

    same: int  # messages in which no value has changed
    changes: int  # those in which one has
    stayed: CountPerAxis  # of these, those in which this one has not


STAYS = record(Stays)


class Polling(TypedDict):
    """How often the driver sends a measurement."""

    rates: Stays
    accelerations: Stays
    repeats: int  # messages since the last measurement
    not_measured: int  # all such messages so far
    # of the last measurements
    measurements: int
    window: int  # measurements until the pace is judged
    repeated: int  # of them, those behind at least REPEATS
    messages: int  # that they came in
    faster: bool  # polled so fast that repeats are no samples
    messages_per_sample: float  # then, of late; else 1


POLLING = record(Polling)


@kernel
def start_polling(polling: Polling) -> None:
    """Set a zeroed record up."""
    polling['messages_per_sample'] = 1.0
    polling['window'] = FIRST_MEASUREMENTS


@kernel
def note_message(polling: Polling, checks: SensorChecks, sample: Sample) -> Message:
    """Say what a message is, before `checks` take it in."""
    rate, acceleration = sample['angular_velocity'], sample['linear_acceleration']
    same_rates = _note_stays(polling['rates'], rate, checks['measured'])
    accelerations = polling['accelerations']
    same = _note_stays(accelerations, acceleration, checks['acceleration']) and same_rates
    if same_rates and _is_repeat(polling, checks, same):
        polling['repeats'] += 1
        polling['not_measured'] += 1
        return Message.REPEAT if polling['faster'] else Message.SAMPLE
    repeats = polling['repeats']
    polling['repeats'] = 0
    if polling['rates']['changes'] < KNOWN_CHANGES:
        return Message.SAMPLE  # or a repeat
    polling['measurements'] += 1
    polling['messages'] += min(1 + repeats, LARGEST_RATIO)
    if repeats >= REPEATS:
        polling['repeated'] += 1
    if polling['measurements'] < polling['window']:
        return Message.SAMPLE
    was_faster = polling['faster']
    _judge_pace(polling)
    begins = polling['faster'] and not was_faster
    return Message.FIRST_SAMPLE if begins else Message.SAMPLE


@kernel
def was_not_measured(polling: Polling) -> bool:
    """Return whether the last message was a repeat that the methods bridge.

    Before the pace is known it may be one of a sensor that is polled faster.
    """
    return bool(polling['repeats'] > 0 and polling['window'] > FIRST_MEASUREMENTS)


@kernel
def _is_repeat(polling: Polling, checks: SensorChecks, same: bool) -> bool:
    """Return whether rates that are the same are a repeat; `same`: accelerations are, too."""
    rates, accelerations = polling['rates'], polling['accelerations']
    if not same and polling['repeats'] >= LONGEST_RUN:
        # How they changed in motion says nothing of rest.
        rates['same'] = rates['changes'] = 0
        for axis in range(3):
            rates['stayed'][axis] = 0
        return False
    chance = 1.0
    for axis in range(3):
        # At the end of its range an axis says nothing of whether it was measured again.
        if not checks['at_limit'][axis]:
            chance *= _share_stayed(rates, axis)
        if same:
            chance *= _share_stayed(accelerations, axis)
    limit = BY_CHANCE
    if polling['faster']:
        often = rates['same'] / (rates['same'] + rates['changes'])
        limit = max(limit, OF_THEM_BY_CHANCE * often)
    return chance < limit


@kernel
def _share_stayed(stays: Stays, axis: int) -> float:
    """Return the share of messages in which a value stayed the same, though others changed."""
    return float((PRIOR_CHANGES + stays['stayed'][axis]) / (PRIOR_CHANGES + stays['changes']))


@kernel
def _judge_pace(polling: Polling) -> None:
    """Say by the last measurements whether the sensor is polled faster, and begin to count anew."""
    measurements = polling['measurements']
    share = NOT_FASTER if polling['faster'] else FASTER
    polling['faster'] = polling['repeated'] >= share * measurements
    ratio = polling['messages'] / measurements
    polling['messages_per_sample'] = ratio if polling['faster'] else 1.0
    polling['measurements'] = polling['repeated'] = polling['messages'] = 0
    polling['window'] = min(2 * polling['window'], MEASUREMENTS)


@kernel
def _note_stays(stays: Stays, values: PerAxis, before: PerAxis) -> bool:
    """Compare values with those before; return whether all of them are the same."""
    # NaN, for who has no accelerometer, is the same as NaN.
    x = values[0] == before[0] or (values[0] != values[0] and before[0] != before[0])
    y = values[1] == before[1] or (values[1] != values[1] and before[1] != before[1])
    z = values[2] == before[2] or (values[2] != values[2] and before[2] != before[2])
    if x and y and z:
        stays['same'] = min(stays['same'] + 1, MEMORY_CHANGES * LARGEST_RATIO)
        return True
    stayed = stays['stayed']
    stays['changes'] += 1
    if x:
        stayed[0] += 1
    if y:
        stayed[1] += 1
    if z:
        stayed[2] += 1
    if stays['changes'] >= MEMORY_CHANGES:
        stays['same'] //= 2
        stays['changes'] //= 2
        for axis in range(3):
            stayed[axis] //= 2
    return False
