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

"""The page of a fleet: which sensors get worse, their histories, and links to reports of bags."""

import html
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.resources import files
from typing import Any

from gyro_drift_filter.errors import printable
from gyro_drift_filter.fleet.changes import LEAST_BAGS
from gyro_drift_filter.fleet.health import FROZEN, QUANTITIES, Change, Sensor
from gyro_drift_filter.phrases import counted
from gyro_drift_filter.report.page import document, table_of, text_of

# Sensors that are drawn: those that get worse come first, and more make a page that none reads.
LARGEST = 300

Link = Callable[[Mapping[str, Any]], str]


def fleet_page(sensors: Sequence[Sensor], failures: Sequence[Mapping[str, Any]], link: Link) -> str:
    """Return the page as HTML; all text that comes from outside is escaped.

    Args:
        sensors: In the order of the ranking.
        failures: As `failures_in` returns them.
        link: Returns the address of the report on a bag, empty where there is none.
    """
    worse = any(sensor.size > 0.0 for sensor in sensors)
    drawn = sensors[:LARGEST]
    bags = len({bag['source'] for s in sensors for bag in s.bags} | {f['source'] for f in failures})
    robots = len({sensor.robot for sensor in sensors})
    body = [
        f'<h1>Fleet: {counted(bags, "bag")} of {counted(robots, "robot")}</h1>',
        '<nav id="bar" aria-label="page"><span><button id="theme"></button></span></nav>',
        f'<p class="headline{" useless" if worse else ""}">{headline(sensors)}</p>',
        '<p>A change is counted in deviations of what the sensor did before, and listed where '
        'chance does not make it. docs/fleet.md says how.</p>',
        _ranking(sensors),
        _failures(failures),
        '<h2>Histories</h2>',
        '<p class="soft">A point is a bag; the dashed line stands where a change begins. A click '
        'on a point opens the report on its bag, where there is one.</p>',
    ]
    if len(sensors) > LARGEST:
        body.append(
            f'<p>The first {LARGEST} of {len(sensors)} sensors; the table has them all.</p>'
        )
    body += [_section(k, sensor, link) for k, sensor in enumerate(drawn)]
    script = files(__package__).joinpath('page.js').read_text(encoding='utf-8')
    data = {'sensors': [_data(sensor, link) for sensor in drawn]}
    return document('gyro_drift fleet', body, data, script)


def headline(sensors: Sequence[Sensor]) -> str:
    """Return in a sentence how many sensors get worse, and how many can not be judged yet."""
    judged = sum(sensor.is_judged for sensor in sensors)
    if not judged:
        return f'No sensor can be judged yet: that takes {LEAST_BAGS} bags of one.'
    worse = sum(sensor.size > 0.0 for sensor in sensors)
    text = 'No sensor gets worse'
    if worse:
        text = f'{worse} of {len(sensors)} sensors {"get" if worse > 1 else "gets"} worse'
    if young := len(sensors) - judged:
        text += f'; {young} of {len(sensors)} can not be judged yet: that takes {LEAST_BAGS} bags'
    return f'{text}.'


def without_figures(failures: Sequence[Mapping[str, Any]]) -> str:
    """Return how many bags there are in failures: one may have several topics that fail."""
    return f'{counted(len({row["source"] for row in failures}), "bag")} without figures'


def describe_change(change: Change) -> str:
    """Return a change in words."""
    axis = f' {change.axis}' if change.axis else ''
    return f'{change.quantity}{axis} {change.before:.3g} to {change.after:.3g} {change.unit}'


def describe_changes(sensor: Sensor) -> tuple[str, str]:
    """Return the changes that are certain in words, and since when the largest one is there."""
    what = '; '.join(map(describe_change, sensor.certain))
    return what, day(sensor.start_of(sensor.certain[0]))


def day(start: int) -> str:
    """Return the day and minute of a log time in ns."""
    return f'{datetime.fromtimestamp(start * 1e-9, UTC):%Y-%m-%d %H:%M}'


