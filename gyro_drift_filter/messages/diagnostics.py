"""Serialize `diagnostic_msgs/msg/DiagnosticArray`: `replay` writes one for each second of a bag."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only


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


def diagnostic_arrays(
    reports: Sequence[tuple[int, Sequence[DiagnosticStatus]]],
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Serialize `diagnostic_msgs/msg/DiagnosticArray`s, little endian.

    Args:
        reports: (n,) header.stamp in ns and statuses of each; the frame_id is empty. There is no
            zero byte in the texts.

    Returns:
        The messages, one behind the other, and (n,) where each ends.
    """
    statuses = [status for _, of_report in reports for status in of_report]
    texts = ''.join([f'{s.name}\0{s.message}\0\0{s.listed}' for s in statuses])
    joined = np.frombuffer(texts.encode(), np.uint8)
    heads = [(*divmod(stamp, 1_000_000_000), len(of_report)) for stamp, of_report in reports]
    numbers = [(s.level, s.listed.count('\0') // 2) for s in statuses]
    # A length of four bytes is put before each text, and up to three that align it.
    room = len(joined) + 7 * texts.count('\0') + 8 * len(statuses) + 24 * len(reports)
    out, ends = np.empty(room, np.uint8), np.empty(len(reports), np.int64)
    lay_out_arrays(
        np.array(heads, np.int64).reshape(-1, 3),
        np.array(numbers, np.int64).reshape(-1, 2),
        joined,
        out,
        ends,
    )
    return out[: ends[-1] if len(ends) else 0], ends


@entry_kernel((np.int64, 2), (np.int64, 2), read_only(np.uint8), np.uint8, np.int64)
def lay_out_arrays(heads: Any, numbers: Any, texts: Any, out: Any, ends: Any) -> None:
    """Write DiagnosticArrays in CDR.

    Args:
        heads: (n, 3) seconds, nanoseconds and number of statuses of each.
        numbers: (m, 2) of all statuses: level, and how many values it has.
        texts: Name, message, hardware_id, keys and values of each, one behind the other, bytes;
            each ends with a zero byte.
        out: Room for them.
        ends: (n,) room for where each ends.
    """
    status = text = place = 0
    for n in range(len(heads)):
        # CDR, little endian; places are aligned as counted from behind that.
        for i in range(4):
            out[place + i] = 1 if i == 1 else 0
        begin = place + 4
        place = _put_number(heads[n, 0], out, begin, begin)
        place = _put_number(heads[n, 1], out, begin, place)
        place = _put_number(1, out, begin, place)  # an empty frame_id
        out[place] = 0
        place = _put_number(heads[n, 2], out, begin, place + 1)
        for _ in range(heads[n, 2]):
            out[place] = numbers[status, 0]
            place += 1
            for _ in range(3):
                text, place = _put_string(texts, text, out, begin, place)
            place = _put_number(numbers[status, 1], out, begin, place)
            for _ in range(2 * numbers[status, 1]):
                text, place = _put_string(texts, text, out, begin, place)
            status += 1
        ends[n] = place


@kernel
def _put_string(texts: Any, first: int, out: Any, begin: int, place: int) -> tuple[int, int]:
    """Write the text that begins there; return where the next one begins, and the place behind."""
    end = first
    while texts[end] != 0:
        end += 1
    end += 1
    place = _put_number(end - first, out, begin, place)
    for i in range(first, end):
        out[place] = texts[i]
        place += 1
    return end, place


@kernel
def _put_number(number: int, out: Any, begin: int, place: int) -> int:
    """Write four bytes at the next multiple of four from `begin` on; return the place behind."""
    while (place - begin) % 4 != 0:
        out[place] = 0
        place += 1
    for i in range(4):
        out[place + i] = (number >> (8 * i)) & 0xFF
    return place + 4
