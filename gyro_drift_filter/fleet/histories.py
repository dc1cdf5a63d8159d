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

"""Which bags of a sensor are its history: no copy, and none whose time is not known."""

from collections.abc import Hashable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from gyro_drift_filter.identify.timing import EARLIEST

Row = Mapping[str, Any]
SensorKey = tuple[str, str, str]  # robot, topic, frame

# ns: a file begins before the last one ends by what waits for the disk where a recorder goes on in
# the next file, and by no more.
_SHARED = 10**9
# What the same messages may have in two bags.
_PLACE = {'robot', 'source', 'content'}


def split_histories(rows: Sequence[Row]) -> dict[SensorKey, tuple[list[Row], list[str]]]:
    """Return the rows of each sensor that are its history, and notes on what the others are.

    Args:
        rows: With figures; `robot`, `topic`, `frame_id`, `source`, `content`, `axis`, `start` in ns
            and `duration` in s are among the columns.
    """
    by_sensor: dict[SensorKey, list[Row]] = {}
    robots: dict[Hashable, set[str]] = {}
    for row in rows:
        by_sensor.setdefault((row['robot'], row['topic'], row['frame_id']), []).append(row)
        if row['axis'] == 'x':
            for identity in _identities(row):
                robots.setdefault(identity, set()).add(row['robot'])
    return {key: _split_history(of_sensor, robots) for key, of_sensor in by_sensor.items()}


def _identities(row: Row) -> list[Hashable]:
    """Return keys of a row of a bag: a copy of it has one of them as well."""
    # A replay leaves the raw topic in its output: the same figures of the same time.
    figures = tuple(value for name, value in row.items() if name not in _PLACE)
    content = row['content'], row['topic'], row['frame_id']
    return [figures, content] if row['content'] else [figures]


def _split_history(
    rows: Sequence[Row], robots: Mapping[Hashable, set[str]]
) -> tuple[list[Row], list[str]]:
    """Return the rows of one sensor that are its history, and notes on what the others are."""
    unset, copies, bags = [], [], []
    known: dict[Hashable, Row] = {}
    for bag in sorted((row for row in rows if row['axis'] == 'x'), key=by_time):
        if bag['start'] < EARLIEST * 10**9:
            unset.append(bag)
            continue
        keys = _identities(bag)
        original = next((known[key] for key in keys if key in known), bag)
        known |= dict.fromkeys(keys, original)
        if original is bag:
            bags.append(bag)
        else:
            copies.append((bag, original))
    notes = []
    if unset:
        year = datetime.fromtimestamp(unset[0]['start'] * 1e-9, UTC).year
        why = f'its log times are in {year}: the clock of the recorder was not set'
        notes.append(_not_counted(unset[0], why, len(unset)))
    if copies:
        copy, original = copies[0]
        notes.append(_not_counted(copy, f'it is a copy of {original["source"]}', len(copies)))
    if shared := _shared(bags, robots):
        notes.append(shared)
    if overlap := _overlap(bags):
        one, other = overlap
        notes.append(
            f'{one["source"]} and {other["source"]} were recorded at the same time, which one '
            'sensor can not do: if they are of two robots, let --robot tell these apart; if one '
            'is a part of the other, leave it out'
        )
    sources = {bag['source'] for bag in bags}
    return [row for row in rows if row['source'] in sources], notes


def _shared(bags: Sequence[Row], robots: Mapping[Hashable, set[str]]) -> str:
    """Return a note on bags that another robot has as well; empty where there is none.

    Nothing tells whose they are: a backup may hold all bags of a robot, and a folder of picked bags
    nothing but those of a robot.
    """
    others = [
        set.union(*(robots[key] for key in _identities(bag))) - {bag['robot']} for bag in bags
    ]
    shared = [(bag, min(other)) for bag, other in zip(bags, others, strict=True) if other]
    if not shared:
        return ''
    bag, other = shared[0]
    more = f', and so {"is" if len(shared) == 2 else "are"} {len(shared) - 1} more'
    return (
        f'{bag["source"]} is a bag of robot {other} as well{more if len(shared) > 1 else ""}: '
        'leave out what is no folder of one robot, as a backup'
    )


def by_time(bag: Row) -> tuple[int, str]:
    """Return what bags are sorted by: the start in ns, and the address."""
    return bag['start'], bag['source']


def _not_counted(bag: Row, why: str, count: int) -> str:
    more = f'; nor {"is" if count == 2 else "are"} {count - 1} more' if count > 1 else ''
    return f'{bag["source"]} is not counted, as {why}{more}'


def _overlap(bags: Sequence[Row]) -> tuple[Row, Row] | None:
    """Return two bags of the same time, of bags in the order of their starts."""
    last: Row | None = None
    for bag in bags:
        if last is not None and _end(last) - bag['start'] > _SHARED:
            return last, bag
        last = bag if last is None else max(last, bag, key=_end)
    return None


def _end(bag: Row) -> float:
    end: float = bag['start'] + 1e9 * bag['duration']
    return end
