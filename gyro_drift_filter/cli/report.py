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

"""`gyro_drift report`: one page that shows whether the filter helped, without a network."""

import argparse
import shlex
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from gyro_drift_filter.cli.bag_options import BAG, add_topic_option, distinct_paths
from gyro_drift_filter.cli.filter_options import add_params_option, chosen_parameters
from gyro_drift_filter.cli.packages import needing
from gyro_drift_filter.cli.printing import in_colour
from gyro_drift_filter.cli.progress import Progress, prepare_kernels
from gyro_drift_filter.cli.result_files import (
    add_json_option,
    check_no_pictures,
    check_targets,
    saying,
    verdicts_of,
)
from gyro_drift_filter.cli.time_options import add_time_options, between
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.whole_file import write_whole

if TYPE_CHECKING:
    from gyro_drift_filter.bags.selection import Selection
    from gyro_drift_filter.core import Parameters
    from gyro_drift_filter.report.page import DrawnRecording


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Filter the Imu topic of one or several bags, as replay does, and write one '
        'page with the verdict and figures to zoom in. It holds all that it needs: nothing is '
        'loaded from a network.'
    )
    command.add_argument(
        'bag',
        type=Path,
        nargs='+',
        help=f'{BAG}; a filtered topic in it is compared with what the filter makes of the raw one',
    )
    command.add_argument('-o', '--output', type=Path, required=True, help='HTML file to be made')
    add_params_option(command)
    command.add_argument(
        '--methods',
        nargs='+',
        choices=METHOD_NAMES,
        metavar='METHOD',
        help=f'compare these, of {", ".join(METHOD_NAMES)}; the first one is shown in full',
    )
    add_topic_option(command)
    add_time_options(command)
    add_json_option(command, 'the figures of the verdicts')
    command.add_argument(
        '--png', type=Path, metavar='FOLDER', help='write the figures as PNG files, too'
    )
    command.add_argument('--quiet', action='store_true', help='no progress, no verdict')


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    start, end = between(options)
    names = shortest_names(options.bag)
    check_targets({'--json': options.json}, {'--png': options.png}, page=options.output)
    if options.png and len(names) > 1:
        for name in names:
            check_no_pictures('--png', options.png / name)
    with needing('the report', 'plotly', 'tsdownsample', 'scipy', 'allantools'):
        import allantools  # noqa: F401
        import plotly  # noqa: F401
        import scipy.fft  # noqa: F401
        import tsdownsample  # noqa: F401
    if options.png:
        with needing('--png', 'matplotlib'):
            from gyro_drift_filter.report.pictures import draw
    from gyro_drift_filter.bags.selection import Selection
    from gyro_drift_filter.report.page import page
    from gyro_drift_filter.report.wording import as_text

    parameters = chosen_parameters(options)
    methods = list(dict.fromkeys(options.methods or [parameters.method]))
    wanted = () if options.topic is None else (options.topic,)
    selection = Selection(imu_topics=wanted, start=start, end=end)
    prepare_kernels(quiet=options.quiet)
    recordings = []
    for bag, name in zip(options.bag, names, strict=True):
        all_parameters = [parameters.with_names({'method': method}) for method in methods]
        recordings.append(_recording(bag, name, all_parameters, selection, options))
    texts = [
        f'{recording.name}, {method}\n\n{as_text(verdict, in_colour)}'
        for recording in recordings
        for method, verdict in recording.verdicts.items()
    ]
    text = '' if options.quiet else '\n\n'.join(texts)
    bags = [(bag, r.verdicts.values()) for bag, r in zip(options.bag, recordings, strict=True)]
    with saying(text, options.json, verdicts_of(bags)) as written:
        write_whole(options.output, page(recordings))
        written.append(options.output)
        if options.png:
            several = len(recordings) > 1
            for recording in recordings:
                draw(options.png / recording.name if several else options.png, recording)
            written.append(options.png)


def shortest_names(bags: list[Path]) -> list[str]:
    """Return for each bag as much of the end of its path as tells it from all others.

    Raises:
        GyroDriftFilterError: A bag is named twice.
    """
    paths = distinct_paths(bags)
    parts = 1
    while len({path.parts[-parts:] for path in paths}) < len(paths):
        parts += 1
    return ['/'.join(path.parts[-parts:]).lstrip('/') for path in paths]


def _recording(
    bag: Path,
    name: str,
    parameters: list['Parameters'],
    selection: 'Selection',
    options: argparse.Namespace,
) -> 'DrawnRecording':
    """Return what the page shows of a bag."""
    from gyro_drift_filter.recordings.filtered import filter_recording
    from gyro_drift_filter.report.figures import Drawer
    from gyro_drift_filter.report.page import DrawnRecording, points_for, when_recorded

    with Progress(enabled=not options.quiet) as progress:
        filtered = filter_recording(bag, parameters, selection, progress)
    notes, recorded = [], filtered.recorded
    if recorded is not None and recorded.is_same:
        notes.append('Its own filtered topic is what the filter makes here, bit for bit.')
        recorded = None
    elif recorded is not None:
        notes.append(
            'Its own filtered topic is another one than the filter makes here: it was made with '
            'other parameters, another version, or began elsewhere. Both are drawn.'
        )
    summary = next(iter(filtered.summaries.values()))
    drawer = Drawer(
        filtered.signals,
        summary.start,
        points_for(len(options.bag)),
        None if recorded is None else (recorded.times, recorded.rates),
    )
    facts = [
        ('bag', str(bag)),
        ('topic', f'{summary.topic}, frame {filtered.frame}'),
        when_recorded(summary, drawer.main.watch.period, f' of {filtered.messages}'),
        ('command', shlex.join(['gyro_drift', *sys.argv[1:]])),
        ('made', f'{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC'),
    ]
    return DrawnRecording(name, drawer, filtered.summaries, parameters[0], facts, notes)