def _ranking(sensors: Sequence[Sensor]) -> str:
    rows = []
    for k, sensor in enumerate(sensors):
        if not sensor.certain:
            continue
        what, since = describe_changes(sensor)
        name = text_of(sensor.robot)
        named = f'<a href="#sensor-{k}">{name}</a>' if k < LARGEST else name
        rows.append(
            f'<th scope="row">{k + 1}</th><td>{named}</td><td>{text_of(sensor.topic)}</td>'
            f'<td>{text_of(sensor.frame)}</td><td>{text_of(what)}</td><td>{since}</td>'
            f'<td data-size="{sensor.size!r}">{sensor.size:.1f}</td>'
        )
    if not rows:
        return ''
    head = ('rank', 'robot', 'topic', 'frame', 'what has changed', 'since (UTC)', 'deviations')
    return table_of(head, rows, ' class="words" id="ranking"')


def _failures(failures: Sequence[Mapping[str, Any]]) -> str:
    if not failures:
        return ''
    rows = [
        f'<td>{text_of(row["robot"])}</td><td>{text_of(row["source"])}</td>'
        f'<td>{text_of(row["error"])}</td>'
        for row in failures[:LARGEST]
    ]
    table = table_of(('robot', 'bag', 'why'), rows, ' class="words" id="failures"')
    more = f'<p>The first {LARGEST}.</p>' if len(failures) > LARGEST else ''
    return f'<details><summary>{without_figures(failures)}</summary>{more}{table}</details>'


def _section(number: int, sensor: Sensor, link: Link) -> str:
    name = f'{sensor.robot}, {sensor.topic}, {sensor.frame}'
    said = ''.join(
        f'<p><strong>{text_of(describe_change(c))}</strong> since '
        f'{day(sensor.start_of(c))}: {c.size:.1f} deviations</p>'
        for c in sensor.certain
    )
    said += ''.join(f'<p>Note: {text_of(note)}</p>' for note in sensor.notes)
    head = f'<section id="sensor-{number}"><h3>{text_of(name)}</h3>{said}'
    if not sensor.bags:  # the notes say why
        return f'{head}</section>'
    rows = []
    for bag in reversed(sensor.bags):
        address, source = link(bag), text_of(bag['source'])
        shown = f'<a href="{html.escape(address)}">{source}</a>' if address else source
        rows.append(f'<td>{day(bag["start"])}</td><td>{bag["duration"]:.0f} s</td><td>{shown}</td>')
    columns = ('start (UTC)', 'length', 'bag')
    table = table_of(columns, rows, f' class="words" id="bags-{number}"')
    label = html.escape(f'noise, bias, outliers and gaps of {printable(name)} over time')
    return (
        f'{head}<div class="plot small" data-sensor="{number}" tabindex="0" role="group" '
        f'aria-label="{label}"></div>'
        f'<details><summary>{counted(len(sensor.bags), "bag")}</summary>{table}</details></section>'
    )


def _data(sensor: Sensor, link: Link) -> dict[str, Any]:
    """Return a sensor as the script draws it."""
    since = {c.quantity: c.since for c in sensor.certain}
    return {
        'times': [_plotted(bag['start']) for bag in sensor.bags],
        # The library takes some HTML in what it shows at a point.
        'labels': [text_of(_short(bag['source'])) for bag in sensor.bags],
        'links': [link(bag) for bag in sensor.bags],
        'quantities': [
            {
                'name': quantity.name,
                'unit': quantity.unit,
                'since': since.get(quantity.name),
                'axes': {
                    axis: {
                        'bags': [point.bag for point in points],
                        'values': [float(f'{point.value:.6g}') for point in points],
                    }
                    for axis, points in sensor.histories.get(quantity.name, {}).items()
                },
            }
            for quantity in QUANTITIES
            if quantity.name != FROZEN or FROZEN in since
        ],
    }


def _plotted(start: int) -> str:
    return f'{datetime.fromtimestamp(start * 1e-9, UTC):%Y-%m-%d %H:%M:%S}'


def _short(source: str) -> str:
    """Return the last parts of an address."""
    return '/'.join(source.rstrip('/').split('/')[-2:])
