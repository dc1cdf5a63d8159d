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

"""Run a command and say what it took, from outside."""

import json
import statistics
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parent.parent


class Cost(NamedTuple):
    """What a command took.

    Attributes:
        seconds: By the clock.
        processor: User and system time, s.
        memory: Largest resident memory in MB.
    """

    seconds: float
    processor: float
    memory: float


# A process of its own starts the command and waits for it: what a process is started by counts as
# its largest memory, too.
_WAIT = """
import json, os, sys, time
begin = time.monotonic()
process = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ)
_, status, usage = os.wait4(process, 0)
seconds = time.monotonic() - begin
processor = usage.ru_utime + usage.ru_stime
memory = usage.ru_maxrss * 1024 / 1e6
sys.stderr.write(json.dumps([os.waitstatus_to_exitcode(status), seconds, processor, memory]))
"""


def cost_of(command: Sequence[str]) -> Cost:
    """Run a command to its end.

    Raises:
        RuntimeError: It fails.
    """
    done = subprocess.run(
        [sys.executable, '-S', '-c', _WAIT, *command],
        cwd=ROOT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=True,
    )
    errors, _, figures = done.stderr.rpartition('[')
    status, *cost = json.loads('[' + figures)
    if status != 0:
        raise RuntimeError(f'{" ".join(command)} ended with status {status}: {errors}')
    return Cost(*cost)


def median_costs(
    commands: Mapping[str, Sequence[str]], repetitions: int, clear: Callable[[], None]
) -> dict[str, Cost]:
    """Run commands in turn, several times; return the median of each figure.

    `clear` takes away what the last run has left.
    """
    costs: dict[str, list[Cost]] = {name: [] for name in commands}
    for _ in range(repetitions):
        for name, command in commands.items():
            clear()
            costs[name].append(cost_of(command))
    return {
        name: Cost(*(statistics.median(column) for column in zip(*rows, strict=True)))
        for name, rows in costs.items()
    }
