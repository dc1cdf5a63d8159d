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

"""Replay recordings with two checkouts of this repository, and compare what they write.

    python -m benchmark.compare_outputs BEFORE AFTER BAG... [--tolerance 1e-12]
        [--methods METHOD...]

BEFORE and AFTER are the folders of the checkouts; both run in this Python. Each recording goes
through each method, with and without --diagnostics. Prints a line for each of these cases, and ends
with status 1 where one of them differs. The methods are those of the checkout that this file is in;
--methods leaves out one that only one of the two has.

Without a tolerance messages have to be the same bytes. With one, the numbers of a field may differ
by that share of the largest number that the field takes in the topic, and decimal numbers in texts
by that share of themselves or by one in their last digit; all else has to be the same.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from gyro_drift_filter.core.methods import METHOD_NAMES

# An installed package would fill in for what a folder lacks.
_REPLAY = """
import sys
from gyro_drift_filter.cli.main import main
checkout = sys.argv.pop(1)
status = main(sys.argv[1:])
for name, module in list(sys.modules.items()):
    if name.startswith('gyro_drift_filter.') and not module.__file__.startswith(checkout):
        sys.exit(f'{name} is not of this checkout but of {module.__file__}')
sys.exit(status)
"""
_NUMBER = re.compile(r'(?<![\w.])[-+]?\d+\.?\d*(?:e[-+]?\d+)?(?![\w.])')


@dataclass
class Topic:
    """What a bag holds of a topic.

    Attributes:
        kind: The type of its messages.
        times: Their log times in ns.
        data: The messages, serialized.
        messages: The same, deserialized, where they were asked for.
    """

    kind: str
    times: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)
    messages: list[object] = field(default_factory=list)


def read_bag(bag: Path, deserialized: Sequence[str] = ()) -> dict[str, Topic]:
    """Return all topics of a bag by their names; `deserialized` names those to be deserialized."""
    topics: dict[str, Topic] = {}
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection in reader.connections:
            topics.setdefault(connection.topic, Topic(connection.msgtype))
        for connection, time, data in reader.messages():
            topic = topics[connection.topic]
            topic.times.append(time)
            topic.data.append(bytes(data))
            if connection.topic in deserialized:
                topic.messages.append(reader.deserialize(data, connection.msgtype))
    return topics


def compare_bags(before: Path, after: Path, tolerance: float = 0.0) -> tuple[list[str], float]:
    """Return a line for each topic that differs, and the largest difference that is tolerated."""
    old, new = read_bag(before), read_bag(after)
    lines = [f'{name}: in one of them alone' for name in sorted(old.keys() ^ new.keys())]
    unlike = []
    for name in sorted(old.keys() & new.keys()):
        if old[name].kind != new[name].kind:
            lines.append(f'{name}: {old[name].kind}, then {new[name].kind}')
        elif old[name].times != new[name].times:
            lines.append(
                f'{name}: other log times, {len(old[name].times)} and then '
                f'{len(new[name].times)} messages'
            )
        elif old[name].data != new[name].data:
            unlike.append(name)
    largest = 0.0
    if unlike and tolerance:
        old, new = read_bag(before, unlike), read_bag(after, unlike)
    for name in unlike:
        if tolerance:
            line, difference = compare_messages(old[name].messages, new[name].messages, tolerance)
            largest = max(largest, difference)
        else:
            count = sum(a != b for a, b in zip(old[name].data, new[name].data, strict=True))
            line = f'{count} of {len(old[name].data)} messages are other bytes'
        if line:
            lines.append(f'{name}: {line}')
    return lines, largest


def compare_messages(
    before: Sequence[object], after: Sequence[object], tolerance: float
) -> tuple[str, float]:
    """Return what differs of a topic's messages, empty where nothing does, and by how much."""
    numbers: dict[str, tuple[list[float], list[float]]] = {}
    for k, (old, new) in enumerate(zip(before, after, strict=True)):
        pairs = list(zip(leaves(old), leaves(new), strict=False))
        if len(list(leaves(old))) != len(list(leaves(new))):
            return f'message {k} has other fields', np.inf
        for (name, a), (other, b) in pairs:
            if isinstance(a, float) and isinstance(b, float) and name == other:
                olds, news = numbers.setdefault(name.split('.')[0], ([], []))
                olds.append(a)
                news.append(b)
            elif isinstance(a, str) and isinstance(b, str) and name == other:
                if not is_same_text(a, b, tolerance):
                    return f'message {k}, {name}: {a!r}, then {b!r}', np.inf
            elif (name, a) != (other, b):
                return f'message {k}, {name}: {a!r}, then {b!r}', np.inf
    largest, line = 0.0, ''
    for name, (olds, news) in numbers.items():
        difference = relative_difference(np.array(olds), np.array(news))
        largest = max(largest, difference)
        if difference > tolerance:
            line = f'{name} differs by {difference:.2g} of its largest'
    return line, largest


