"""Walk the message records of an MCAP chunk, and lay out those to be written, in compiled code.

Chunks and records are arrays of bytes. Of records that lie behind each other the index tells, as in
a MESSAGE_INDEX: (n, 2) with the log time in ns and the place of each. Their channels stand apart.
"""

from typing import Any

import numpy as np

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only
from gyro_drift_filter.core.sample import RESULT, SampleStatus
from gyro_drift_filter.messages.cdr import GOOD, NOT_REPORTED
from gyro_drift_filter.messages.imu_kernels import (
    ENCAPSULATION,
    HEADER,
    IMU,
    patch_rate,
    unsigned,
)
from gyro_drift_filter.messages.imu_kernels import ROW as ROW

# Of messages that are filtered together.
BATCH = np.dtype(
    [
        ('row', np.int64),  # behind its last message, where it has ended
        ('first', np.int64),  # log time of the first one in ns
        ('last', np.int64),  # of the last
        ('count', np.int64),  # so far
    ]
)


def place_in_result(field: str) -> int:
    """Return where the bytes of a field begin in a RESULT."""
    assert RESULT.fields is not None
    return RESULT.fields[field][1]


CHANNELS = 2**16  # there may be
_RECORD = 9  # opcode and length
_MESSAGE = 0x05
_MESSAGE_HEADER = 22  # channel, sequence, log time, publish time
_VECTOR_BYTES = 24
RECORD_BYTES = _RECORD + _MESSAGE_HEADER  # of a message, beside its payload


@entry_kernel(read_only(np.uint8), np.bool_, ROW)
def list_messages(data: Any, known: Any, rows: Any) -> int:
    """Fill ROWs for the message records of a chunk; return their number, -1 for a broken chunk.

    `known` tells of each channel whether it counts. `rows` must hold as many as fit: one for 31
    bytes.
    """
    place, count = 0, 0
    while place < len(data):
        if place + _RECORD > len(data):
            return -1
        size = unsigned(data, place + 1, 8, False)
        content = place + _RECORD
        if size < 0 or size > len(data) - content:
            return -1
        if data[place] == _MESSAGE:
            if size < _MESSAGE_HEADER:
                return -1
            row = rows[count]
            row['channel'] = unsigned(data, content, 2, False)
            row['log_time'] = unsigned(data, content + 6, 8, False)
            row['start'] = content + _MESSAGE_HEADER
            row['size'] = size - _MESSAGE_HEADER
            if known[row['channel']]:
                count += 1
        place = content + size
    return count


@entry_kernel(ROW)
def times_of(rows: Any) -> tuple[int, int, bool]:
    """Return the earliest and latest log time of ROWs (n >= 1), and whether they ascend."""
    first = last = before = rows[0]['log_time']
    ascend = True
    for i in range(len(rows)):
        time = rows[i]['log_time']
        first, last = min(first, time), max(last, time)
        ascend = ascend and time >= before
        before = time
    return first, last, ascend


@entry_kernel(ROW, int, int, BATCH, BATCH)
def end_batches(rows: Any, largest: int, span: int, batch: Any, ends: Any) -> int:
    """Cut ROWs in the order of their log times into batches.

    A batch ends before the message that is one more than the largest, or comes `span` ns after its
    first one. The one under way is in `batch`, (1,) BATCH; what ended is written to `ends`, BATCHes
    of which `row` is the place of the message that is not of it any more.

    Returns:
        How many ended.
    """
    now, ended = batch[0], 0
    for i in range(len(rows)):
        time = rows[i]['log_time']
        if now['count'] > 0 and (now['count'] == largest or time - now['first'] >= span):
            now['row'] = i
            ends[ended] = now
            ended += 1
            now['count'] = 0
        if now['count'] == 0:
            now['first'] = time
        now['count'] += 1
        now['last'] = time
    return ended


@entry_kernel(np.int64, (np.uint64, 2), np.int64, (np.uint64, 2), np.uint64)
def group_index(channels: Any, index: Any, places: Any, grouped: Any, times: Any) -> None:
    """Sort the index of messages by their channels, each in its order.

    Args:
        channels: (n,) the channel of each.
        index: (n, 2) unsigned.
        places: Where the next one of each channel goes, by its number; it is moved on.
        grouped: Room for the index.
        times: (2,) earliest and latest log time; they are widened.
    """
    for i in range(len(channels)):
        place = places[channels[i]]
        grouped[place, 0] = index[i, 0]
        grouped[place, 1] = index[i, 1]
        places[channels[i]] = place + 1
        times[0] = min(times[0], index[i, 0])
        times[1] = max(times[1], index[i, 0])


@kernel
def _put(out: Any, place: int, value: int, size: int) -> int:
    """Write a little-endian integer; return the place behind it."""
    to = np.uint64(place)
    for i in range(size):
        out[to + np.uint64(i)] = (value >> (8 * i)) & 0xFF
    return place + size


@kernel
def _begin_record(
    out: Any, place: int, channels: Any, index: Any, count: int, channel: int, time: int, size: int
) -> int:
    """Write a message record up to its payload of `size` bytes, and note where it stands."""
    channels[count] = channel
    index[count, 0] = time
    index[count, 1] = place
    out[place] = _MESSAGE
    place = _put(out, place + 1, _MESSAGE_HEADER + size, 8)
    place = _put(out, place, channel, 2)
    place = _put(out, place, 0, 4)
    place = _put(out, place, time, 8)
    return _put(out, place, time, 8)


