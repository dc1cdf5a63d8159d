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
step of the filter, and the sample period is that of the sensor. With up to two messages for each
measurement the methods get every message, and `adaptive` predicts what was not measured.

A message is a repeat if its rates are the same to the last bit as before, and that far more often
than by chance. A value of a coarse sensor stays the same now and then although others have changed.
All of them together stay by chance about as often as the product of these shares says. The same
holds for the accelerations. If they have changed, a repeat of the rates alone is believed for some
time only: a coarse gyroscope at rest gives the same rates for long.
"""

from enum import IntEnum
from typing import TypedDict

from gyro_drift_filter.accelerate import inlined_kernel, kernel
from gyro_drift_filter.core.sample import Sample, are_equal, is_zero
from gyro_drift_filter.core.sensor_checks import SensorChecks, Stays

# Equal values are a repeat if they are less likely by chance than this; or, while the sensor is
# polled faster, than this share of how often values are equal.
BY_CHANCE, OF_THEM_BY_CHANCE = 1e-3, 0.1
# Before anything is known each value counts as if it had stayed the same in so many changes. After
# so many changes all counts are halved.
PRIOR_CHANGES, MEMORY_CHANGES = 1, 128
# After so many changes it is known how often a value stays the same by chance.
KNOWN_CHANGES = 10
# Of so many measurements, fewer at the start, the share that comes behind so many repeats: the
# sensor is polled faster from the first share on, and below the second one it no longer is.
FIRST_MEASUREMENTS, MEASUREMENTS, REPEATS = 8, 32, 2
FASTER, NOT_FASTER = 0.5, 0.15
# A bus that hangs says nothing of how fast the sensor is polled: no more messages than this count
# for one measurement.
LARGEST_REPEATS = 250
LARGEST_SAME = MEMORY_CHANGES * LARGEST_REPEATS
# So many equal rates in a row, while accelerations change, are no repeats: the body is at rest.
LONGEST_RUN = 30


class Message(IntEnum):
    """What a message is."""

    SAMPLE = 0
    REPEAT = 1  # of the last one, as the sensor is polled faster: no sample
    POLLING_FOUND = 2  # a sample, at which repeats turn out to be none: the sensor is polled faster


class Polling(TypedDict):
    """How often the driver sends a measurement."""

    repeats: int  # messages since the last measurement
    bridged: bool  # the last message is one, and the methods bridge it
    not_measured: int  # all such messages so far
    # of the last measurements
    first: int  # number of the message before them
    window: int  # measurements until the pace is judged
    repeated: int  # of them, those behind at least REPEATS
    extra: int  # repeats behind these measurements, up to LARGEST_REPEATS for each
    hung: int  # repeats beyond that, of a bus that hangs
    faster: bool  # polled so fast that repeats are no samples
    samples_per_message: float  # then, of late; else 1


@kernel
def start_polling(polling: Polling) -> None:
    """Set a zeroed record up."""
    polling['samples_per_message'] = 1.0
    polling['window'] = FIRST_MEASUREMENTS


@kernel
def message_period(polling: Polling, period: float) -> float:
    """Return the time in s from one message to the next, from the sample period in s."""
    return float(period * polling['samples_per_message'])


@inlined_kernel
def note_message(polling: Polling, checks: SensorChecks, sample: Sample, number: int) -> Message:
    """Say what a message of this number is, before `checks` take it in."""
    rate = sample['angular_velocity']
    same = are_equal(rate, checks['measured'])
    if same and not polling['faster'] and is_zero(rate):
        return Message.SAMPLE  # of a driver that takes slow rates for none
    if not (same or polling['faster'] or polling['repeats'] > 0):
        return Message.SAMPLE  # as nearly always
    _age(checks['rates'], number)
    _age(checks['accelerations'], number)
    if same and _is_repeat(polling, checks, sample, number):
        polling['repeats'] += 1
        polling['not_measured'] += 1
        # Before the pace is known it may be one of a sensor that is polled faster.
        known = polling['window'] > FIRST_MEASUREMENTS
        polling['bridged'] = known or _measurements(polling, number) >= FIRST_MEASUREMENTS
        return Message.REPEAT if polling['faster'] else Message.SAMPLE
    return _note_measurement(polling, checks, number)


@kernel
def _note_measurement(polling: Polling, checks: SensorChecks, number: int) -> Message:
    """Note that the message is a measurement, and judge the pace where there are enough of them."""
    repeats = polling['repeats']
    polling['repeats'] = 0
    polling['bridged'] = False
    counted = min(repeats, LARGEST_REPEATS)
    polling['extra'] += counted
    polling['hung'] += repeats - counted
    if repeats >= REPEATS:
        polling['repeated'] += 1
    if _changes(checks['rates'], number) < KNOWN_CHANGES:
        _count_anew(polling, number)  # what came so far may have been repeats
    measurements = _measurements(polling, number)
    if measurements < polling['window']:
        return Message.SAMPLE
    was_faster = polling['faster']
    share = NOT_FASTER if was_faster else FASTER
    faster = polling['repeated'] >= share * measurements
    polling['faster'] = faster
    all_messages = measurements + polling['extra']
    polling['samples_per_message'] = measurements / all_messages if faster else 1.0
    _count_anew(polling, number)
    polling['window'] = min(2 * polling['window'], MEASUREMENTS)
    return Message.POLLING_FOUND if faster and not was_faster else Message.SAMPLE


@kernel
def _count_anew(polling: Polling, number: int) -> None:
    polling['first'] = number
    polling['repeated'] = polling['extra'] = polling['hung'] = 0


@kernel
def _measurements(polling: Polling, number: int) -> int:
    """Return how often the sensor has measured since the pace was judged."""
    repeats = polling['extra'] + polling['hung'] + polling['repeats']
    return int(number - polling['first'] - repeats)


@kernel
def _is_repeat(polling: Polling, checks: SensorChecks, sample: Sample, number: int) -> bool:
    """Return whether rates equal to those of the message before are too unlikely by chance."""
    rates, accelerations = checks['rates'], checks['accelerations']
    acceleration = sample['linear_acceleration']
    x, y, z = acceleration[0], acceleration[1], acceleration[2]
    is_measured = x == x and y == y and z == z
    same = are_equal(acceleration, checks['linear_acceleration'])
    if is_measured and not same and polling['repeats'] >= LONGEST_RUN:
        # How they changed in motion says nothing of rest.
        rates['first'], rates['same'] = number - 1, 0
        for axis in range(3):
            rates['stayed'][axis] = 0
        return False
    chance = 1.0
    for axis in range(3):
        # At the end of its range an axis says nothing of whether it was measured again.
        if not checks['range_end']['at_limit'][axis]:
            chance *= _share_stayed(rates, axis, number)
        if same:
            chance *= _share_stayed(accelerations, axis, number)
    limit = BY_CHANCE
    if polling['faster']:
        limit = max(limit, OF_THEM_BY_CHANCE * rates['same'] / (number - rates['first']))
    return chance < limit


@kernel
def _changes(stays: Stays, number: int) -> int:
    """Return the number of messages in which a value has changed, before that of this number."""
    return int(number - 1 - stays['first'] - stays['same'])


@kernel
def _share_stayed(stays: Stays, axis: int, number: int) -> float:
    """Return the share of the changes in which a value stayed the same although others did not."""
    stayed = stays['stayed'][axis] - stays['same']
    return float((PRIOR_CHANGES + stayed) / (PRIOR_CHANGES + _changes(stays, number)))


@kernel
def _age(stays: Stays, number: int) -> None:
    """Let what is long ago count half as much, and half as much again."""
    while _changes(stays, number) >= MEMORY_CHANGES or stays['same'] > LARGEST_SAME:
        stays['first'] = number - (number - stays['first']) // 2
        stays['same'] //= 2
        for axis in range(3):
            stays['stayed'][axis] //= 2
