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

"""Which thresholds matter, and how much: each is changed by a factor, and everything scored again.

    python -m benchmark.thresholds [--module FILE ...] [--only NAME ...] [--factors FACTOR ...]
        [--all]

A cell names the figures of `benchmark.quality`, at 100 and at 50 Hz, and of `benchmark.drivers`
that have moved by more than a tenth of their bar, the furthest first: a share of the bar as
delivered, and the share then. A share above 1 misses the bar. A threshold where both cells are
empty may be of any size nearby, in these worlds. With `--all` the table has those, too.

Each change compiles the kernels of a copy of the package, which takes half a minute.
"""

import argparse
import ast
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmark import drivers, quality
from benchmark.candidates import CANDIDATES
from benchmark.measure import ROOT
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.errors import GyroDriftFilterError

METHODS = Path('gyro_drift_filter/core/methods')
MODULES = tuple(METHODS / f'{name}.py' for name in ('outliers', 'outlier_limits', 'doubt', 'jolts'))
_PACKAGES = ('gyro_drift_filter', 'benchmark')
_RATES = (100.0, 50.0)  # Hz
_MOVED = 0.1  # of a bar
_NAMED = 3  # figures in a cell


def constants_of(source: str) -> dict[str, ast.expr]:
    """Return where the numbers of a module stand, by the name that each is given at its top."""
    found = {}
    for statement in ast.parse(source).body:
        if not isinstance(statement, ast.Assign):
            continue
        target, value = statement.targets[0], statement.value
        names = target.elts if isinstance(target, ast.Tuple) else [target]
        values = value.elts if isinstance(value, ast.Tuple) else [value]
        if len(names) != len(values):
            continue
        for name, number in zip(names, values, strict=True):
            parts = {type(node) for node in ast.walk(number)}
            if isinstance(name, ast.Name) and not parts & {ast.Name, ast.Call, ast.Tuple}:
                found[name.id] = number
    return found


def changed(source: str, name: str, factor: float) -> str:
    """Return the text of a module with one of its constants times a factor.

    A whole number stays one, and changes by one at least.

    Raises:
        GyroDriftFilterError: The module has no such constant.
    """
    place = constants_of(source).get(name)
    if place is None:
        raise GyroDriftFilterError(f'there is no constant {name}')
    lines = source.splitlines(keepends=True)
    line = lines[place.lineno - 1]
    text = line[place.col_offset : place.end_col_offset]
    if text.isdigit():
        step = 1 if factor > 1.0 else -1
        nearest = round(int(text) * factor)
        text = str(nearest if nearest != int(text) else int(text) + step)
    else:
        text = f'{factor!r} * ({text})'
    lines[place.lineno - 1] = line[: place.col_offset] + text + line[place.end_col_offset :]
    return ''.join(lines)


def shares_of_bars() -> dict[str, float]:
    """Return how much of its bar each figure of the package takes up, by its name."""
    shares = {}
    for rate in _RATES:
        world = quality.make_world(rate, 0.005, 'autoregressive', seed=0)
        figures = quality.score(CANDIDATES['adaptive'], world)
        for name, bar in quality.bars_at(rate).items():
            shares[f'{name} at {rate:g} Hz'] = _share(name, figures[name], bar)
    for world_name in drivers.WORLDS:
        for name, values in drivers.score(world_name, seed=7).items():
            full = f'{world_name}.{name}'
            if full in drivers.BARS:
                shares[full] = _share(full, values, drivers.BARS[full])
    return shares


def _share(name: str, values: list[float], bar: quality.Bar) -> float:
    worst, limit = quality.worst(name, values), bar[1]
    if '.nis' in name:
        return abs(math.log(max(worst, 1e-9))) / math.log(limit)
    if quality.larger_is_better(name):
        return (1.0 - worst) / (1.0 - limit)
    return worst / limit


def _shares_with(module: Path, source: str) -> dict[str, float]:
    """Return `shares_of_bars` of a copy of the package in which a module has another text."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for package in _PACKAGES:
            shutil.copytree(
                ROOT / package, folder / package, ignore=shutil.ignore_patterns('__pycache__')
            )
        (folder / module).write_text(source)
        program = f'import json, {__spec__.name} as b; print(json.dumps(b.shares_of_bars()))'
        done = subprocess.run(
            [sys.executable, '-c', program],
            cwd=folder,
            env=os.environ | {'PYTHONPATH': name, 'NUMBA_CACHE_DIR': str(folder / 'cache')},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    shares: dict[str, float] = json.loads(done.stdout)
    return shares


def _moved(delivered: dict[str, float], shares: dict[str, float]) -> Iterator[str]:
    """Yield the figures that have moved, the furthest first."""
    names = sorted(delivered, key=lambda name: abs(shares[name] - delivered[name]), reverse=True)
    for name in names:
        if abs(shares[name] - delivered[name]) > _MOVED:
            yield f'{name} {delivered[name]:.2f} -> {shares[name]:.2f}'


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return its exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--module', nargs='+', type=Path, default=MODULES, metavar='FILE')
    parser.add_argument('--only', nargs='*', metavar='NAME')
    parser.add_argument('--factors', nargs='*', type=float, default=[0.7, 1.4], metavar='FACTOR')
    parser.add_argument('--all', action='store_true', help='tell of those that move nothing, too')
    options = parser.parse_args(arguments)
    sources = {module: (ROOT / module).read_text() for module in options.module}
    places = {name: module for module in sources for name in constants_of(sources[module])}
    for name in options.only or ():
        if name not in places:
            raise GyroDriftFilterError(f'there is no constant {name}')
    delivered = shares_of_bars()
    rows = [['constant', *(f'times {factor:g}' for factor in options.factors)]]
    for name in options.only or places:
        module, cells = places[name], []
        for factor in options.factors:
            tell(f'changing {name} ...')
            text = changed(sources[module], name, factor)
            moved = list(_moved(delivered, _shares_with(module, text)))
            cells.append('; '.join(moved[:_NAMED]))
        if options.all or any(cells):
            rows.append([name, *cells])
    print(table(rows))
    return 0


if __name__ == '__main__':
    sys.exit(main())
