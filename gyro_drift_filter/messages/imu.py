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

"""A serialized `sensor_msgs/msg/Imu`: its fields, its faults, and another rate put into it.

ROS 2 sends messages in the plain CDR encoding (OMG DDSI-RTPS, section 10; XCDR version 1): four
bytes that name the encoding, then the fields in order, each aligned to its own size counted from
behind those four bytes. After the header of an Imu come 37 doubles:

    orientation 4, its covariance 9, angular velocity 3, its covariance 9,
    linear acceleration 3, its covariance 9

Their offset depends on the length of the frame name alone, so nothing has to be deserialized.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only, record
from gyro_drift_filter.accelerate.byte_kernels import double, put_double, unsigned
from gyro_drift_filter.core.sample import Result, Sample, SampleStatus

IMU_TYPE = 'sensor_msgs/msg/Imu'

ENCAPSULATION = 4  # bytes that name the encoding
HEADER = 12  # bytes of the stamp and of the length of the frame_id
DOUBLES = 37
# Indexes among the doubles.
ORIENTATION_COVARIANCE = 4
RATE, RATE_COVARIANCE = 13, 16
ACCELERATION, ACCELERATION_COVARIANCE = 25, 28
# Writers may pad a message to a multiple of their word.
_LARGEST_PADDING = 7

# A serialized Imu of zeros, with an empty frame_id.
EXAMPLE = b'\x00\x01\x00\x00' + bytes(HEADER + 4 + DOUBLES * 8)


class ImuKind(IntEnum):
    """What a message on the Imu topic is."""

    GOOD = 0
    NOT_REPORTED = 1  # its covariance starts with -1 (REP-145): the sensor has no gyroscope
    MALFORMED = 2
    OWN_OUTPUT = 3  # the filter's own output, which some other node has sent to its input


class FaultReason(IntEnum):
    """Why a message is malformed."""

    TOO_SHORT = 0
    ENCODING = 1
    LENGTH = 2
    FRAME_ID = 3
    NANOSECONDS = 4


class Fault(TypedDict):
    """Why a message is malformed; `fault_text` words it."""

    reason: int  # a FaultReason
    size: int  # of the message in bytes
    value: int  # what is wrong: the encoding, the length of the frame_id, the nanoseconds
    expected: int  # bytes, by the length of the frame_id


class Imu(TypedDict):
    """A message on the Imu topic, and what the filter made of it.

    Offsets count from the start of the message. Of a malformed one only the first five are set.
    """

    kind: int  # an ImuKind
    row: int  # its index among the messages of all topics
    topic: int  # index of its topic among those that are filtered
    start: int  # its offset in the data that it stands in
    fault: Fault
    frame_id: int  # offset of header.frame_id
    frame_id_size: int  # without its closing zero byte
    doubles: int  # offset of the 37 doubles
    big_endian: bool
    sample: Sample
    result: Result  # where the message is good


IMU = record(Imu)


@kernel
def read_imu(data: NDArray[np.uint8], start: int, size: int, imu: Imu) -> None:
    """Read the message of `size` bytes that starts in the data there."""
    fault = imu['fault']
    fault['size'], fault['value'], fault['expected'] = size, 0, 0
    imu['start'], imu['kind'] = start, ImuKind.MALFORMED
    if size < ENCAPSULATION + HEADER:
        fault['reason'] = FaultReason.TOO_SHORT
        return
    encoding = unsigned(data, start, 2, True)
    if encoding > 1:
        fault['reason'], fault['value'] = FaultReason.ENCODING, encoding
        return
    big_endian, header = encoding == 0, start + ENCAPSULATION
    name = unsigned(data, header + 8, 4, big_endian)
    doubles = ENCAPSULATION + (HEADER + name + 7) // 8 * 8
    surplus = size - doubles - DOUBLES * 8
    if surplus < 0 or surplus > _LARGEST_PADDING:
        fault['reason'], fault['value'] = FaultReason.LENGTH, name
        fault['expected'] = size - surplus
        return
    if name > 0 and data[header + HEADER + name - 1] != 0:
        fault['reason'] = FaultReason.FRAME_ID
        return
    nanoseconds = unsigned(data, header + 4, 4, big_endian)
    if nanoseconds >= 1_000_000_000:
        fault['reason'], fault['value'] = FaultReason.NANOSECONDS, nanoseconds
        return
    seconds = unsigned(data, header, 4, big_endian)
    if seconds >= 2**31:
        seconds -= 2**32
    sample, first = imu['sample'], start + doubles
    sample['stamp'] = seconds * 1_000_000_000 + nanoseconds
    covariance = double(data, first + 8 * ACCELERATION_COVARIANCE, big_endian)
    for axis in range(3):
        rate = double(data, first + 8 * (RATE + axis), big_endian)
        acceleration = double(data, first + 8 * (ACCELERATION + axis), big_endian)
        sample['angular_velocity'][axis] = rate
        sample['linear_acceleration'][axis] = acceleration if covariance != -1.0 else math.nan
    imu['frame_id'] = ENCAPSULATION + HEADER
    imu['frame_id_size'] = max(name - 1, 0)
    imu['doubles'] = doubles
    imu['big_endian'] = big_endian
    reported = double(data, first + 8 * RATE_COVARIANCE, big_endian) != -1.0
    imu['kind'] = ImuKind.GOOD if reported else ImuKind.NOT_REPORTED


@kernel
def is_published(imu: Imu) -> bool:
    """Tell whether a message that went through the filter has one on the filtered topic."""
    if imu['kind'] == ImuKind.GOOD:
        return bool(imu['result']['status'] != SampleStatus.REFUSED)
    return bool(imu['kind'] == ImuKind.NOT_REPORTED)


@kernel
def rate_variance(data: NDArray[np.uint8], imu: Imu, axis: int) -> float:
    """Return the variance of a rate that the message itself states, in (rad/s)^2."""
    offset = imu['start'] + imu['doubles'] + 8 * (RATE_COVARIANCE + 4 * axis)
    return double(data, offset, imu['big_endian'])


@kernel
def patch_imu(data: NDArray[np.uint8], start: int, imu: Imu) -> None:
    """Write rate and covariance of the result into the message that starts there."""
    result, big_endian = imu['result'], imu['big_endian']
    offset = start + imu['doubles'] + 8 * RATE
    for axis in range(3):
        offset = put_double(data, offset, result['angular_velocity'][axis], big_endian)
    for row in range(3):
        for column in range(3):
            if row == column:
                value = result['angular_velocity_variance'][row]
            else:  # of the pairs xy, xz, yz that of two axes has the index of their sum less one
                value = result['angular_velocity_covariance'][row + column - 1]
            offset = put_double(data, offset, value, big_endian)


@entry_kernel(read_only(np.uint8), IMU)
def read_alone(data: NDArray[np.uint8], imus: Sequence[Imu]) -> None:
    """Read the message that all of the data is into (1,) IMU."""
    read_imu(data, 0, len(data), imus[0])


def read_message(message: bytes) -> Any:
    """Return a record of IMU of one serialized message."""
    imus: Any = np.zeros(1, IMU)
    read_alone(np.frombuffer(message, np.uint8), imus)
    return imus[0]


def frame_id(message: bytes, imu: Any) -> str:
    """Return header.frame_id of a message that is not malformed; its record was read from it."""
    start = int(imu['frame_id'])
    return message[start : start + int(imu['frame_id_size'])].decode('utf-8', 'replace')


def frame_of(message: bytes) -> str | None:
    """Return header.frame_id of a serialized message, None where it is not one with rates."""
    imu = read_message(message)
    return frame_id(message, imu) if imu['kind'] == ImuKind.GOOD else None


def are_filtered(imus: Any) -> NDArray[np.bool_]:
    """Return which messages (n,) IMU are samples that a filter has taken as new ones."""
    good = imus['kind'] == ImuKind.GOOD
    return np.asarray(good & (imus['result']['status'] == SampleStatus.FILTERED))


def fault_text(fault: Fault) -> str:
    """Return in words why a message is malformed."""
    size, value = fault['size'], fault['value']
    match fault['reason']:
        case FaultReason.TOO_SHORT:
            return f'{size} bytes are too few for a message header'
        case FaultReason.ENCODING:
            return f'encoding 0x{value:04x} is not plain CDR'
        case FaultReason.LENGTH:
            return (
                f'{size} bytes are not the length of an Imu with a frame_id of {value} bytes '
                f'({fault["expected"]})'
            )
        case FaultReason.FRAME_ID:
            return 'frame_id does not end with a zero byte'
    return f'header.stamp.nanosec {value} is a second or more'


def all_doubles(data: NDArray[np.uint8], imus: Any) -> NDArray[np.float64]:
    """Return the 37 doubles of messages (n,) IMU that stand in the data, none malformed: (n, 37).

    In their order: orientation x, y, z, w and its covariance, rate and covariance, acceleration and
    covariance.
    """
    places = (imus['start'] + imus['doubles'])[:, None] + np.arange(8 * DOUBLES)
    raw = data[places]
    doubles = raw.view('<f8').astype(np.float64)
    big = imus['big_endian']
    doubles[big] = raw[big].view('>f8')
    return np.asarray(doubles)
