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
start. A quantity of it is cut into stretches of one mean each by PELT (Killick, Fearnhead and
Eckley, J. Am. Stat. Assoc. 107 (2012) 1590). The last stretch is compared with the earlier one that
it is furthest from, for the worse: what was and is no more, as before a repair, is no finding.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import ruptures
from numpy.typing import NDArray
from scipy import stats

Floats = NDArray[np.float64]

# A mean and its change can be told from four bags on: two make a stretch, as one odd bag is none.
_STRETCH = 2
LEAST_BAGS = 2 * _STRETCH
# How often chance alone may make a finding in a whole fleet.
_CHANCE = 0.01
# A change within so many deviations of the history is one that happens.
MATTERS = 3.0
# What is known of a scatter from elsewhere is worth so many bags: sensors of a kind differ.
_KNOWN = 8
# White noise goes with the root of the absolute temperature: 30 K change it by a twentieth.
_WARMTH = 0.05
# Deviation of Gaussian noise per median absolute deviation.
_PER_MEDIAN = 1.4826


class Quantity(NamedTuple):
    """What is watched.

    Attributes:
        name: Of the change.
        unit: Of what is shown.
        columns: That it is made of.
        value: Returns of these what is compared, and its own standard deviation.
        shown: Returns of what is compared what is shown.
        both_ways: Whether it may get worse either way.
        of_axes: Whether each axis has its own.
    """

    name: str
    unit: str
    columns: tuple[str, ...]
    value: Callable[..., tuple[float, float]]
    shown: Callable[[float], float]
    both_ways: bool = False
    of_axes: bool = True


def _noise(noise: float, samples: int) -> tuple[float, float]:
    return math.log(noise), math.hypot(_WARMTH, math.sqrt(0.5 / samples))


def _bias(bias: float, deviation: float, instability: float | None) -> tuple[float, float]:
    return bias, math.hypot(deviation, instability or 0.0)


def _share(share: float, samples: int) -> tuple[float, float]:
    """Return the arcsine of a share's root: its deviation by chance is the same for all."""
    return math.asin(math.sqrt(min(share, 1.0))), 0.5 / math.sqrt(samples)


