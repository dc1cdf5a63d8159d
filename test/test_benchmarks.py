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

"""The benchmarks say what they are at, and fail where a bar does not hold."""

import ast

import pytest
from scipy.linalg import solve_discrete_are
from scipy.signal import lfilter

pytest.importorskip('filterpy', reason="the benchmark's other filters are not installed")

from benchmark import drivers, quality, speed, thresholds
from benchmark.figures import Figure
from benchmark.limits import Trial, left_by_best
from gyro_drift_filter.core.methods import doubt, jolts, outlier_limits, outliers
from gyro_drift_filter.errors import GyroDriftFilterError
from support.paths import REPOSITORY


@pytest.mark.parametrize(('ratio', 'status'), [(0.9, 0), (1.1, 1)])
def test_a_speed_that_falls_short_is_a_failure(ratio, status, monkeypatch, capsys):
    monkeypatch.setattr(speed, '_be_warm', lambda: None)
    figure = Figure('a figure', '1 s', '2 s', 'another', ratio, 1.0)
    monkeypatch.setattr(speed, 'core', lambda repetitions: iter([figure]))
    monkeypatch.setattr('sys.argv', ['speed', '--only', 'core'])
    assert speed.main() == status
    printed = capsys.readouterr()
    assert ('FALLS SHORT' in printed.out) == status
    assert printed.err == 'measuring: core ...\n  a figure: 1 s\n'


def test_a_quality_that_falls_short_is_a_failure(monkeypatch, capsys):
    monkeypatch.setattr(quality, 'make_world', lambda *arguments: None)
    monkeypatch.setattr(quality, 'score', lambda *arguments: {})
    monkeypatch.setattr(quality, 'falls_short', lambda figures, bars: ['a bar'])
    monkeypatch.setattr('sys.argv', ['quality', '--only', 'adaptive', '--check'])
    assert quality.main() == 1
    monkeypatch.setattr(drivers, 'score', lambda *arguments: {})
    monkeypatch.setattr(drivers, 'misses', lambda *arguments: ['a bar'])
    assert drivers.main(['--only', 'plain', '--check']) == 1
    assert capsys.readouterr().err == 'scoring adaptive ...\nscoring plain ...\n'


def test_make_asks_for_it():
    makefile = (REPOSITORY / 'Makefile').read_text()
    assert 'benchmark.quality --check' in makefile
    assert 'benchmark.drivers --check' in makefile


def test_the_best_linear_filter_is_that_of_kalman_where_both_are(random):
    """Of a signal by one state, Wiener's filter leaves what the Riccati equation says."""
    phi, n = 0.9, 300_000
    truth = lfilter([1.0], [1.0, -phi], random.standard_normal((n, 3)), axis=0)
    noise = 2.0 * random.standard_normal((n, 3))
    trial = Trial('', 100.0, truth, truth, noise, [(0, n)])
    predicted = float(solve_discrete_are([[phi]], [[1.0]], [[1.0]], [[4.0]])[0, 0])
    expected = predicted * 4.0 / (predicted + 4.0)
    assert left_by_best(trial, trial.rests, 100) / (3 * n) == pytest.approx(expected, rel=0.01)


CONSTANTS = '''"""A module."""
from elsewhere import OTHER

LIMIT = 0.5  # rad/s
LEAST, MOST, SHARE = 2, 1e-3, 1.0 / 3.0
DERIVED, NAMES = 2.0 * OTHER, ('x', 'y')


def function():
    LOCAL = 3.0
'''


def test_the_constants_of_a_module_are_its_own_numbers():
    assert list(thresholds.constants_of(CONSTANTS)) == ['LIMIT', 'LEAST', 'MOST', 'SHARE']
    found, modules = 0, (outliers, outlier_limits, doubt, jolts)
    for path, module in zip(thresholds.MODULES, modules, strict=True):
        own = thresholds.constants_of((REPOSITORY / path).read_text())
        assert {name: vars(module)[name] for name in own} == {
            name: eval(compile(ast.Expression(place), name, 'eval')) for name, place in own.items()
        }
        found += len(own)
    assert found > 30


@pytest.mark.parametrize(
    ('name', 'factor', 'value'),
    [('LIMIT', 0.7, 0.35), ('MOST', 1.4, 1.4e-3), ('SHARE', 2.0, 2 / 3), ('LEAST', 1.4, 3)],
)
def test_one_constant_is_changed_and_nothing_else(name, factor, value):
    texts = CONSTANTS, thresholds.changed(CONSTANTS, name, factor)
    spaces = []
    for text in texts:
        space = {}
        exec(text.replace('from elsewhere import OTHER', 'OTHER = 1.0'), space)
        spaces.append(space)
    before, after = spaces
    assert after[name] == pytest.approx(value)
    changed = {key for key in before if key.isupper() and before[key] != after[key]}
    assert changed == {name}
    with pytest.raises(GyroDriftFilterError, match='no constant LOCAL'):
        thresholds.changed(CONSTANTS, 'LOCAL', 2.0)


def test_what_moves_is_told_with_the_furthest_first(monkeypatch, capsys):
    delivered = {'a.move': 0.5, 'a.rest': 0.5, 'a.lost': 0.5}
    moved = {'a.move': 0.7, 'a.rest': 1.2, 'a.lost': 0.55}
    monkeypatch.setattr(thresholds, 'shares_of_bars', lambda: delivered)
    monkeypatch.setattr(
        thresholds, '_shares_with', lambda module, source: moved if '0.7 *' in source else delivered
    )
    assert thresholds.main(['--only', 'RETURN', 'GROWTH']) == 0
    rows = capsys.readouterr().out.splitlines()[1:]
    cell = 'a.rest 0.50 -> 1.20; a.move 0.50 -> 0.70'
    assert [row.split(maxsplit=1) for row in rows if row] == [['RETURN', cell], ['GROWTH', cell]]


def test_shares_of_bars_are_one_where_a_bar_is_just_met():
    assert thresholds._share('a.move', [0.5, 2.0], (1.0, 2.0)) == 1.0
    assert thresholds._share('a.caught', [0.9, 1.0], (None, 0.9)) == pytest.approx(1.0)
    assert thresholds._share('a.nis_rest', [1 / 1.3, 1.0], (None, 1.3)) == pytest.approx(1.0)
