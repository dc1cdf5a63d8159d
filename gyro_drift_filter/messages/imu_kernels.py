"""Read and patch serialized Imus in compiled code: `cdr.py` byte for byte, and in one call a step.

Messages are stretches of arrays of bytes.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only
from gyro_drift_filter.core.records import FILTER
from gyro_drift_filter.core.sample import RESULT, SAMPLE, SampleStatus
from gyro_drift_filter.core.step import step
from gyro_drift_filter.messages.cdr import GOOD, LARGEST_PADDING, MALFORMED, NOT_REPORTED
from gyro_drift_filter.messages.telemetry import TELEMETRY, read_telemetry

IMU = np.dtype(
    [
        ('kind', np.int64),
        ('sample', SAMPLE),
        ('frame', np.int64),  # place of the frame_id in the payload
        ('frame_size', np.int64),  # of it, without its closing zero
        ('doubles', np.int64),  # place of the 37 doubles in the payload
        ('big_endian', np.bool_),
        ('new_frame', np.bool_),  # the frame_id is not that of the message before
    ],
    align=True,
)

# Of a message in a chunk.
ROW = np.dtype(
    [
        ('log_time', np.int64),  # ns
        ('channel', np.int64),
        ('start', np.int64),  # of its payload
        ('size', np.int64),  # of it
    ],
    align=True,
)


class Tally(NamedTuple):
    """What is told of a stretch of IMUs: how many of a kind, and places of the last ones."""

    malformed: int
    not_reported: int
    frame_changes: int
    last_malformed: int
    last_frame: int


TALLY = np.dtype([(name, np.int64) for name in Tally._fields])

# The frame_id of the last message, without its closing zero: what is longer is cut off.
LONGEST_FRAME = 256
FRAME = np.dtype([('size', np.int64), ('text', np.uint8, (LONGEST_FRAME,))])


def no_frame() -> NDArray[Any]:
    """Return (1,) FRAME before the first message."""
    frame = np.zeros(1, FRAME)
    frame['size'] = -1
    return frame


def room_for_doubles() -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return room for the 37 doubles of a message: as bytes (296,) and as numbers (37,)."""
    doubles = np.zeros(_DOUBLES)
    return doubles.view(np.uint8), doubles


ENCAPSULATION = 4
HEADER = 12  # stamp and length of frame_id
_RATE = 13  # place among the 37 doubles
_DOUBLES = 37
_RATE_COVARIANCE = 16
_ACCELERATION, _ACCELERATION_COVARIANCE = 25, 28
# Rate and covariance, side by side.
_PATCHED = 12

# What `filter_message` tells: there is something to publish; it went through the filter; it is as
# it came, for there is no rate in it; the sensor is at rest; the sample period is another one; so
# is the frame_id.
PUBLISH, FILTERED, PASSED_ON, AT_REST, NEW_FRAME = 1, 2, 4, 8, 32


@kernel
def unsigned(data: Any, place: int, size: int, big_endian: bool) -> int:
    """Return an unsigned integer of up to seven bytes; of eight, from 2**63 on, it is negative."""
    value = np.int64(0)
    for i in range(size):
        byte = data[place + (i if big_endian else size - 1 - i)]
        value = (value << 8) | np.int64(byte)
    return value  # type: ignore[return-value]


@entry_kernel(
    read_only(np.uint8),
    ROW,
    np.bool_,
    (np.uint8, np.float64),
    FRAME,
    IMU,
    np.int64,
)
def read_imus(
    data: Any, rows: Any, ours: Any, room: Any, frame: Any, imus: Any, places: Any
) -> int:
    """Read Imus that stand in a chunk; return how many there are.

    Args:
        data: The chunk.
        rows: Its messages, ROWs of `chunk_kernels`.
        ours: By channel, whether it is of Imus.
        room: As of `room_for_doubles`.
        frame: (1,) FRAME, of the message before.
        imus: Room for them, IMU, zeros.
        places: Room for the place of each in `rows`.
    """
    count = 0
    for i in range(len(rows)):
        if not ours[rows[i]['channel']]:
            continue
        start = rows[i]['start']
        read_one(data, start, rows[i]['size'], room[0], room[1], imus[count])
        imus[count]['new_frame'] = _note_frame(data, start, imus[count], frame[0])
        places[count] = i
        count += 1
    return count


@kernel
def _note_frame(data: Any, start: int, imu: Any, frame: Any) -> bool:
    """Keep the frame_id of a message; return whether it is another one than before."""
    if imu['kind'] == MALFORMED:
        return False
    known, text = frame['size'] >= 0, frame['text']
    changed = frame['size'] != imu['frame_size']
    frame['size'] = imu['frame_size']
    begin = start + imu['frame']
    for i in range(min(imu['frame_size'], LONGEST_FRAME)):
        if text[i] != data[begin + i]:
            changed = True
            text[i] = data[begin + i]
    return bool(known and changed)


@kernel
def _read_doubles(data: Any, place: int, first: int, stop: int, big_endian: bool, raw: Any) -> None:
    """Copy some of the doubles that begin at `place`, from `first` to `stop`, in our byte order."""
    if big_endian:
        for k in range(first, stop):
            for b in range(8):
                raw[8 * k + 7 - b] = data[place + 8 * k + b]
    else:
        # Unsigned, as places that might be negative keep compilers from copying words.
        to, source = np.uint64(8 * first), np.uint64(place + 8 * first)
        for i in range(8 * (stop - first)):
            raw[to + np.uint64(i)] = data[source + np.uint64(i)]