def relative_difference(before: np.ndarray, after: np.ndarray) -> float:
    """Return the largest difference of two arrays (n,) as a share of the largest number."""
    finite = np.isfinite(before) & np.isfinite(after)
    if not np.array_equal(before[~finite], after[~finite], equal_nan=True):
        return np.inf
    differences = np.abs(before[finite] - after[finite])
    if not differences.any():
        return 0.0
    return float(differences.max() / np.abs(before[finite]).max())


def leaves(value: object, name: str = '') -> Iterator[tuple[str, object]]:
    """Yield the name and value of each number and text of a deserialized message."""
    if is_dataclass(value):
        for part in fields(value):
            if not part.name.startswith('_'):
                yield from leaves(getattr(value, part.name), f'{name}.{part.name}'.lstrip('.'))
    elif isinstance(value, np.ndarray):
        yield from ((name, item) for item in value.tolist())
    elif isinstance(value, list):
        for item in value:
            yield from leaves(item, name)
    else:
        yield name, value


def is_same_text(before: str, after: str, tolerance: float) -> bool:
    """Tell whether two texts differ in nothing but decimal numbers, and these by little."""
    if _NUMBER.sub('#', before) != _NUMBER.sub('#', after):
        return False
    return all(
        a == b or is_same_number(a, b, tolerance)
        for a, b in zip(_NUMBER.findall(before), _NUMBER.findall(after), strict=True)
    )


def is_same_number(before: str, after: str, tolerance: float) -> bool:
    """Tell whether two decimal numbers differ by no more than a rounding; whole ones never do."""
    if all(re.fullmatch(r'[-+]?\d+', text) for text in (before, after)):
        return False
    a, b = float(before), float(after)
    allowed = max(last_digit(before), last_digit(after), tolerance * max(abs(a), abs(b)))
    return abs(a - b) <= 1.001 * allowed


def last_digit(number: str) -> float:
    """Return what one more in the last digit of a decimal number is worth."""
    mantissa, _, exponent = number.partition('e')
    _, _, decimals = mantissa.partition('.')
    return float(10.0 ** (int(exponent or 0) - len(decimals)))


def replay(checkout: Path, bag: Path, out: Path, options: Sequence[str]) -> str:
    """Replay with the package of a checkout; return what it prints but for the path of `out`.

    Raises:
        RuntimeError: It fails.
    """
    command = [sys.executable, '-P', '-c', _REPLAY, str(checkout), 'replay', str(bag)]
    done = subprocess.run(
        [*command, '-o', str(out), *options],
        env=os.environ | {'PYTHONPATH': str(checkout)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        _, _, reason = done.stderr.strip().rpartition('\n')
        raise RuntimeError(f'{checkout}: {reason}')
    return done.stdout.replace(str(out), 'OUT')


def compare_case(
    checkouts: Sequence[Path], bag: Path, options: Sequence[str], tolerance: float
) -> tuple[list[str], float]:
    """Replay a recording with both checkouts; return what differs, and what is tolerated of it."""
    with tempfile.TemporaryDirectory() as folder:
        outs = [Path(folder, name, bag.stem) for name in ('before', 'after')]
        texts = []
        for checkout, out in zip(checkouts, outs, strict=True):
            out.parent.mkdir()
            try:
                texts.append(replay(checkout, bag, out, options))
            except RuntimeError as error:
                return [str(error)], np.inf
        lines, largest = compare_bags(outs[0], outs[1], tolerance)
    before, after = texts
    if before != after and not (tolerance and is_same_text(before, after, tolerance)):
        lines.append('what is printed')
    return lines, largest


def main(arguments: Sequence[str] | None = None) -> int:
    """Compare all cases; return 0 where none differs."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('before', type=Path)
    parser.add_argument('after', type=Path)
    parser.add_argument('bags', type=Path, nargs='+', metavar='bag')
    parser.add_argument('--tolerance', type=float, default=0.0)
    parser.add_argument('--methods', nargs='+', choices=METHOD_NAMES, default=METHOD_NAMES)
    options: Any = parser.parse_args(arguments)
    checkouts = [options.before.resolve(), options.after.resolve()]
    failed = 0
    for bag in options.bags:
        for method in options.methods:
            for more in ([], ['--diagnostics']):
                lines, largest = compare_case(
                    checkouts, bag.resolve(), ['--method', method, *more], options.tolerance
                )
                failed += bool(lines)
                verdict = f'within {largest:.1e}' if largest else 'same'
                verdict = f'DIFFERS: {"; ".join(lines)}' if lines else verdict
                print(' '.join([bag.stem, method, *more, verdict]), flush=True)
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
