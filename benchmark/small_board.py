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

"""What the node takes on a small board: one core at a quarter of its time, compiled and as Python.

python -m benchmark.small_board [--share 0.25] [--first-compile]

The node runs in a control group of its own whose share of the processor is limited, which takes
root and control groups of version 1; the player beside it has the rest of the machine. A rate
counts as kept up with where every message comes back in one of three trials, with the node's own
queue of 200: what other programs hold up is no matter of the node.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path

from benchmark.live import Player, imus
from benchmark.measure import ROOT
from gyro_drift_filter.core.methods import METHOD_NAMES
from harness.live_node import EXECUTABLE

GROUP = Path('/sys/fs/cgroup/cpu/gyro_drift_filter_small_board')
PERIOD = 4000  # us: short beside the time of a message at 100 Hz, as a slow core would be
SECONDS = 8.0
TRIALS = 3
RATES = (25, 50, 75, 100, 150, 200, 400, 1000, 1500, 2000, 3000)
# Loss on the way to the node is none of its doing.
RELIABLE = (
    *('-p', 'qos_overrides./imu/data_raw.subscription.reliability:=reliable'),
    *('-p', 'qos_overrides./imu/data_raw.subscription.depth:=200'),
    *('-p', 'qos_overrides./imu/data_filtered.publisher.depth:=1000'),
)
# The shell joins the group before it becomes the node.
SHELL = ['/bin/sh', '-c', 'echo $$ > "$0/cgroup.procs"; exec taskset -c 0 "$@"', str(GROUP)]


@contextmanager
def slow_core(share: float) -> Iterator[None]:
    """Make the control group, and remove it at the end."""
    GROUP.mkdir(exist_ok=True)
    (GROUP / 'cpu.cfs_period_us').write_text(str(PERIOD))
    (GROUP / 'cpu.cfs_quota_us').write_text(str(round(share * PERIOD)))
    try:
        yield
    finally:
        end = time.monotonic() + 10.0
        while (GROUP / 'cgroup.procs').read_text() and time.monotonic() < end:
            time.sleep(0.1)
        GROUP.rmdir()


def keeps_up(method: str, rate: float) -> tuple[bool, float, float, float]:
    """Return whether no message was lost, start to first output (s), memory (MB), CPU (us)."""
    node = [*SHELL, str(EXECUTABLE), '--ros-args', '-p', f'method:={method}', *RELIABLE]
    messages = imus(rate, max(SECONDS, 1000 / rate))
    with Player(node) as player:
        start = player.ready()
        first = len(player.arrivals)
        cpu = player.play(rate, messages)
        stamps = {stamp for stamp, _ in player.arrivals[first:] if stamp >= 0}
        return len(stamps) == len(messages), start, player.memory(), cpu * 1e6


def largest_rate(method: str) -> tuple[int, float, float, float]:
    """Return the largest of the rates that is kept up with, and what `keeps_up` says of it."""
    low, high = -1, len(RATES)
    found = (0, 0.0, 0.0, 0.0)
    while high - low > 1:
        middle = (low + high) // 2
        for _ in range(TRIALS):
            kept, start, memory, cpu = keeps_up(method, RATES[middle])
            print(f'  {method} {RATES[middle]} Hz {kept} {cpu:.0f} us', file=sys.stderr, flush=True)
            if kept:
                break
        if kept:
            low, found = middle, (RATES[middle], start, memory, cpu)
        else:
            high = middle
    return found


def first_compile() -> float:
    """Return how long `gyro_drift compile` takes, into an empty folder, in s."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        subprocess.run(
            [*SHELL, sys.executable, '-m', 'gyro_drift_filter.cli.main', 'compile'],
            env=os.environ | {'XDG_CACHE_HOME': folder},
            check=True,
            stdout=sys.stderr,
        )
        return time.monotonic() - begin


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--share', type=float, default=0.25, help='of one core')
    parser.add_argument('--first-compile', action='store_true', help='time that, too')
    options = parser.parse_args()
    with chdir(ROOT), slow_core(options.share):
        print('kernels   method     rate (Hz)  start (s)  memory (MB)  CPU (us a message)')
        for kernels in ('compiled', 'Python'):
            if kernels == 'Python':
                os.environ['NUMBA_DISABLE_JIT'] = '1'
            for method in METHOD_NAMES:
                rate, start, memory, cpu = largest_rate(method)
                print(f'{kernels:9} {method:10} {rate:9} {start:10.1f} {memory:12.0f} {cpu:12.0f}')
        os.environ.pop('NUMBA_DISABLE_JIT')
        if options.first_compile:
            print(f'first compile {first_compile():.0f} s')


if __name__ == '__main__':
    main()
