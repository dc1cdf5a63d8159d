"""The bias, remembered from one run of the node to the next in a small text file.

It stands under ROS_HOME (~/.ros where that is not set), named after node and frame. It is written
whole beside the old one and then renamed, so that a crash or a power cut leaves one or the other.
"""

import json
import math
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from gyro_drift_filter.errors import GyroDriftFilterError, reason

FORMAT = 1
# Older than this it is not taken any more, in s: 30 days.
LONGEST_AGE = 30 * 86_400.0
# A clock may be wrong by this much before a file from the future is refused, in s.
CLOCK_ERROR = 86_400.0
_LONGEST_NAME = 200
LARGEST_FILE = 100_000  # bytes


class MemoryFileError(GyroDriftFilterError):
    """A file can't be used or written; the text says why."""


@dataclass(frozen=True)
class RememberedBias:
    """A bias as it was at the end of a run.

    Attributes:
        bias: (3,) in rad/s.
        deviation: (3,) its standard deviation in rad/s.
        age: Since it was written, in s.
    """

    bias: tuple[float, ...]
    deviation: tuple[float, ...]
    age: float


def file_of(node: str, frame: str) -> Path:
    """Return the path for a node's full name and the frame_id of its gyroscope."""
    home = os.environ.get('ROS_HOME')
    root = Path(home) if home else Path.home() / '.ros'
    name = quote(f'{node.strip("/")} {frame}', safe=' ').replace(' ', '@')[:_LONGEST_NAME]
    return root / 'gyro_drift_filter' / f'{name}.json'


def recall(path: Path, node: str, frame: str, largest: float) -> RememberedBias | None:
    """Return what a file holds, or None where there is none.

    Args:
        path: Of the file.
        node: Full name of the node.
        frame: frame_id of its gyroscope.
        largest: bias.max in rad/s.

    Raises:
        MemoryFileError: The file is damaged, of another node or frame, stale, or its bias beyond
            `largest`.
    """
    try:
        with path.open('rb') as file:
            content = json.loads(file.read(LARGEST_FILE))
        owner = content['format'], content['node'], content['frame']
        bias, deviation = _three(content['bias']), _three(content['deviation'])
        if min(deviation) < 0.0:
            raise ValueError('a deviation is negative')
        age = time.time() - float(content['time'])
    except FileNotFoundError:
        return None
    except OSError as error:
        raise MemoryFileError(f'{path} can not be read: {error.strerror}') from error
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise MemoryFileError(f'{path} is damaged: {reason(error)}') from error
    if owner != (FORMAT, node, frame):
        raise MemoryFileError(f'{path} is of another node, frame or version')
    if not -CLOCK_ERROR <= age <= LONGEST_AGE:
        raise MemoryFileError(f'{path} is from {age / 86_400.0:.1f} days ago')
    if max(map(abs, bias)) > largest:
        raise MemoryFileError(f'{path} holds {list(bias)} rad/s, which is beyond bias.max')
    return RememberedBias(bias, deviation, max(age, 0.0))


def remember(
    path: Path, node: str, frame: str, bias: Sequence[float], deviation: Sequence[float]
) -> None:
    """Write a bias and its standard deviation, (3,) in rad/s each.

    Raises:
        MemoryFileError: The disk does not take it.
    """
    content = {
        'format': FORMAT,
        'node': node,
        'frame': frame,
        'bias': list(bias),
        'deviation': list(deviation),
        'unit': 'rad/s',
        'time': time.time(),
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            'w', dir=path.parent, prefix='.', suffix='.tmp', encoding='utf-8', delete=False
        ) as file:
            try:
                file.write(json.dumps(content, indent=1) + '\n')
                file.flush()
                os.fsync(file.fileno())
                Path(file.name).replace(path)
            except BaseException:
                Path(file.name).unlink(missing_ok=True)
                raise
    except OSError as error:
        raise MemoryFileError(f'{path} can not be written: {error.strerror or error}') from error


def _three(values: object) -> tuple[float, ...]:
    if not isinstance(values, list) or len(values) != 3:
        raise ValueError('not three numbers')
    numbers = tuple(float(value) for value in values)
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError('not finite')
    return numbers
