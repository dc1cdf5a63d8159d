"""Walk the message records of an MCAP chunk, and lay out those to be written, in compiled code.

Chunks and records are arrays of bytes.
"""

from typing import Any

import numpy as np

from gyro_drift_filter.bags.cdr import GOOD
from gyro_drift_filter.bags.imu_kernels import ENCAPSULATION, HEADER, RATE, patch, unsigned
from gyro_drift_filter.core.compiled import compiled

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

# Where a message stands: an entry of MessageIndex, with the channel.
ENTRY = np.dtype([('channel', '<u2'), ('log_time', '<u8'), ('offset', '<u8')])

_RECORD = 9  # opcode and length
_MESSAGE = 0x05
_MESSAGE_HEADER = 22  # channel, sequence, log time, publish time
_VECTOR = 3
RECORD_BYTES = _RECORD + _MESSAGE_HEADER  # of a message, beside its payload


@compiled
def list_messages(data: Any, rows: Any) -> int:
    """Fill ROWs for the message records of a chunk; return their number, -1 for a broken chunk.

    `rows` must hold as many as fit: one for 31 bytes.
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
            count += 1
        place = content + size
    return count


@compiled
def _put(out: Any, place: int, value: int, size: int) -> int:
    """Write a little-endian integer; return the place behind it."""
    for i in range(size):
        out[place + i] = (value >> (8 * i)) & 0xFF
    return place + size


@compiled
def _begin_record(out: Any, place: int, entry: Any, channel: int, time: int, size: int) -> int:
    """Write a message record up to its payload of `size` bytes, and note where it stands."""
    entry['channel'] = channel
    entry['log_time'] = time
    entry['offset'] = place
    out[place] = _MESSAGE
    place = _put(out, place + 1, _MESSAGE_HEADER + size, 8)
    place = _put(out, place, channel, 2)
    place = _put(out, place, 0, 4)
    place = _put(out, place, time, 8)
    return _put(out, place, time, 8)


@compiled
def _copy(out: Any, place: int, data: Any, start: int, size: int) -> int:
    for i in range(size):
        out[place + i] = data[start + i]
    return place + size


@compiled
def lay_out(
    data: Any,
    rows: Any,
    copies: Any,
    ours: Any,
    imus: Any,
    written: Any,
    patches: Any,
    channel: int,
    vectors: Any,
    vector_channels: Any,
    rests: Any,
    rest_channel: int,
    out: Any,
    entries: Any,
) -> tuple[int, int]:
    """Write the records of a stretch of messages and of what the filter makes of them.

    Args:
        data: The chunk.
        rows: Its messages, ROWs in the order of their log times.
        copies: By channel of the input: its channel in the output, 0 for none.
        ours: By channel of the input: whether it is the Imu topic.
        imus: For each message of that, in order: IMU,
        written: whether anything is published for it,
        patches: (n, 96) bytes, rate and covariance, 12 little-endian doubles,
        channel: of the filtered topic.
        vectors: (n, m, 24) bytes of the topics of every sample, and
        vector_channels: (m,) theirs.
        rests: Whether rest has changed with the message: 2 to rest, 1 from it, 0 neither.
        rest_channel: Of `at_rest`.
        out: Room for the records.
        entries: Room for an ENTRY of each.

    Returns:
        How many bytes and entries were written.
    """
    place, count, following = 0, 0, 0
    for i in range(len(rows)):
        row = rows[i]
        source, time = row['channel'], row['log_time']
        start, size = row['start'], row['size']
        if copies[source] > 0:
            place = _begin_record(out, place, entries[count], copies[source], time, size)
            place = _copy(out, place, data, start, size)
            count += 1
        if not ours[source]:
            continue
        k = following
        following += 1
        imu = imus[k]
        if not written[k]:
            continue
        place = _begin_record(out, place, entries[count], channel, time, size)
        begin = place
        place = _copy(out, place, data, start, size)
        count += 1
        if imu['kind'] != GOOD:
            continue
        patch(out, begin + imu['doubles'] + 8 * RATE, patches[k], imu['big_endian'])
        for m in range(len(vector_channels)):
            name = imu['frame_size'] + 1
            padding = -(HEADER + name) % 8
            length = ENCAPSULATION + HEADER + name + padding + 8 * _VECTOR
            place = _begin_record(out, place, entries[count], vector_channels[m], time, length)
            place = _put(out, place, 0x0100, 4)  # plain CDR, little endian
            place = _put(out, place, imu['stamp'] // 1_000_000_000, 4)
            place = _put(out, place, imu['stamp'] % 1_000_000_000, 4)
            place = _put(out, place, name, 4)
            place = _copy(out, place, data, start + imu['frame'], name - 1)
            place = _put(out, place, 0, 1 + padding)
            for b in range(8 * _VECTOR):
                out[place + b] = vectors[k, m, b]
            place += 8 * _VECTOR
            count += 1
        if rests[k] > 0:
            place = _begin_record(out, place, entries[count], rest_channel, time, 5)
            place = _put(out, place, 0x0100, 4)
            place = _put(out, place, rests[k] - 1, 1)
            count += 1
    return place, count
