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

"""Fleets: planted faults found, workers side by side, the scheduler's share, interrupted runs.

    python -m benchmark.fleet [--only faults others tables speed scheduler memory interrupted]
                              [--json FILE] [--bags N] [--seeds N ...] [--fleets N]

Bags are simulated, of one minute at 100 Hz. Workers are timed in turns, and the best of three
counts, as other work on the machine only ever adds. Ends with status 1 where a bar does not hold.
"""

import argparse
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from distributed import Client

from benchmark.figures import Figure, tell_figures
from benchmark.fleet_tables import FAULTS, GETTING_WORSE, WORLDS, World, draw_fleet
from gyro_drift_filter.cli.printing import tell
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.fleet.cluster import local_cluster
from gyro_drift_filter.fleet.columns import read_table
from gyro_drift_filter.fleet.health import judge_fleet
from gyro_drift_filter.fleet.measuring import Job, measure
from gyro_drift_filter.fleet.results import Results
from gyro_drift_filter.fleet.run import FleetRun
from gyro_drift_filter.fleet.sources import Bag, find_bags
from harness.fleet_recordings import Fault, FleetSettings, robot_name, write_fleet

_ROUNDS = 3
_LIMIT = 2 * 10**9  # bytes of a worker
_INTERRUPTIONS = 10
_JOB = Job(Parameters())
_COMMAND = [sys.executable, '-m', 'gyro_drift_filter.cli.main', 'fleet', '--quiet']


def _run(bags: list[Bag], client: Client) -> float:
    """Measure bags; return the seconds that it took."""
    with tempfile.TemporaryDirectory() as folder:
        fleet = FleetRun(bags, _JOB, Results(Path(folder), Parameters()), client)
        start = time.monotonic()
        fleet.run(lambda done, total: None)
        return time.monotonic() - start


def faults(folder: Path, seed: int) -> Iterator[Figure]:
    """Measure 200 bags of 20 robots, three of which get worse, and one bag in ten broken."""
    yield from _planted(folder, FleetSettings(seed=seed))


def others(folder: Path, seed: int) -> Iterator[Figure]:
    """Measure the same with four other faults, which come slowly or leave nothing to measure."""
    planted = {2: Fault.DRIFT, 6: Fault.WEAR, 11: Fault.GAPS, 17: Fault.FROZEN}
    yield from _planted(folder, FleetSettings(faults=planted, seed=seed))


def _planted(folder: Path, settings: FleetSettings) -> Iterator[Figure]:
    broken = write_fleet(folder / 'robots', settings)
    out = folder / 'out'
    subprocess.run([*_COMMAND, str(folder / 'robots'), '-o', str(out)], check=True)
    fleet = read_table(out / 'fleet.parquet')
    sensors = judge_fleet(fleet)
    planted = {robot_name(number): fault.quantity for number, fault in settings.faults.items()}
    named = {sensor.robot: sensor.changes[0] for sensor in sensors if sensor.size}
    for robot, change in named.items():
        tell(f'seed {settings.seed}, {robot}: {change.quantity} by {change.size:.1f} deviations')
    first = {sensor.robot for sensor in sensors[: len(planted)]}
    found = sum(
        robot in first and robot in named and named[robot].quantity == quantity
        for robot, quantity in planted.items()
    )
    title = f'planted faults that rank first, seed {settings.seed}'
    yield Figure.of_ratio(title, '{}', (found, len(planted)), 'planted', 1.0, at_least=True)
    beside, sound = len(named.keys() - planted.keys()), settings.robots - len(planted)
    yield Figure('other sensors that are named', f'{beside}', '0', f'of {sound}', beside, 0.0)
    failed = {row['source'] for row in fleet.to_pylist() if row['error']}
    explained = len(failed & {str(bag) for bag in broken})
    numbers = explained, len(broken)
    yield Figure.of_ratio('broken bags with a reason', '{}', numbers, 'broken', 1.0, at_least=True)


