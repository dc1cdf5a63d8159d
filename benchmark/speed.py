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

"""How fast: the core beside filterpy, the node beside relays, replay beside a loop and a copy.

    python -m benchmark.speed [--json FILE] [--quick] [--only core live offline]

Everything is measured side by side, in turns, and told as a ratio of medians; times by themselves
only illustrate. --quick takes fewer messages and repetitions.
"""

import argparse
import compileall
import contextlib
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmark import live
from benchmark.figures import Figure, tell_figures
from benchmark.measure import ROOT, Cost, cost_of, median_costs
from benchmark.tiled import short_one, write_tiled
from gyro_drift_filter.accelerate.kernels import is_extension
from gyro_drift_filter.cli.printing import tell
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.simulation.experiments import autoregressive

PIECE = 4096  # samples that go through the core at once
_AGAIN = 'GYRO_DRIFT_FILTER_BENCHMARK_AGAIN'
REPLAY = str(Path(sys.executable).parent / 'gyro_drift')


def core(repetitions: int) -> Iterator[Figure]:
    """Time the core's `run` beside filterpy's conventional filter, on the same data."""
    from filterpy.kalman import KalmanFilter

    few, many = 3000, 300_000
    random = np.random.default_rng(0)
    rates = autoregressive(random, many, 0.2, 0.005)
    stamps = 10**18 + 10_000_000 * np.arange(many)
    accelerations = np.zeros_like(rates)

    def conventional() -> None:
        for axis in range(3):
            kalman = KalmanFilter(dim_x=2, dim_z=1)
            kalman.F = np.array([[1.0, 1.0], [0.0, 0.2]])
            kalman.H = np.array([[1.0, 0.0]])
            kalman.Q = np.diag([0.0, 2.4e-5])
            kalman.R *= 2.5e-5
            for rate in rates[:few, axis]:
                kalman.predict()
                kalman.update(rate)

    def ours(method: str) -> Callable[[], None]:
        def run() -> None:
            filter_ = Filter(Parameters(method=method))
            for first in range(0, many, PIECE):
                piece = slice(first, first + PIECE)
                filter_.run(stamps[piece], rates[piece], accelerations[piece])

        return run

    runs = {'filterpy': (conventional, few), **{m: (ours(m), many) for m in ('kalman', 'adaptive')}}
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repetitions):
        for name, (run, count) in runs.items():
            begin = time.perf_counter()
            run()
            times[name].append((time.perf_counter() - begin) / count * 1e6)
    per_sample = {name: statistics.median(column) for name, column in times.items()}
    for name, bar in (('kalman', 500.0), ('adaptive', 60.0)):
        yield Figure(
            f'core, {name}, three axes',
            f'{per_sample[name]:.3g} us',
            f'{per_sample["filterpy"]:.0f} us',
            'filterpy, times faster',
            per_sample['filterpy'] / per_sample[name],
            bar,
            at_least=True,
        )


def node(repetitions: int, *, quick: bool) -> Iterator[Figure]:
    """Measure the node beside relays."""
    start = live.starts(repetitions)
    (bare_time, bare_memory), (time_, memory) = start['bare'], start['node']
    yield Figure.of_ratio(
        'node, start to first output', '{:.2f} s', (time_, bare_time), 'bare node', 3.0
    )
    yield Figure.of_ratio(
        'node, resident memory', '{:.0f} MB', (memory, bare_memory), 'bare node', 2.5
    )
    found = live.cpu_and_latency(repetitions)
    quiet, loud, typed = found['node'], found['node, all listened to'], found['typed']
    for row, other, bar in (
        (quiet, 'typed', 0.35),
        (quiet, 'raw', 1.3),
        (loud, 'typed', 1.0),
    ):
        yield Figure.of_ratio(
            'node, CPU a message' + (', all listened to' if row is loud else ''),
            '{:.0f} us',
            (row['cpu'], found[other]['cpu']),
            f'{other} relay',
            bar,
        )
    for key, name in (('latency', 'median'), ('latency99', '99th percentile')):
        numbers = quiet[key], typed[key]
        yield Figure.of_ratio(f'node, latency, {name}', '{:.3f} ms', numbers, 'typed relay', 1.0)
    for rate, seconds in ((1000.0, 10.0 if quick else 60.0), (2000.0, 5.0 if quick else 20.0)):
        lost, swapped = live.loss(rate, seconds)
        yield Figure(
            f'node, {seconds:g} s at {rate:g} Hz, reliable',
            f'{lost} lost',
            f'{swapped} out of order',
            'nothing',
            float(lost + swapped),
            0.0,
        )


class _Sizes(NamedTuple):
    """Messages of the bags that are replayed."""

    small: int
    loop: int  # of the plain loop, which is slow
    large: int
    huge: int


