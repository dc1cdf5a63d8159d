"""Kernels compiled and as plain Python, and a cache that sees every edit."""

import os
import shutil
import subprocess
import sys

import numpy as np

from gyro_drift_filter.core.compiled import is_compiled
from test.conftest import REPOSITORY

FILTER = """
import sys
import numpy as np
if sys.argv[2] == 'plain':
    sys.modules['numba'] = None
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.compiled import is_compiled
from gyro_drift_filter.core.parameters import METHODS
from gyro_drift_filter.core.simulation import SimulationSettings, simulate
assert is_compiled() == (sys.argv[2] == 'compiled')
data = simulate(SimulationSettings(static_seconds=10, dynamic_seconds=10))
stamps = data.stamps.copy()
stamps[500:] += 200_000_000
rates = data.angular_velocity
rates[700, 1] = np.nan
out = {}
for method in METHODS:
    results = Filter(Parameters(method=method)).run(stamps, rates, data.linear_acceleration)
    out |= {f'{method} {name}': results[name] for name in results.dtype.names}
np.savez(sys.argv[1], **out)
"""


def run(code, *arguments, cwd=None, **environment):
    return subprocess.run(
        [sys.executable, '-c', code, *arguments],
        env=os.environ | environment,
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def test_compiled_and_plain_python_agree(tmp_path):
    """In everything that can happen."""
    results = {}
    for way in ('compiled', 'plain'):
        command = [sys.executable, '-m', 'test.eventful', str(tmp_path / f'{way}.npz'), way]
        done = subprocess.run(
            command, cwd=REPOSITORY, capture_output=True, text=True, check=False, timeout=600
        )
        assert done.returncode == 0, done.stderr
        results[way] = np.load(tmp_path / f'{way}.npz')
    compiled, plain = results['compiled'], results['plain']
    assert len(compiled.files) > 45
    for name in compiled.files:
        a, b = compiled[name], plain[name]
        assert a.shape == b.shape
        assert np.isfinite(a).all()
        scale = np.abs(a).max() or 1
        assert np.abs(1.0 * a - b).max() <= 1e-12 * scale, name
    for name in ('packages', 'turning', 'beyond_max'):
        assert compiled[f'adaptive {name}'] > 0, f'the recording has to have {name}'


def test_the_tests_run_on_compiled_kernels():
    assert is_compiled() or os.environ.get('NUMBA_DISABLE_JIT')


def test_an_edit_of_a_callee_in_another_file_is_seen(tmp_path):
    """Numba's own cache keeps a caller's old code when only the callee's file changes."""
    shutil.copytree(REPOSITORY / 'gyro_drift_filter', tmp_path / 'gyro_drift_filter')
    callee = tmp_path / 'gyro_drift_filter' / 'core' / 'paper.py'
    code = """
from gyro_drift_filter.core import Filter, Parameters
filter_ = Filter(Parameters(method='kalman'))
filter_.step(10**18, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
print(filter_.step(10**18 + 10**7, (2.0, 2.0, 2.0), (0.0, 0.0, 0.0))['innovation'][0])
"""
    environment = {'PYTHONPATH': str(tmp_path), 'XDG_CACHE_HOME': str(tmp_path / 'cache')}
    first = run(code, cwd=tmp_path, **environment)
    assert first.stdout.strip() == '1.0', first.stderr
    assert any((tmp_path / 'cache').rglob('*.nbi'))
    text = callee.read_text()
    line = 'innovation = sample - predicted  # (10)'
    assert line in text
    callee.write_text(text.replace(line, 'innovation = sample - predicted + 5.0'))
    assert run(code, cwd=tmp_path, **environment).stdout.strip() == '6.0'


def test_works_where_the_cache_is_a_file(tmp_path):
    """As with a read-only home: no directory can be made, so nothing is kept."""
    (tmp_path / 'cache').write_text('')
    done = run(FILTER, str(tmp_path / 'out'), 'compiled', XDG_CACHE_HOME=str(tmp_path / 'cache'))
    assert done.returncode == 0, done.stderr
