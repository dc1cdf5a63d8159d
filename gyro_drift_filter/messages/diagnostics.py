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

"""Serialize `diagnostic_msgs/msg/DiagnosticArray`: `replay` writes one for each second of a bag."""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only
from gyro_drift_filter.accelerate.byte_kernels import put_integer


class Level(IntEnum):
    """Levels of a status, of `diagnostic_msgs/msg/DiagnosticStatus`."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class DiagnosticStatus(NamedTuple):
    """Fields of a `diagnostic_msgs/msg/DiagnosticStatus`.

    Attributes:
        level: How bad it is.
        name: Of the part that it is on.
        message: What is the matter.
        hardware_id: Which gyroscope it is on.
        listed: Its values: key and value in turn, each with a zero byte behind it; to make them
            one by one takes much longer.
    """

    level: Level
    name: str
    message: str
    hardware_id: str
    listed: str

    @property
    def values(self) -> dict[str, str]:
        """The values by their keys."""
        texts = iter(self.listed.split('\0')[:-1])
        return dict(zip(texts, texts, strict=True))


def diagnostic_arrays(
    reports: Sequence[tuple[int, Sequence[DiagnosticStatus]]],
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Serialize `diagnostic_msgs/msg/DiagnosticArray`s, little endian.

    Args:
        reports: (n,) header.stamp in ns and statuses of each; the frame_id is empty. There is no
            zero byte in the texts.

    Returns:
        The messages, one behind the other, and (n,) the offset behind each.
    """
    statuses = [status for _, of_report in reports for status in of_report]
    texts = ''.join([f'{s.name}\0{s.message}\0{s.hardware_id}\0{s.listed}' for s in statuses])
    joined = np.frombuffer(texts.encode(), np.uint8)
    heads = [(*divmod(stamp, 1_000_000_000), len(of_report)) for stamp, of_report in reports]
    numbers = [(int(s.level), s.listed.count('\0') // 2) for s in statuses]
    # A length of four bytes is put before each text, and up to three that align it.
    size = len(joined) + 7 * texts.count('\0') + 8 * len(statuses) + 24 * len(reports)
    out, ends = np.empty(size, np.uint8), np.empty(len(reports), np.int64)
    serialize_arrays(
        np.array(heads, np.int64).reshape(-1, 3),
        np.array(numbers, np.int64).reshape(-1, 2),
        joined,
        out,
        ends,
    )
    return out[: ends[-1] if len(ends) else 0], ends


@entry_kernel((np.int64, 2), (np.int64, 2), read_only(np.uint8), np.uint8, np.int64)
def serialize_arrays(
    heads: NDArray[np.int64],
    numbers: NDArray[np.int64],
    texts: NDArray[np.uint8],
    out: NDArray[np.uint8],
    ends: NDArray[np.int64],
) -> None:
    """Write DiagnosticArrays in CDR.

    Args:
        heads: (n, 3) seconds, nanoseconds and number of statuses of each.
        numbers: (m, 2) of all statuses: level, and how many values it has.
        texts: Name, message, hardware_id, keys and values of each status, one behind the other;
            each ends with a zero byte.
        out: Gets the messages.
        ends: (n,) gets the offset behind each message.
    """
    status = text = offset = 0
    for n in range(len(heads)):
        # CDR, little endian; what follows is aligned as counted from behind that.
        start = put_integer(out, offset, 0x0100, 4)
        offset = _put_number(heads[n, 0], out, start, start)
        offset = _put_number(heads[n, 1], out, start, offset)
        offset = _put_number(1, out, start, offset)  # an empty frame_id
        out[offset] = 0
        offset = _put_number(heads[n, 2], out, start, offset + 1)
        for _ in range(heads[n, 2]):
            out[offset] = numbers[status, 0]
            offset += 1
            for _ in range(3):
                text, offset = _put_string(texts, text, out, start, offset)
            offset = _put_number(numbers[status, 1], out, start, offset)
            for _ in range(2 * numbers[status, 1]):
                text, offset = _put_string(texts, text, out, start, offset)
            status += 1
        ends[n] = offset


@kernel
def _put_string(
    texts: NDArray[np.uint8], first: int, out: NDArray[np.uint8], start: int, offset: int
) -> tuple[int, int]:
    """Write the text at `first`; return where the next one starts, and the offset behind it."""
    offset = _put_number(0, out, start, offset)  # its length, once that is known
    # Copied on the way to its end, as the texts are short.
    text, to = np.uint64(first), np.uint64(offset)
    while texts[text] != 0:
        out[to] = texts[text]
        text, to = text + np.uint64(1), to + np.uint64(1)
    out[to] = 0
    end = int(text) + 1
    put_integer(out, offset - 4, end - first, 4)
    return end, int(to) + 1


@kernel
def _put_number(number: int, out: NDArray[np.uint8], start: int, offset: int) -> int:
    """Write four bytes at the next multiple of four from `start` on; return the offset behind."""
    offset = put_integer(out, offset, 0, -(offset - start) % 4)
    return put_integer(out, offset, number, 4)
