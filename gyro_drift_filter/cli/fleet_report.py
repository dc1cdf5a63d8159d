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

"""`gyro_drift fleet-report`: one page on a fleet."""

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from gyro_drift_filter.cli.packages import needing_fleet
from gyro_drift_filter.cli.printing import table
from gyro_drift_filter.cli.result_files import add_json_option, as_plain, check_targets, saying
from gyro_drift_filter.errors import printable
from gyro_drift_filter.fleet import REPORTS, TABLE
from gyro_drift_filter.whole_file import write_whole

if TYPE_CHECKING:
    from gyro_drift_filter.fleet.health import Sensor


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Rank the sensors of a fleet by how much they have changed for the worse, and '
        'write one page with their histories. It holds all that it needs: nothing is loaded from '
        'a network.'
    )
    command.add_argument('fleet', type=Path, help='folder that `gyro_drift fleet` has made')
    command.add_argument('-o', '--output', type=Path, required=True, help='HTML file to be made')
    add_json_option(command, 'sensors and changes')


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    check_targets({'--json': options.json}, page=options.output)
    with needing_fleet():
        from gyro_drift_filter.fleet.bag_report import report_path
        from gyro_drift_filter.fleet.columns import failures_in, read_table
        from gyro_drift_filter.fleet.health import judge_fleet
        from gyro_drift_filter.fleet.page import fleet_page
    fleet = read_table(options.fleet / TABLE)
    sensors = judge_fleet(fleet)
    reports, page_folder = options.fleet / REPORTS, options.output.absolute().parent

    def link(bag: Mapping[str, Any]) -> str:
        path = report_path(reports, bag['content'])
        return quote(os.path.relpath(path.absolute(), page_folder)) if path.exists() else ''

    results = {'sensors': [_plain(sensor) for sensor in sensors]}
    with saying(ranking_text(sensors), options.json, results) as written:
        write_whole(options.output, fleet_page(sensors, failures_in(fleet), link))
        written.append(options.output)


def ranking_text(sensors: Sequence['Sensor'], most: int | None = None) -> str:
    """Return as text how many sensors get worse, the worst ones, and what is told of bags."""
    from gyro_drift_filter.fleet.page import describe_changes, headline

    rows = [['robot', 'topic', 'since', 'deviations', 'what has changed']]
    for sensor in sensors[:most]:
        if sensor.certain:
            what, since = describe_changes(sensor)
            robot, topic = printable(sensor.robot), printable(sensor.topic)
            rows.append([robot, topic, since, f'{sensor.size:.1f}', what])
    listed = f'\n\n{table(rows)}' if len(rows) > 1 else ''
    # All topics of a bag have the same.
    notes = list(dict.fromkeys(f'note: {s.robot}: {note}' for s in sensors for note in s.notes))
    if most is not None and len(notes) > most:
        notes[most:] = [f'and {len(notes) - most} more notes, on the page']
    told = ''.join(f'\n{printable(note)}' for note in notes)
    return headline(sensors) + listed + (f'\n{told}' if told else '')


def _plain(sensor: 'Sensor') -> dict[str, Any]:
    return {
        'robot': sensor.robot,
        'topic': sensor.topic,
        'frame_id': sensor.frame,
        'size': sensor.size,
        'bags': len(sensor.bags),
        'notes': sensor.notes,
        'changes': [
            as_plain(change) | {'since': sensor.start_of(change)} for change in sensor.changes
        ],
    }