@kernel
def read_one(data: Any, start: int, size: int, raw: Any, numbers: Any, imu: Any) -> None:
    """Read one, as `cdr.read_imu` does."""
    imu['kind'] = MALFORMED
    if size < ENCAPSULATION + HEADER or data[start] != 0 or data[start + 1] > 1:
        return
    big_endian = data[start + 1] == 0
    header = start + ENCAPSULATION
    name = unsigned(data, header + 8, 4, big_endian)
    doubles = ENCAPSULATION + (HEADER + name + 7) // 8 * 8
    surplus = size - doubles - _DOUBLES * 8
    if surplus < 0 or surplus > LARGEST_PADDING:
        return
    if name > 0 and data[header + HEADER + name - 1] != 0:
        return
    nanoseconds = unsigned(data, header + 4, 4, big_endian)
    if nanoseconds >= 1_000_000_000:
        return
    seconds = unsigned(data, header, 4, big_endian)
    if seconds >= 2**31:
        seconds -= 2**32
    _read_doubles(data, start + doubles, _RATE, _RATE_COVARIANCE + 1, big_endian, raw)
    _read_doubles(
        data, start + doubles, _ACCELERATION, _ACCELERATION_COVARIANCE + 1, big_endian, raw
    )
    sample = imu['sample']
    sample['stamp'] = seconds * 1_000_000_000 + nanoseconds
    reported = numbers[_ACCELERATION_COVARIANCE] != -1.0
    for axis in range(3):
        sample['angular_velocity'][axis] = numbers[_RATE + axis]
        acceleration = numbers[_ACCELERATION + axis]
        sample['linear_acceleration'][axis] = acceleration if reported else math.nan
    imu['frame'] = ENCAPSULATION + HEADER
    imu['frame_size'] = max(name - 1, 0)
    imu['doubles'] = doubles
    imu['big_endian'] = big_endian
    imu['kind'] = GOOD if numbers[_RATE_COVARIANCE] != -1.0 else NOT_REPORTED


@entry_kernel(
    int,
    int,
    IMU,
    FILTER,
    RESULT,
    TALLY,
    np.int64,
    TELEMETRY,
    TALLY,
)
def filter_imus(
    first: int,
    stop: int,
    imus: Any,
    filter_: Any,
    results: Any,
    tally: Any,
    marks: Any,
    states: Any,
    tallies: Any,
) -> None:
    """Take IMUs from `first` to `stop` through `step`.

    `results` gets a RESULT for each that is good, `tally` is (1,) TALLY. At each of the `marks`
    (m,), places in `imus` in their order, what the state tells is noted in `states` (m,) TELEMETRY,
    and the tally in `tallies` (m,).
    """
    counted = tally[0]
    state = filter_[0]['state']
    passed = _note_marks(first, marks, 0, state, tally, states, tallies)
    for i in range(first, stop):
        if imus[i]['new_frame']:
            counted['frame_changes'] += 1
            counted['last_frame'] = i
        if imus[i]['kind'] == MALFORMED:
            counted['malformed'] += 1
            counted['last_malformed'] = i
        elif imus[i]['kind'] == NOT_REPORTED:
            counted['not_reported'] += 1
        else:
            step(imus[i]['sample'], filter_[0])
            results[i] = state['result']
        passed = _note_marks(i + 1, marks, passed, state, tally, states, tallies)


@kernel
def _note_marks(
    place: int, marks: Any, passed: int, state: Any, tally: Any, states: Any, tallies: Any
) -> int:
    """Note what is told at the marks that are at a place; return how many are done with."""
    while passed < len(marks) and marks[passed] == place:
        read_telemetry(state, states[passed])
        tallies[passed] = tally[0]
        passed += 1
    return passed


@kernel
def patch_rate(out: Any, doubles: int, result: Any, room: Any, big_endian: bool) -> None:
    """Write rate and diagonal covariance of a RESULT into a message whose 37 doubles begin there.

    `room` is as of `room_for_doubles`.
    """
    raw, numbers = room[0], room[1]
    for k in range(_PATCHED):
        numbers[k] = 0.0
    for axis in range(3):
        numbers[axis] = result['angular_velocity'][axis]
        numbers[3 + 4 * axis] = result['angular_velocity_variance'][axis]
    begin = doubles + 8 * _RATE
    if big_endian:
        for k in range(_PATCHED):
            for b in range(8):
                out[begin + 8 * k + b] = raw[8 * k + 7 - b]
    else:
        to = np.uint64(begin)
        for i in range(8 * _PATCHED):
            out[to + np.uint64(i)] = raw[np.uint64(i)]


@entry_kernel(read_only(np.uint8), np.uint8, (np.uint8, np.float64), FRAME, IMU, FILTER)
def filter_message(
    data: Any,
    out: Any,
    room: Any,
    frame: Any,
    imu: Any,
    filter_: Any,
) -> int:
    """Read one message, take it through `step`, and write it anew: the live path.

    Args:
        data: The message, bytes.
        out: Room for as many.
        room: As of `room_for_doubles`.
        frame: (1,) FRAME, of the message before.
        imu: (1,) IMU, filled.
        filter_: (1,) FILTER.

    Returns:
        Flags; 0 for a malformed message.
    """
    read_one(data, 0, len(data), room[0], room[1], imu[0])
    kind = imu[0]['kind']
    if kind == MALFORMED:
        return 0
    for i in range(len(data)):
        out[i] = data[i]
    flags = NEW_FRAME if _note_frame(data, 0, imu[0], frame[0]) else 0
    if kind == NOT_REPORTED:
        return flags | PUBLISH | PASSED_ON
    flags |= FILTERED
    step(imu[0]['sample'], filter_[0])
    result = filter_[0]['state']['result']
    if result['status'] == SampleStatus.REFUSED:
        return flags
    if result['at_rest'] > 0.0:
        flags |= AT_REST
    patch_rate(out, imu[0]['doubles'], result, room, imu[0]['big_endian'])
    return flags | PUBLISH