def tables(_: Path, count: int) -> Iterator[Figure]:
    """Judge tables of fleets that are drawn: what chance makes, and which faults are found."""
    for name, world in WORLDS.items():
        fleets = [judge_fleet(draw_fleet(world, seed)) for seed in range(count)]
        named = sum(any(sensor.size for sensor in fleet) for fleet in fleets)
        title = f'fleets with a false finding: {name}'
        yield Figure(title, f'{named}', '0', f'of {count}', named / count, 0.05)
    for planted in FAULTS:
        found = [
            any(change.certain and change.quantity == planted.quantity for change in sensor.changes)
            for seed in range(count // 10)
            for sensor in judge_fleet(draw_fleet(World(), seed, planted))
            if int(sensor.robot) < GETTING_WORSE
        ]
        tell(f'{planted}: {100.0 * sum(found) / len(found):.0f} % of {len(found)} found')


def speed(folder: Path) -> Iterator[Figure]:
    """Time one and two workers in turns."""
    write_fleet(folder / 'robots', FleetSettings(3, 10, faults={}, broken_every=0))
    bags = find_bags([str(folder / 'robots')], None)
    times: dict[int, list[float]] = {1: [], 2: []}
    costs: dict[int, list[float]] = {1: [], 2: []}
    counts: dict[int, list[int]] = {1: [], 2: []}
    for _ in range(_ROUNDS):
        for workers in times:
            # One cluster at a time: a cluster that waits takes processor time, too.
            with local_cluster(workers, _LIMIT) as client:
                client.wait_for_workers(workers)
                _run(bags[: 4 * workers], client)
                before = client.run(time.process_time)
                times[workers].append(_run(bags, client))
                after = client.run(time.process_time)
                costs[workers].append(sum(after[w] - before[w] for w in after) / len(bags))
                futures = client.map(_count, range(workers), pure=False)
                counts[workers].append(sum(client.gather(futures)))
    tell(f'CPU seconds of a bag, one and two workers in turns: {costs}')
    tell(
        'two processes that only count reach so many times what one does, as the machine is busy '
        f'with: {max(counts[2]) / max(counts[1]):.2f}'
    )
    per_minute = {workers: 60.0 * len(bags) / min(of) for workers, of in times.items()}
    tell(f'seconds for {len(bags)} bags, one and two workers in turns: {times}')
    yield Figure.of_ratio(
        'bags of one minute, in a minute, two workers',
        '{:.0f}',
        (per_minute[2], per_minute[1]),
        'one worker',
        1.7,
        at_least=True,
    )


def _count(_: int) -> int:
    """Return how far this process counts in two seconds."""
    end, number = time.monotonic() + 2.0, 0
    while time.monotonic() < end:
        number += 1
    return number


def scheduler(folder: Path, count: int) -> Iterator[Figure]:
    """Count processor time of scheduler and client beside that of the workers."""
    write_fleet(folder / 'robots' / '0', FleetSettings(5, 10, faults={}, broken_every=0))
    for k in range(1, count // 50):
        shutil.copytree(folder / 'robots' / '0', folder / 'robots' / str(k))
    bags = find_bags([str(folder / 'robots')], None)
    with local_cluster(2, _LIMIT) as client:
        client.wait_for_workers(2)
        _run(bags[:8], client)
        before, own = client.run(time.process_time), time.process_time()
        _run(bags, client)
        own = (time.process_time() - own) / len(bags)
        after = client.run(time.process_time)
        largest = max(client.run(_largest_memory).values())
    work = sum(after[worker] - before[worker] for worker in after) / len(bags)
    yield Figure(
        f'scheduler and client, CPU a bag, {len(bags)} bags',
        f'{1e3 * own:.2g} ms',
        f'{1e3 * work:.3g} ms',
        'work on it',
        own / work,
        0.05,
    )
    yield Figure.of_ratio(
        'memory of a worker after them', '{:.0f} MB', (largest, _LIMIT / 1e6), 'limit', 0.25
    )


def _largest_memory() -> float:
    """Return the most memory in MB that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def memory(folder: Path) -> Iterator[Figure]:
    """Measure one bag of an hour at 200 Hz in a process of its own."""
    hour = FleetSettings(1, 1, 3600.0, 200.0, faults={}, broken_every=0)
    write_fleet(folder / 'robots', hour)
    (bag,) = find_bags([str(folder / 'robots')], None)
    with local_cluster(1, _LIMIT) as client:
        cpu = client.submit(_cost, bag).result()
        largest = max(client.run(_largest_memory).values())
    size = sum(bag.sizes.values())
    tell(f'an hour at 200 Hz: {cpu:.1f} s of CPU, {size / 1e6:.1f} MB in the store')
    yield Figure.of_ratio(
        'memory of a worker, an hour at 200 Hz', '{:.0f} MB', (largest, _LIMIT / 1e6), 'limit', 0.5
    )


def _cost(bag: Bag) -> float:
    """Return the processor time in s that a bag takes, with all loaded."""
    start = time.process_time()
    measure(bag, _JOB)
    return time.process_time() - start


def interrupted(folder: Path) -> Iterator[Figure]:
    """Kill the command ten times at random moments, resume, and compare the tables."""
    write_fleet(folder / 'robots', FleetSettings(8, 10, faults={}))
    bags = str(folder / 'robots')
    command = [*_COMMAND, bags, '--resume']
    choice, kept = random.Random(20), 0
    for k in range(_INTERRUPTIONS):
        process = subprocess.Popen([*command, '-o', str(folder / 'out')], start_new_session=True)
        # From the start of the first worker on, somewhere within the work on a few bags.
        limit = time.monotonic() + 300.0
        while _kept(folder) <= kept and process.poll() is None and time.monotonic() < limit:
            time.sleep(0.01)
        time.sleep(choice.uniform(0.0, 2.0))
        how = choice.choice([signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
        process.send_signal(how)
        process.wait()
        lost, kept = kept, _kept(folder)
        tell(f'interruption {k + 1} by {how.name}: {kept} bags are kept, {kept - lost} of them new')
    for out in ('out', 'whole'):
        subprocess.run([*command, '-o', str(folder / out)], check=True)
    tables = [(folder / out / 'fleet.parquet').read_bytes() for out in ('out', 'whole')]
    same = float(tables[0] == tables[1])
    yield Figure(
        'table after ten interruptions',
        'the same' if same else 'another',
        'whole run',
        'bytes',
        same,
        1.0,
        at_least=True,
    )


def _kept(folder: Path) -> int:
    return len(list(folder.glob('out/results/*/*/*.json')))


def main() -> int:
    """Print the figures; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = ('faults', 'others', 'tables', 'speed', 'scheduler', 'memory', 'interrupted')
    parser.add_argument('--only', nargs='+', choices=parts, default=parts)
    parser.add_argument('--bags', type=int, default=1000, help='for the scheduler, default 1000')
    parser.add_argument(
        '--seeds', nargs='+', type=int, default=[0], help='of the fleets with faults, default 0'
    )
    parser.add_argument('--fleets', type=int, default=100, help='drawn of each kind, default 100')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    runs: dict[str, list[Callable[[Path], Iterator[Figure]]]] = {
        'faults': [partial(faults, seed=seed) for seed in options.seeds],
        'others': [partial(others, seed=seed) for seed in options.seeds],
        'tables': [partial(tables, count=options.fleets)],
        'speed': [speed],
        'scheduler': [partial(scheduler, count=options.bags)],
        'memory': [memory],
        'interrupted': [interrupted],
    }
    figures: list[Figure] = []
    for part in options.only:
        tell(f'{part} ...')
        for measured in runs[part]:
            with tempfile.TemporaryDirectory() as folder:
                figures += measured(Path(folder))
    return tell_figures(figures, options.json)


if __name__ == '__main__':
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    sys.exit(main())
