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

"""Which sensors get worse: changes in their history that are more than its scatter.

A sensor is an Imu topic with its frame of one robot; its history are the bags in the order of their
start, without copies. The last stretch of a quantity of it is compared with an earlier one: what
was and is no more, as before a repair, is no finding.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from gyro_drift_filter.fleet.changes import LEAST_BAGS, Series, Usual, find_change
from gyro_drift_filter.fleet.histories import Row, SensorKey, by_time, split_histories

# White noise goes with the root of the absolute temperature: 30 K change it by a twentieth.
_WARMTH = 0.05

# What is compared, and its own standard deviation.
Value = tuple[float, float] | None


class Quantity(NamedTuple):
    """What is watched.

    Attributes:
        name: Of the change.
        unit: Of what is shown.
        columns: That it is made of.
        value: Makes of these the value that is compared, with the standard deviation that it has by
            itself; None where there is nothing to compare.
        shown: Makes of a value that is compared the one that is shown.
        both_ways: Whether it may get worse either way.
        of_axes: Whether each axis has its own.
    """

    name: str
    unit: str
    columns: tuple[str, ...]
    value: Callable[..., Value]
    shown: Callable[[float], float]
    both_ways: bool = False
    of_axes: bool = True


def _noise(noise: float, samples: int) -> Value:
    if not (noise > 0.0 and samples):
        return None
    return math.log(noise), math.hypot(_WARMTH, math.sqrt(0.5 / samples))


def _frozen(noise: float, samples: int) -> Value:
    return _share(0.0 if noise else 1.0, samples)


def _bias(bias: float, deviation: float, instability: float | None) -> Value:
    return bias, math.hypot(deviation, instability or 0.0)


def _share(share: float, samples: int) -> Value:
    """Return the arcsine of a share's root: its deviation by chance is the same for all."""
    if not samples:
        return None
    return math.asin(math.sqrt(min(share, 1.0))), 0.5 / math.sqrt(samples)


def _gaps(gaps: int, samples: int) -> Value:
    return _share(gaps / max(samples, 1), samples)


def _percent(value: float) -> float:
    return 100.0 * math.sin(value) ** 2


FROZEN = 'frozen'
QUANTITIES = (
    Quantity(
        'noise',
        'deg/s',
        ('noise', 'noise_samples'),
        _noise,
        lambda value: math.degrees(math.exp(value)),
    ),
    Quantity(
        'bias',
        'deg/s',
        ('bias', 'bias_deviation', 'bias_instability'),
        _bias,
        math.degrees,
        both_ways=True,
    ),
    Quantity('outliers', '%', ('outlier_share', 'messages'), _share, _percent),
    Quantity('gaps', '%', ('gaps', 'messages'), _gaps, _percent, of_axes=False),
    # What is alive has noise: a share of the samples at rest that is all or nothing.
    Quantity(FROZEN, '%', ('noise', 'noise_samples'), _frozen, _percent),
)
# That may be missing.
_OPTIONAL = {'bias_instability'}


@dataclass(frozen=True)
class Change:
    """A change of one quantity.

    Attributes:
        quantity: Its name.
        axis: Empty where it is of all.
        since: Index of the first bag after it.
        before: As it is shown, in its unit.
        after: The same.
        unit: Of both.
        size: Of the change, in deviations of the history.
        certain: Whether chance does not make it.
    """

    quantity: str
    axis: str
    since: int
    before: float
    after: float
    unit: str
    size: float
    certain: bool


@dataclass(frozen=True)
class Point:
    """One bag of a history: the index of the bag, and what is shown in the quantity's unit."""

    bag: int
    value: float


@dataclass(frozen=True)
class Sensor:
    """A sensor with its history.

    Attributes:
        robot: Whose it is.
        topic: Its Imu topic.
        frame: Its frame_id.
        bags: Its bags in the order of their starts: address, content, start, length in s.
        histories: Points by quantity and axis.
        changes: The largest of each quantity, the largest first.
        notes: What of its bags is not in the history, or seems not to be of this sensor.
    """

    robot: str
    topic: str
    frame: str
    bags: list[dict[str, Any]]
    histories: dict[str, dict[str, list[Point]]]
    changes: list[Change]
    notes: list[str]

    @property
    def is_judged(self) -> bool:
        """Whether there are bags enough to tell a change of any quantity."""
        return any(
            len(points) >= LEAST_BAGS
            for of_axes in self.histories.values()
            for points in of_axes.values()
        )

    @property
    def certain(self) -> list[Change]:
        """The changes that chance does not make, the largest first."""
        return [change for change in self.changes if change.certain]

    @property
    def size(self) -> float:
        """Size of the largest change that matters, 0 where none does."""
        return max((change.size for change in self.certain), default=0.0)

    def start_of(self, change: Change) -> int:
        """Return the log time in ns at which the first bag after a change begins."""
        return int(self.bags[change.since]['start'])