@kernel
def _copy(out: Any, place: int, data: Any, start: int, size: int) -> int:
    # Unsigned, as places that might be negative keep compilers from copying words.
    to, source = np.uint64(place), np.uint64(start)
    for i in range(size):
        out[to + np.uint64(i)] = data[source + np.uint64(i)]
    return place + size


@entry_kernel(
    read_only(np.uint8),
    ROW,
    np.int64,
    np.bool_,
    IMU,
    RESULT,
    (np.uint8, 2),
    (np.uint8, np.float64),
    int,
    (np.int64, 2),
    int,
    np.float64,
    int,
    (np.int64, 2),
    read_only(np.uint8),
    np.uint8,
    np.int64,
    (np.int64, 2),
)
def lay_out(
    data: Any,
    rows: Any,
    copies: Any,
    ours: Any,
    imus: Any,
    results: Any,
    raw: Any,
    room: Any,
    channel: int,
    vectors: Any,
    rest_channel: int,
    at_rest: Any,
    report_channel: int,
    reports: Any,
    texts: Any,
    out: Any,
    channels: Any,
    index: Any,
) -> tuple[int, int, int]:
    """Write the records of a stretch of messages and of what the filter makes of them.

    Args:
        data: The chunk.
        rows: Its messages, ROWs in the order of their log times.
        copies: By channel of the input: its channel in the output, 0 for none.
        ours: By channel of the input: whether it is the Imu topic.
        imus: For each message of that, in order: IMU, and where it is good
        results: what the filter made of it, RESULT, and
        raw: the same as bytes.
        room: As of `room_for_doubles`.
        channel: Of the filtered topic.
        vectors: (m, 2) of the topics of every sample: channel, and place of the field in RESULT.
        rest_channel: Of `at_rest`, 0 for none, and
        at_rest: (1,) what was written to it last; -1 before the first.
        report_channel: Of the reports, and
        reports: (k, 3) of them: the row that each stands before, its log time, and where it ends in
        texts: the reports behind each other, bytes.
        out: Room for the records.
        channels: Room for the channel of each.
        index: Room for the index.

    Returns:
        How many bytes and records there are, and how many of these are of the filtered topic.
    """
    place, count, following, written, reported, reported_to = 0, 0, 0, 0, 0, 0
    for i in range(len(rows)):
        while reported < len(reports) and reports[reported, 0] == i:
            time, end = reports[reported, 1], reports[reported, 2]
            size = end - reported_to
            place = _begin_record(out, place, channels, index, count, report_channel, time, size)
            place = _copy(out, place, texts, reported_to, size)
            reported, reported_to, count = reported + 1, end, count + 1
        row = rows[i]
        source, time = row['channel'], row['log_time']
        start, size = row['start'], row['size']
        if copies[source] > 0:
            copy = copies[source]
            place = _begin_record(out, place, channels, index, count, copy, time, size)
            place = _copy(out, place, data, start, size)
            count += 1
        if not ours[source]:
            continue
        k = following
        following += 1
        imu = imus[k]
        if not _is_written(imu, results[k]):
            continue
        place = _begin_record(out, place, channels, index, count, channel, time, size)
        begin = place
        place = _copy(out, place, data, start, size)
        count += 1
        written += 1
        if imu['kind'] != GOOD:
            continue
        patch_rate(out, begin + imu['doubles'], results[k], room, imu['big_endian'])
        for m in range(len(vectors)):
            name = imu['frame_size'] + 1
            padding = -(HEADER + name) % 8
            length = ENCAPSULATION + HEADER + name + padding + _VECTOR_BYTES
            topic = vectors[m, 0]
            place = _begin_record(out, place, channels, index, count, topic, time, length)
            stamp = imu['sample']['stamp']
            place = _put(out, place, 0x0100, 4)  # plain CDR, little endian
            place = _put(out, place, stamp // 1_000_000_000, 4)
            place = _put(out, place, stamp % 1_000_000_000, 4)
            place = _put(out, place, name, 4)
            place = _copy(out, place, data, start + imu['frame'], name - 1)
            place = _put(out, place, 0, 1 + padding)
            for b in range(_VECTOR_BYTES):
                out[place + b] = raw[k, vectors[m, 1] + b]
            place += _VECTOR_BYTES
            count += 1
        if rest_channel > 0 and results[k]['at_rest'] != at_rest[0]:
            at_rest[0] = results[k]['at_rest']
            place = _begin_record(out, place, channels, index, count, rest_channel, time, 5)
            place = _put(out, place, 0x0100, 4)
            place = _put(out, place, 1 if at_rest[0] > 0.0 else 0, 1)
            count += 1
    return place, count, written


@kernel
def _is_written(imu: Any, result: Any) -> bool:
    """Tell whether a message has one on the filtered topic."""
    if imu['kind'] == GOOD:
        return bool(result['status'] != SampleStatus.REFUSED)
    return bool(imu['kind'] == NOT_REPORTED)