def _gaps(gaps: int, samples: int) -> tuple[float, float]:
    return _share(gaps / samples, samples)


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
    Quantity(
        'outliers',
        '%',
        ('outlier_share', 'messages'),
        _share,
        lambda value: 100.0 * math.sin(value) ** 2,
    ),
    Quantity(
        'gaps',
        '%',
        ('gaps', 'messages'),
        _gaps,
        lambda value: 100.0 * math.sin(value) ** 2,
        of_axes=False,
    ),
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
    """

    robot: str
    topic: str
    frame: str
    bags: list[dict[str, Any]]
    histories: dict[str, dict[str, list[Point]]]
    changes: list[Change]

    @property
    def size(self) -> float:
        """Size of the largest change that matters, 0 where none does."""
        return max((change.size for change in self.changes if change.certain), default=0.0)


def judge_fleet(table: pa.Table) -> list[Sensor]:
    """Return all sensors of a table, those with the largest changes first."""
    needed = {column for quantity in QUANTITIES for column in quantity.columns}
    place = ('robot', 'source', 'content', 'topic', 'frame_id', 'axis', 'start', 'duration')
    rows = table.select([*place, *sorted(needed)]).cast(_with_whole_start(table, place, needed))
    of_sensors: dict[tuple[str, str, str], list[dict[str, Any]]] = {}
    for row in rows.to_pylist():
        if row['axis'] is not None:
            key = row['robot'], row['topic'], row['frame_id']
            of_sensors.setdefault(key, []).append(row)
    series = [
        _Series(key, quantity, axis, of_axis)
        for key, of_sensor in of_sensors.items()
        for quantity in QUANTITIES
        for axis, of_axis in _of_axes(quantity, of_sensor)
    ]
    tests = sum(len(one.values) for one in series)
    # The sensors of a fleet are of a kind: that few days of one agree by chance says little.
    usual = {
        quantity.name: _median(
            usual_scatter(one.values)
            for one in series
            if one.quantity == quantity and len(one.values) >= LEAST_BAGS
        )
        for quantity in QUANTITIES
    }
    found: dict[tuple[str, str, str], list[_Series]] = {}
    for one in series:
        found.setdefault(one.sensor, []).append(one)
    sensors = [
        _sensor(key, of_sensor, found.get(key, []), usual, tests)
        for key, of_sensor in of_sensors.items()
    ]
    return sorted(sensors, key=lambda s: (-s.size, s.robot, s.topic, s.frame))


def _median(values: Iterable[float]) -> float:
    """Return the median, 0 of none."""
    return float(np.median([*values] or [0.0]))


def _with_whole_start(table: pa.Table, place: Sequence[str], needed: Iterable[str]) -> pa.Schema:
    """Return the schema of those columns with the start in ns as a whole number."""
    fields = [table.schema.field(name) for name in (*place, *sorted(needed))]
    return pa.schema([f.with_type(pa.int64()) if f.name == 'start' else f for f in fields])


def _of_axes(
    quantity: Quantity, rows: list[dict[str, Any]]
) -> Iterable[tuple[str, list[dict[str, Any]]]]:
    if not quantity.of_axes:
        return [('', [row for row in rows if row['axis'] == 'x'])]
    return [(axis, [row for row in rows if row['axis'] == axis]) for axis in 'xyz']


class _Series:
    """One quantity of one axis over time."""

    def __init__(
        self,
        sensor: tuple[str, str, str],
        quantity: Quantity,
        axis: str,
        rows: list[dict[str, Any]],
    ) -> None:
        self.sensor, self.quantity, self.axis = sensor, quantity, axis
        usable = [row for row in rows if all(_is_known(row, name) for name in quantity.columns)]
        usable.sort(key=_time)
        self.bags = [_time(row) for row in usable]
        pairs = [quantity.value(*(row[name] for name in quantity.columns)) for row in usable]
        self.values, deviations = np.array(pairs, float).reshape(-1, 2).T
        # What each value is uncertain by, by itself.
        self.own = float(np.sqrt(np.mean(np.square(deviations)))) if pairs else 0.0


def _is_known(row: dict[str, Any], name: str) -> bool:
    value = row[name]
    # A dead axis has no noise to be compared, and an axis without samples none either.
    if name in ('noise', 'noise_samples', 'messages'):
        return value is not None and value > 0
    return value is not None or name in _OPTIONAL


def _time(row: dict[str, Any]) -> tuple[int, str]:
    return row['start'], row['source']


def _sensor(
    key: tuple[str, str, str],
    rows: list[dict[str, Any]],
    series: list[_Series],
    usual: Mapping[str, float],
    tests: int,
) -> Sensor:
    bags = sorted(
        (
            {name: row[name] for name in ('source', 'content', 'start', 'duration')}
            for row in rows
            if row['axis'] == 'x'
        ),
        key=_time,
    )
    index = {_time(bag): k for k, bag in enumerate(bags)}
    histories: dict[str, dict[str, list[Point]]] = {}
    largest: dict[str, Change] = {}
    for one in series:
        where = [index[bag] for bag in one.bags]
        quantity = one.quantity
        points = [
            Point(k, quantity.shown(v)) for k, v in zip(where, one.values.tolist(), strict=True)
        ]
        histories.setdefault(quantity.name, {})[one.axis] = points
        change = find_change(
            one.values, max(one.own, usual[quantity.name]), quantity.both_ways, tests
        )
        if change is None or change.size <= _size_of(largest.get(quantity.name)):
            continue
        largest[quantity.name] = Change(
            quantity.name,
            one.axis,
            where[change.since],
            quantity.shown(change.before),
            quantity.shown(change.after),
            quantity.unit,
            change.size,
            change.certain,
        )
    changes = sorted(largest.values(), key=lambda change: (not change.certain, -change.size))
    return Sensor(*key, bags, histories, changes)


def _size_of(change: Change | None) -> float:
    return 0.0 if change is None else change.size


class Found(NamedTuple):
    """A change in a series: see `Change`."""

    since: int
    before: float
    after: float
    size: float
    certain: bool


def usual_scatter(values: Floats) -> float:
    """Return the deviation of values (n,) from one to the next: a jump and a drift hardly count."""
    steps = np.diff(values)
    return _PER_MEDIAN * float(np.median(np.abs(steps - np.median(steps)))) / math.sqrt(2.0)


def find_change(values: Floats, least: float, both_ways: bool, tests: int) -> Found | None:
    """Return the largest change for the worse between the last stretch of a series and another.

    Args:
        values: (n,) in the order of time.
        least: Scatter that the values have at least, known from elsewhere.
        both_ways: Whether less is worse, too, and not only more.
        tests: Values of all series that are looked at, each of which might be where chance makes a
            change.
    """
    if len(values) < LEAST_BAGS:
        return None
    chance = _CHANCE / tests
    # By chance a split of n values of deviation 1 explains more of their squares once in so often.
    penalty = float(stats.chi2.isf(chance, 1))
    # A linear kernel's cost is that of a change of the mean; it is compiled.
    cut = ruptures.KernelCPD('linear', min_size=_STRETCH)
    scaled = (values / max(least, usual_scatter(values))).reshape(-1, 1)
    edges = [0, *cut.fit(scaled).predict(pen=penalty)]
    stretches = [values[a:b] for a, b in pairwise(edges)]
    if len(stretches) < 2:
        return None
    *history, last = stretches
    # The scatter is that of the history alone: what gets worse may scatter as it does. What is
    # known of it from elsewhere counts as so many bags more.
    free = sum(map(len, history)) - len(history)
    squares = sum(float(np.square(s - s.mean()).sum()) for s in history)
    scatter = max(math.sqrt((squares + _KNOWN * least**2) / (free + _KNOWN)), least)
    differences = [float(last.mean() - s.mean()) for s in history]
    worst = max(
        range(len(differences)), key=lambda k: abs(differences[k]) if both_ways else differences[k]
    )
    difference = abs(differences[worst]) if both_ways else differences[worst]
    if difference <= 0.0:
        return None
    other = history[worst]
    ratio = difference / (scatter * math.sqrt(1.0 / len(last) + 1.0 / len(other)))
    size = difference / scatter
    certain = size > MATTERS and 2.0 * float(stats.t.sf(ratio, free + _KNOWN)) < chance
    return Found(int(edges[worst + 1]), float(other.mean()), float(last.mean()), size, certain)