def _replay_costs(
    repetitions: int, folder: Path, rows: list[tuple[int, bytes]], sizes: _Sizes
) -> dict[str, Cost]:
    """Return what replays, a plain loop, a copy and a page cost, of bags made of these messages."""
    out, page, kept = folder / 'out', folder / 'page.html', folder / 'kept.mcap'
    bags = {n: write_tiled(rows, n, folder / f'bag_{n}') for n in {100, *sizes}}

    def clear() -> None:
        shutil.rmtree(out, ignore_errors=True)
        out.unlink(missing_ok=True)
        page.unlink(missing_ok=True)

    def ours(count: int, *options: str) -> list[str]:
        return [REPLAY, 'replay', str(bags[count]), '-o', str(out), '--quiet', *options]

    def by_hand(what: str, source: Path, *options: str) -> list[str]:
        return [sys.executable, '-m', 'benchmark.plain', what, str(source), str(out), *options]

    cost_of(ours(sizes.large))
    (out / 'out.mcap').rename(kept)
    costs = median_costs(
        {
            'replay': ours(sizes.large),
            'copy': by_hand('copy', kept),
            'loop': by_hand('loop', bags[sizes.loop]),
            'replay, all': ours(sizes.large, '--diagnostics'),
            'loop, all': by_hand('loop', bags[sizes.loop], '--diagnostics'),
            'small': ours(sizes.small),
            'page': [REPLAY, 'report', str(bags[sizes.large]), '-o', str(page), '--quiet'],
            'start': ours(100),
        },
        repetitions,
        clear,
    )
    clear()
    return costs | {'huge': cost_of(ours(sizes.huge))}


def replay(repetitions: int, folder: Path, *, quick: bool) -> Iterator[Figure]:
    """Measure `gyro_drift replay` beside a plain loop and a copy, and its memory and growth."""
    name, rows = short_one()
    sizes = _Sizes(100_000, 200_000, 1_000_000, 10_000_000)
    if quick:
        sizes = _Sizes(20_000, 20_000, 200_000, 1_000_000)
    costs = _replay_costs(repetitions, folder, rows, sizes)
    replayed, made, last = costs['replay'], costs['page'], costs['huge']
    large, huge = f'{sizes.large:,}', f'{sizes.huge:,}'

    def in_us(seconds: float, messages: int) -> float:
        return seconds / messages * 1e6

    for key, other, bar in (('replay', 'loop', 15.0), ('replay, all', 'loop, all', 8.0)):
        ours, theirs = (
            in_us(costs[key].seconds, sizes.large),
            in_us(costs[other].seconds, sizes.loop),
        )
        yield Figure(
            f'{key}, {large} messages of {name}',
            f'{ours:.1f} us',
            f'{theirs:.0f} us',
            f'plain loop over {sizes.loop:,}, times faster',
            theirs / ours,
            bar,
            at_least=True,
        )
    times = in_us(replayed.seconds, sizes.large), in_us(costs['copy'].seconds, sizes.large)
    yield Figure.of_ratio('replay, a message', '{:.1f} us', times, 'copy of its output', 3.0)
    seconds = made.seconds, replayed.seconds
    yield Figure.of_ratio(f'report of {large}', '{:.1f} s', seconds, 'replay of the same', 3.0)
    memory = made.memory, 1500.0
    yield Figure.of_ratio(f'report of {large}, memory', '{:.0f} MB', memory, 'limit', 1.0)
    for against, most, bar in (
        (f'replay of {large}', replayed.memory, 1.1),
        ('limit', 400.0, 1.0),
    ):
        memory = last.memory, most
        yield Figure.of_ratio(f'replay of {huge}, memory', '{:.0f} MB', memory, against, bar)
    slow, fast = (costs[key].seconds - costs['start'].seconds for key in ('huge', 'small'))
    yield Figure.of_ratio(
        f'replay of {huge}, time a message without start-up',
        '{:.2f} us',
        (in_us(slow, sizes.huge), in_us(fast, sizes.small)),
        f'replay of {sizes.small:,}',
        1.15,
    )


def _be_warm() -> None:
    """Have all compiled ahead, and take it as all processes after the first start do."""
    # An installed package has its bytecode, too; a checkout need not, as where Python is told to
    # write none, and then each process compiles some hundred modules.
    compileall.compile_dir(ROOT / 'gyro_drift_filter', quiet=1)
    subprocess.run([sys.executable, '-m', 'gyro_drift_filter.cli.main', 'compile'], check=True)
    if not is_extension() and _AGAIN not in os.environ:
        os.environ[_AGAIN] = 'yes'
        os.execv(sys.executable, [sys.executable, '-m', 'benchmark.speed', *sys.argv[1:]])


def main() -> int:
    """Print the table, write the JSON; return 1 where a figure falls short."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--json', type=Path, help='where the figures are written, too')
    parser.add_argument('--quick', action='store_true')
    parts = ['core', 'live', 'offline']
    parser.add_argument('--only', nargs='*', choices=parts, default=parts)
    parser.add_argument('--repetitions', type=int, default=5, help='default %(default)s')
    options = parser.parse_args()
    _be_warm()
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory(prefix='.bench_', dir=ROOT) as folder, contextlib.chdir(ROOT):
        measured = {
            'core': core(options.repetitions),
            'live': node(options.repetitions, quick=options.quick),
            'offline': replay(options.repetitions, Path(folder), quick=options.quick),
        }
        for name in options.only:
            tell(f'measuring: {name} ...')  # for some minutes each
            for figure in measured[name]:
                tell(f'  {figure.name}: {figure.value}')
                figures.append(figure)
    return tell_figures(figures, options.json)


if __name__ == '__main__':
    sys.exit(main())
