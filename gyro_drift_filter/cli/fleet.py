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

"""`gyro_drift fleet`: many bags, one table."""

import argparse
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from gyro_drift_filter.cli.filter_options import (
    add_method_option,
    add_params_option,
    chosen_parameters,
)
from gyro_drift_filter.cli.fleet_report import ranking_text
from gyro_drift_filter.cli.packages import needing_fleet
from gyro_drift_filter.cli.printing import say, tell
from gyro_drift_filter.cli.progress import Progress, prepare_kernels
from gyro_drift_filter.cli.result_files import check_targets, with_files
from gyro_drift_filter.cli.signals import EndedBySignal
from gyro_drift_filter.errors import GyroDriftFilterError, printable, reason
from gyro_drift_filter.fleet import BAGS, REPORTS, RESULTS, TABLE
from gyro_drift_filter.phrases import counted

if TYPE_CHECKING:
    from gyro_drift_filter.fleet.sources import Bag

_LARGEST_MEMORY = 1e6  # GB: a million, beyond any machine
# Errors and sensors that are told on the terminal; the table has them all.
_TOLD = 10


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Send every bag under folders, patterns and addresses of stores through the '
        'filter, examine and judge it, and write one table of all: a row for each bag, Imu topic '
        'and axis. A bag that fails is a row with its error.'
    )
    command.add_argument(
        'source',
        nargs='+',
        help='folder, bag, pattern with *, or address that fsspec knows, as s3://bucket/robots',
    )
    command.add_argument(
        '-o', '--output', type=Path, required=True, help='folder to be made, with the table'
    )
    add_params_option(command)
    add_method_option(command)
    command.add_argument(
        '--robot',
        metavar='PATTERN',
        help='regular expression whose first group in the address of a bag is the name of its '
        'robot; without it, the name of the folder that holds the bag',
    )
    command.add_argument(
        '--resume',
        action='store_true',
        help='go on where an earlier run into the same folder ended; bags that it has finished are '
        'recognised by their content',
    )
    command.add_argument(
        '--write', action='store_true', help='write the filtered bags into OUTPUT/bags, too'
    )
    command.add_argument(
        '--reports', action='store_true', help='write a report of each bag into OUTPUT/reports, too'
    )
    where = command.add_mutually_exclusive_group()
    where.add_argument(
        '--scheduler', metavar='ADDRESS', help='of a Dask cluster, as tcp://10.0.0.1:8786'
    )
    where.add_argument(
        '--workers', type=int, metavar='N', help='processes on this machine; one for each processor'
    )
    command.add_argument(
        '--memory-limit',
        type=float,
        default=2.0,
        metavar='GB',
        help='of each of these processes, which is restarted if it needs more; default %(default)g',
    )
    command.add_argument('--quiet', action='store_true', help='no progress, no summary')


def run(options: argparse.Namespace) -> int | None:
    """Run the subcommand."""
    with needing_fleet():
        import allantools  # noqa: F401
        import scipy.signal  # noqa: F401

        from gyro_drift_filter.fleet.cluster import cluster_at, local_cluster
        from gyro_drift_filter.fleet.columns import write_table
        from gyro_drift_filter.fleet.measuring import Job
        from gyro_drift_filter.fleet.results import Results
        from gyro_drift_filter.fleet.run import FleetRun
        from gyro_drift_filter.fleet.sources import find_bags
    parameters = chosen_parameters(options)
    output: Path = options.output
    _check(options)
    check_targets({}, others={'-o': output})
    bags = find_bags(options.source, options.robot, output / BAGS)
    job = Job(
        parameters,
        output.absolute() / BAGS if options.write else None,
        output.absolute() / REPORTS if options.reports else None,
    )
    if options.write:
        _check_apart(bags)
    prepare_kernels(quiet=options.quiet)
    workers = options.workers or len(os.sched_getaffinity(0))
    cluster = (
        cluster_at(options.scheduler)
        if options.scheduler
        else local_cluster(workers, int(options.memory_limit * 1e9))
    )
    with cluster as client:
        _make(output)  # not before: where there is no cluster, nothing is left behind
        fleet = FleetRun(bags, job, Results(output / RESULTS, parameters), client)
        try:
            with Progress(enabled=not options.quiet, unit='bags') as progress:
                fleet.run(progress)
        except (KeyboardInterrupt, EndedBySignal) as error:
            kept = (
                'what earlier runs have measured is kept'
                if fleet.kept is None
                else f'{fleet.kept} of {len(bags)} bags are kept'
            )
            tell(f'gyro_drift fleet: interrupted; {kept}: go on with --resume')
            return 130 if isinstance(error, KeyboardInterrupt) else 128 + error.number
    tell_what_is_gone(output / TABLE, bags)
    write_table(output / TABLE, fleet.rows())
    if not options.quiet:
        known = f', {fleet.reused} of them known from before' if fleet.reused else ''
        count = counted(len(bags), 'bag')
        say(with_files(f'{count}{known}\n\n{summary(output)}', [output / TABLE]))
    return None


def _check(options: argparse.Namespace) -> None:
    if options.workers is not None and options.workers < 1:
        raise GyroDriftFilterError(f'--workers must be at least 1, not {options.workers}')
    if not 0.0 < options.memory_limit <= _LARGEST_MEMORY:
        raise GyroDriftFilterError(
            f'--memory-limit must be above 0 and at most {_LARGEST_MEMORY:g} (GB), '
            f'not {options.memory_limit:g}'
        )
    if options.output.exists() and not options.resume:
        raise GyroDriftFilterError(
            f'{options.output} exists already: choose another name, or go on with --resume'
        )


def _check_apart(bags: list['Bag']) -> None:
    """Make sure that each filtered bag has a name of its own."""
    from gyro_drift_filter.fleet.measuring import written_path

    names: dict[Path, str] = {}
    for bag in bags:
        name = written_path(Path(), bag)
        if name in names:
            raise GyroDriftFilterError(
                f'{names[name]} and {bag.source} would both be written to {BAGS}/{name}: write '
                'them in two runs'
            )
        names[name] = bag.source


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GyroDriftFilterError(f'{folder} can not be made: {reason(error)}') from error


def tell_what_is_gone(table: Path, bags: Sequence['Bag']) -> None:
    """Tell how many bags of the table that an earlier run has made are not in the new one."""
    from gyro_drift_filter.fleet.columns import read_table

    if not table.exists():
        return
    with suppress(GyroDriftFilterError):  # it is replaced, whatever it is
        before = set(read_table(table).column('source').to_pylist())
        if gone := before - {bag.source for bag in bags}:
            tell(
                f'note: of the table before, {counted(len(gone), "bag")} will be left out, as not '
                f'named now: {printable(min(gone))}{" and others" if len(gone) > 1 else ""}'
            )


def summary(output: Path) -> str:
    """Return what failed, and which sensors get worse."""
    from gyro_drift_filter.fleet.columns import failures_in, read_table
    from gyro_drift_filter.fleet.health import judge_fleet
    from gyro_drift_filter.fleet.page import without_figures

    table = read_table(output / TABLE)
    ranking = ranking_text(judge_fleet(table), _TOLD)
    if not (failures := failures_in(table)):
        return ranking
    lines = [f'{row["source"]}: {row["error"]}' for row in failures[:_TOLD]]
    if len(failures) > _TOLD:
        lines.append(f'and {len(failures) - _TOLD} more, in the table')
    return '\n'.join([without_figures(failures), *lines, '', ranking])
