"""Serialize `diagnostic_msgs/msg/DiagnosticArray`: `replay` writes one for each second of a bag."""

import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gyro_drift_filter.core.compiled import compiled

_ENCAPSULATION = b'\x00\x01\x00\x00'


class DiagnosticStatus(NamedTuple):
    """Fields of a `diagnostic_msgs/msg/DiagnosticStatus` that has no hardware_id.

    Attributes:
        level: OK, WARN, ERROR or STALE.
        name: Of the part that it is on.
        message: What is the matter.
        listed: Its values: key and value in turn, each with a zero byte behind it; to make them
            one by one takes much longer.
    """

    level: int
    name: str
    message: str
    listed: str

    @property
    def values(self) -> dict[str, str]:
        """The values by their keys."""
        texts = iter(self.listed.split('\0')[:-1])
        return dict(zip(texts, texts, strict=True))


def diagnostic_array(stamp: int, statuses: Sequence[DiagnosticStatus]) -> bytes:
    """Return a serialized `diagnostic_msgs/msg/DiagnosticArray`, little endian.

    Args:
        stamp: header.stamp in ns; the frame_id is empty.
        statuses: What it holds; there is no zero byte in its texts.
    """
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    texts = ''.join([f'{s.name}\0{s.message}\0\0{s.listed}' for s in statuses])
    joined = np.frombuffer(texts.encode(), np.uint8)
    numbers = np.array([(s.level, s.listed.count('\0') // 2) for s in statuses], np.int64)
    # A length of four bytes is put before each text, and up to three that align it.
    out = np.empty(len(joined) + 7 * texts.count('\0') + 8 * len(statuses), np.uint8)
    size = lay_out_statuses(numbers.reshape(-1, 2), joined, out)
    head = struct.pack('<iIIB3xI', seconds, nanoseconds, 1, 0, len(statuses))
    return _ENCAPSULATION + head + out[:size].tobytes()


@compiled
def lay_out_statuses(numbers: Any, texts: Any, out: Any) -> int:
    """Write DiagnosticStatuses in CDR, from a multiple of four bytes on.

    Args:
        numbers: (n, 2) level and number of values of each.
        texts: Name, message, hardware_id, keys and values, one behind the other, each with a zero
            byte at its end.
        out: Room for them.

    Returns:
        How many bytes they take.
    """
    text = place = 0
    for n in range(len(numbers)):
        out[place] = numbers[n, 0]
        text, place = _put_string(texts, text, out, place + 1)
        text, place = _put_string(texts, text, out, place)
        text, place = _put_string(texts, text, out, place)
        place = _put_number(numbers[n, 1], out, place)
        for _ in range(2 * numbers[n, 1]):
            text, place = _put_string(texts, text, out, place)
    return place


@compiled
def _put_string(texts: Any, begin: int, out: Any, place: int) -> tuple[int, int]:
    """Write the text that begins there; return where the next one begins, and the place behind."""
    end = begin
    while texts[end] != 0:
        end += 1
    end += 1
    place = _put_number(end - begin, out, place)
    for i in range(begin, end):
        out[place] = texts[i]
        place += 1
    return end, place


@compiled
def _put_number(number: int, out: Any, place: int) -> int:
    """Write a number of four bytes at the next multiple of four; return the place behind it."""
    while place % 4 != 0:
        out[place] = 0
        place += 1
    for i in range(4):
        out[place + i] = (number >> (8 * i)) & 0xFF
    return place + 4