def judge_fleet(table: pa.Table) -> list[Sensor]:
    """Return all sensors of a table, those with the largest changes first."""
    needed = {column for quantity in QUANTITIES for column in quantity.columns}
    place = ('robot', 'source', 'content', 'topic', 'frame_id', 'axis', 'start', 'duration')
    rows = table.select([*place, *sorted(needed)])
    starts = rows['start'].cast(pa.int64())  # in ns, of which datetime would lose digits
    rows = rows.set_column(place.index('start'), 'start', starts)
    of_sensors = split_histories([row for row in rows.to_pylist() if row['axis'] is not None])
    histories = [
        _History(key, quantity, axis, of_axis)
        for key, (of_sensor, _) in of_sensors.items()
        for quantity in QUANTITIES
        for axis, of_axis in _of_axes(quantity, of_sensor)
    ]
    tests = sum(len(one.bags) for one in histories)
    # The sensors of a fleet are of a kind: what few days of one say by chance is little.
    usual = {
        quantity.name: Usual([one.series for one in histories if one.quantity == quantity])
        for quantity in QUANTITIES
    }
    found: dict[SensorKey, list[_History]] = {}
    for one in histories:
        found.setdefault(one.sensor, []).append(one)
    sensors = [
        _sensor(key, history, found.get(key, []), usual, tests)
        for key, history in of_sensors.items()
    ]
    return sorted(sensors, key=lambda s: (-s.size, s.robot, s.topic, s.frame))


def _of_axes(quantity: Quantity, rows: Sequence[Row]) -> Iterable[tuple[str, Sequence[Row]]]:
    if not quantity.of_axes:
        return [('', [row for row in rows if row['axis'] == 'x'])]
    return [(axis, [row for row in rows if row['axis'] == axis]) for axis in 'xyz']


class _History:
    """One quantity of one axis over time."""

    def __init__(
        self,
        sensor: SensorKey,
        quantity: Quantity,
        axis: str,
        rows: Sequence[Row],
    ) -> None:
        self.sensor, self.quantity, self.axis = sensor, quantity, axis
        values = [
            (by_time(row), value) for row in rows if (value := _value(row, quantity)) is not None
        ]
        values.sort()
        self.bags = [bag for bag, _ in values]
        compared, deviations = np.array([value for _, value in values]).reshape(-1, 2).T
        own = float(np.sqrt(np.mean(np.square(deviations)))) if values else 0.0
        self.series = Series(sensor[0], compared, own)


def _value(row: Row, quantity: Quantity) -> Value:
    if any(row[name] is None for name in quantity.columns if name not in _OPTIONAL):
        return None
    return quantity.value(*(row[name] for name in quantity.columns))


def _sensor(
    key: SensorKey,
    history: tuple[Sequence[Row], list[str]],
    of_sensor: list[_History],
    usual: Mapping[str, Usual],
    tests: int,
) -> Sensor:
    rows, notes = history
    bags = sorted(
        (
            {name: row[name] for name in ('source', 'content', 'start', 'duration')}
            for row in rows
            if row['axis'] == 'x'
        ),
        key=by_time,
    )
    index = {by_time(bag): k for k, bag in enumerate(bags)}
    histories: dict[str, dict[str, list[Point]]] = {}
    largest: dict[str, Change] = {}
    for one in of_sensor:
        where = [index[bag] for bag in one.bags]
        quantity, values = one.quantity, one.series.values.tolist()
        points = [Point(k, quantity.shown(v)) for k, v in zip(where, values, strict=True)]
        histories.setdefault(quantity.name, {})[one.axis] = points
        found = find_change(one.series, usual[quantity.name], tests, both_ways=quantity.both_ways)
        if found is None:
            continue
        change = Change(
            quantity.name,
            one.axis,
            where[found.since],
            quantity.shown(found.before),
            quantity.shown(found.after),
            quantity.unit,
            found.size,
            found.certain,
        )
        largest[quantity.name] = min(largest.get(quantity.name, change), change, key=_rank)
    return Sensor(*key, bags, histories, sorted(largest.values(), key=_rank), notes)


def _rank(change: Change) -> tuple[bool, float]:
    """Return what sorts the changes that are certain before all others, the largest first."""
    return not change.certain, -change.size
