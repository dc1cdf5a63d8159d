"""Kernels as an extension module, by numba and as plain Python; and a cache that sees edits."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from gyro_drift_filter.accelerate.kernels import is_compiled
from support.paths import REPOSITORY, TESTS

pytestmark = pytest.mark.slow

WAY = """
from gyro_drift_filter.accelerate.kernels import is_compiled, is_extension
from gyro_drift_filter.core import Filter
Filter().step(10**18, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
print('extension' if is_extension() else 'numba' if is_compiled() else 'plain')
"""


def run(code, cwd=None, **environment):
    return run_command([sys.executable, '-c', code], cwd, **environment)


def run_command(command, cwd=None, **environment):
    return subprocess.run(
        command,
        env=os.environ | environment,
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def results(way, folder):
    """Return all that happens to an eventful recording, with the kernels that are in `folder`."""
    out = folder / f'{way}.npz'
    search_path = os.pathsep.join([str(TESTS), os.environ.get('PYTHONPATH', '')])
    done = subprocess.run(
        [sys.executable, '-m', 'support.eventful', str(out), way],
        env=os.environ | {'XDG_CACHE_HOME': str(folder), 'PYTHONPATH': search_path},
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    return np.load(out)


@pytest.fixture(scope='module')
def by_numba(tmp_path_factory):
    """Folder of the kernels, and what they give."""
    folder = tmp_path_factory.mktemp('kernels')
    return folder, results('numba', folder)


@pytest.fixture(scope='module')
def extension(by_numba):
    """Folder with the extension module in it, and its path."""
    folder, _ = by_numba
    command = [sys.executable, '-m', 'gyro_drift_filter.cli.main', 'compile']
    done = run_command(command, XDG_CACHE_HOME=str(folder))
    assert done.returncode == 0, done.stderr
    if 'no extension module' in done.stderr:
        pytest.skip(f'no C++ compiler here: {done.stderr}')
    (path,) = folder.rglob('*.so')
    return folder, path


def test_numba_and_plain_python_agree(by_numba):
    """In everything that can happen."""
    folder, compiled = by_numba
    plain = results('plain', folder)
    assert len(compiled.files) > 45
    for name in compiled.files:
        a, b = compiled[name], plain[name]
        assert a.shape == b.shape
        assert np.isfinite(a).all()
        scale = np.abs(a).max() or 1
        assert np.abs(1.0 * a - b).max() <= 1e-12 * scale, name
    for name in ('segments', 'turning', 'beyond_max'):
        assert compiled[f'adaptive {name}'] > 0, f'the recording has to have {name}'


def test_the_extension_module_gives_numbas_bits(by_numba, extension):
    ahead = results('extension', extension[0])
    assert set(ahead.files) == set(by_numba[1].files)
    for name in ahead.files:
        np.testing.assert_array_equal(ahead[name], by_numba[1][name], err_msg=name)


def test_a_process_with_the_extension_module_does_not_load_numba(extension):
    folder, _ = extension
    code = f'{WAY}\nimport sys; assert not {{"numba", "llvmlite"}} & set(sys.modules)'
    done = run(code, XDG_CACHE_HOME=str(folder))
    assert (done.returncode, done.stdout.strip()) == (0, 'extension'), done.stderr
    command = [sys.executable, '-m', 'gyro_drift_filter.cli.main', 'compile']
    assert run_command(command, XDG_CACHE_HOME=str(folder)).stdout == 'compiled already\n'


def test_the_extension_module_is_found_where_nothing_can_be_written(extension):
    folder, _ = extension
    code = f'import os; os.access = lambda *_: False\n{WAY}'
    done = run(code, XDG_CACHE_HOME=str(folder))
    assert (done.returncode, done.stdout.strip()) == (0, 'extension'), done.stderr


MISSING = """
from gyro_drift_filter.accelerate.kernels import is_cache_cold, is_extension_missing
print(is_cache_cold(), is_extension_missing())
"""


def test_a_damaged_extension_module_is_passed_over_and_built_anew(extension):
    folder, path = extension
    whole = path.read_bytes()
    assert run(MISSING, XDG_CACHE_HOME=str(folder)).stdout.strip() == 'False False'
    for damaged in (b'', b'nothing of the kind', whole[:3000], whole[:-1]):
        path.write_bytes(damaged)
        done = run(WAY, XDG_CACHE_HOME=str(folder))
        assert (done.returncode, done.stdout.strip()) == (0, 'numba'), done.stderr
    assert run(MISSING, XDG_CACHE_HOME=str(folder)).stdout.strip() == 'False True'
    command = [sys.executable, '-m', 'gyro_drift_filter.cli.main', 'compile']
    assert run_command(command, XDG_CACHE_HOME=str(folder)).returncode == 0
    assert run(WAY, XDG_CACHE_HOME=str(folder)).stdout.strip() == 'extension'
    assert not list(path.parent.glob('build_*'))


@pytest.mark.parametrize('lacking', ['compiler', 'headers', 'setuptools'])
def test_without_a_compiler_numba_is_loaded(lacking, by_numba, tmp_path):
    """Nor without what it needs; the reason is told in one line, and no start tries again."""
    shutil.copytree(by_numba[0] / 'gyro_drift_filter', tmp_path / 'gyro_drift_filter')
    for built in tmp_path.rglob('*.so'):
        built.unlink()
    wrapper = tmp_path / 'compiler'
    wrapper.write_text('#!/bin/sh\necho "Python.h: error: no such file" >&2; exit 1\n')
    wrapper.chmod(0o755)
    environment = {'XDG_CACHE_HOME': str(tmp_path), 'TMPDIR': str(tmp_path)}
    code = "import sys; from gyro_drift_filter.cli.main import main; sys.exit(main(['compile']))"
    if lacking == 'compiler':
        environment |= {'PATH': '', 'CC': '/no/compiler', 'CXX': '/no/compiler'}
    elif lacking == 'headers':
        environment |= {'CC': str(wrapper), 'CXX': str(wrapper)}
    else:
        code = f"import sys; sys.modules['setuptools'] = None\n{code}"
    done = run(code, **environment)
    assert done.returncode == 0, done.stderr
    assert 'no extension module: it needs a C++ compiler' in done.stderr
    assert done.stderr.count('\n') == 1
    assert run(WAY, **environment).stdout.strip() == 'numba'
    assert run(MISSING, **environment).stdout.strip() == 'False False'
    assert not list(tmp_path.rglob('*pycc*'))
    assert not list(tmp_path.rglob('build_*'))


def test_the_tests_run_on_compiled_kernels():
    assert is_compiled() or os.environ.get('NUMBA_DISABLE_JIT')


def test_an_edit_of_a_callee_in_another_file_is_seen(tmp_path):
    """Numba's own cache keeps a caller's old code when only the callee's file changes."""
    shutil.copytree(REPOSITORY / 'gyro_drift_filter', tmp_path / 'gyro_drift_filter')
    callee = tmp_path / 'gyro_drift_filter' / 'core' / 'methods' / 'paper.py'
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
    done = run(WAY, XDG_CACHE_HOME=str(tmp_path / 'cache'))
    assert (done.returncode, done.stdout.strip()) == (0, 'numba'), done.stderr
