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

"""Kernels as an extension module, by numba and as plain Python; and their cache on disk.

How kernels are kept is tried on a small package that has two of them: all of `accelerate`, the
command `compile`, and nothing else.
"""

import ast
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial

import numpy as np
import pytest

from gyro_drift_filter.accelerate import cache
from gyro_drift_filter.accelerate.kernels import is_compiled
from support.paths import PACKAGE, REPOSITORY, TESTS
from support.processes import run_command

pytestmark = pytest.mark.slow

COMPILE = 'import sys; from gyro_drift_filter.cli.compile import run; run(None)'
NO_COMPILER = {'PATH': '', 'CC': '/no/compiler', 'CXX': '/no/compiler'}


def run(code, cwd=None, **environment):
    command = sys.executable, '-c', code
    return run_command(*command, environment=environment, cwd=cwd, timeout=600)


def output(code, cwd=None, **environment):
    done = run(code, cwd, **environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


# --- the whole package


@pytest.fixture(scope='module')
def compiled(tmp_path_factory):
    """Folder with all that `gyro_drift compile` makes, and what it said on stderr."""
    folder = tmp_path_factory.mktemp('kernels')
    if cache.folder().is_dir():  # what is there need not be compiled again
        shutil.copytree(
            cache.folder(),
            folder / 'gyro_drift_filter' / cache.folder().name,
            ignore=shutil.ignore_patterns('build_*', 'unfinished.*'),
        )
    environment = {'XDG_CACHE_HOME': str(folder), 'NUMBA_CACHE_DIR': ''}
    done = run("from gyro_drift_filter.cli.main import main; main(['compile'])", **environment)
    assert done.returncode == 0, done.stderr
    return folder, done.stderr


@pytest.fixture(scope='module')
def without_extension_module(compiled, tmp_path_factory):
    """Folder with numba's own files alone.

    They take minutes, as the extension module does, and are kept beside it for the next run of the
    tests, of this clone or another one.
    """
    place, kept = tmp_path_factory.mktemp('numba'), cache.folder()
    shutil.copytree(
        compiled[0], place, ignore=shutil.ignore_patterns('*.so', '*.npz'), dirs_exist_ok=True
    )
    yield place
    unfinished = kept / f'unfinished.{os.getpid()}'
    with suppress(OSError):  # another run may have removed the folder meanwhile
        for path in (place / 'gyro_drift_filter' / kept.name).iterdir():
            if path.is_file() and not (kept / path.name).exists():
                shutil.copy(path, unfinished)
                unfinished.replace(kept / path.name)


@pytest.fixture(scope='module')
def results(compiled, without_extension_module):
    """Return a function of a way to what happens to an eventful recording, by it."""
    folder, complaint = compiled
    known = {}

    def by(way):
        if way == 'extension' and 'no extension module' in complaint:
            pytest.skip(f'no C++ compiler here: {complaint}')
        if way not in known:
            out = folder / f'{way}.npz'
            place = folder if way == 'extension' else without_extension_module
            code = f'from support.eventful import main; main({str(out)!r}, {way!r})'
            search_path = os.pathsep.join([str(TESTS), os.environ.get('PYTHONPATH', '')])
            environment = {'XDG_CACHE_HOME': str(place), 'NUMBA_CACHE_DIR': ''}
            done = run(code, cwd=REPOSITORY, PYTHONPATH=search_path, **environment)
            assert done.returncode == 0, done.stderr
            known[way] = np.load(out)
        return known[way]

    return by


def test_numba_and_plain_python_agree(results):
    """In everything that can happen."""
    compiled, plain = results('numba'), results('plain')
    assert len(compiled.files) > 45
    for name in compiled.files:
        a, b = compiled[name], plain[name]
        assert a.shape == b.shape
        assert np.isfinite(a).all()
        scale = np.abs(a).max() or 1
        assert np.abs(1.0 * a - b).max() <= 1e-12 * scale, name
    for name in ('segments', 'segments_turning', 'segments_beyond_max'):
        assert compiled[f'adaptive {name}'] > 0, f'the recording has to have {name}'


def test_the_extension_module_gives_numbas_bits(results):
    ahead, numba = results('extension'), results('numba')
    assert set(ahead.files) == set(numba.files)
    for name in ahead.files:
        np.testing.assert_array_equal(ahead[name], numba[name], err_msg=name)


SIGNATURES = """
import sys
from gyro_drift_filter.accelerate.kernels import ENTRY_KERNELS, is_compiled, is_extension
from gyro_drift_filter.accelerate.numba_internals import signature
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.messages.imu import EXAMPLE
from gyro_drift_filter.messages.message_filter import MessageFilter

assert is_compiled() and not is_extension()
main(['simulate', '-o', sys.argv[1] + '/bag', '--static', '20', '--dynamic', '5'])
main(['replay', sys.argv[1] + '/bag', '-o', sys.argv[1] + '/out', '--diagnostics', '--quiet'])
MessageFilter(Parameters()).take(EXAMPLE)
Filter().step(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
called = 0
for name, entry in ENTRY_KERNELS.items():
    signatures = entry.compiled.signatures
    assert signatures in ([], [signature(entry.types)]), name
    called += len(signatures)
print(called, 'called')
"""


def test_kernels_are_compiled_for_the_declared_types_alone(
    results, without_extension_module, tmp_path
):
    """In a replay and in the node's way: nothing else is compiled, nor missing ahead of time."""
    results('numba')
    place = str(without_extension_module)
    code = SIGNATURES.replace('sys.argv[1]', repr(str(tmp_path)))
    count, _ = output(code, XDG_CACHE_HOME=place, NUMBA_CACHE_DIR='').split('\n')[-1].split()
    assert int(count) >= 8


def test_the_tests_run_on_compiled_kernels():
    assert is_compiled() or os.environ.get('NUMBA_DISABLE_JIT')


def test_importing_the_package_leaves_no_trace(tmp_path):
    code = """
import gyro_drift_filter.core
import importlib
from gyro_drift_filter.accelerate.cache import kernel_modules
for name in kernel_modules():
    importlib.import_module(name)
"""
    environment = {'XDG_CACHE_HOME': str(tmp_path / 'cache'), 'HOME': str(tmp_path / 'home')}
    output(code, **environment, PYTHONDONTWRITEBYTECODE='1', NUMBA_CACHE_DIR='')
    assert list(tmp_path.rglob('*')) == []


def test_the_installed_numba_is_one_that_has_been_tested():
    """Otherwise: see at the bounds in setup.py."""
    numba = pytest.importorskip('numba')
    packaging = pytest.importorskip('packaging.requirements')
    texts = [
        str(node.value)
        for node in ast.walk(ast.parse((REPOSITORY / 'setup.py').read_text()))
        if isinstance(node, ast.Constant) and re.match(r'numba\b', str(node.value))
    ]
    (text,) = texts
    assert packaging.Requirement(text).specifier.contains(numba.__version__)
    assert '<' in text


# --- a small package

# What kernels give and where they come from; whether they were missing.
WAY = """
import sys
from gyro_drift_filter.accelerate import kernels
from gyro_drift_filter.core.outer import counted, twice
missing = kernels.is_cache_cold()
way = 'extension' if kernels.is_extension() else 'numba' if kernels.is_compiled() else 'plain'
assert counted(b'abc') == 294
print(twice(2.0), way, missing)
"""
INNER = """
from gyro_drift_filter.accelerate import kernel
STEP = 1.0
@kernel
def shifted(value):
    return value + STEP
"""
OUTER = """
import numpy as np
from gyro_drift_filter.accelerate import entry_kernel, read_only
from gyro_drift_filter.core.inner import shifted
@entry_kernel(float)
def twice(value):
    return 2.0 * shifted(value)
@entry_kernel(read_only(np.uint8))
def sum_of(data):
    total = 0
    for i in range(len(data)):
        total += int(data[i])
    return total
def counted(text):
    return sum_of(np.frombuffer(text, np.uint8))
"""


def compiled_small(root, **environment):
    """Make the small package, with its kernels compiled; return its folder and what was told."""
    package, small = PACKAGE, root / 'gyro_drift_filter'
    shutil.copytree(package / 'accelerate', small / 'accelerate')
    for name in ('', 'core/', 'cli/'):
        (small / name).mkdir(exist_ok=True)
        (small / name / '__init__.py').touch()
    for name in (
        'errors.py',
        'cli/compile.py',
        'cli/printing.py',
        'cli/progress.py',
        'cli/signals.py',
    ):
        shutil.copy(package / name, small / name)
    (small / 'core' / 'inner.py').write_text(INNER)
    (small / 'core' / 'outer.py').write_text(OUTER)
    (small / 'core' / 'text.py').write_text('TEXT = 1')
    done = run(COMPILE, root, **environment_of(root) | environment)
    assert done.returncode == 0, done.stderr
    return root, done.stderr


@pytest.fixture(scope='module')
def with_extension(tmp_path_factory):
    return compiled_small(tmp_path_factory.mktemp('extension'))


@pytest.fixture(scope='module')
def without_extension(tmp_path_factory):
    return compiled_small(tmp_path_factory.mktemp('cache'), **NO_COMPILER)


def environment_of(root):
    return {
        'PYTHONPATH': str(root),
        'XDG_CACHE_HOME': str(root / 'cache'),
        'HOME': str(root),
        'NUMBA_CACHE_DIR': '',
        'CFLAGS': '-O0',  # for what numba adds to each extension module, a third of the work
    }


class Small:
    """The small package, with its cache, in a folder of its own."""

    def __init__(self, root, tmp_path):
        self.root = tmp_path / 'small'
        shutil.copytree(root, self.root)
        self.environment = environment_of(self.root)
        (self.kept,) = (self.root / 'cache' / 'gyro_drift_filter').iterdir()
        self.extension = self.kept / 'gyro_drift_filter_kernels.so'

    def output(self, code, **environment):
        return output(code, self.root, **self.environment | environment)

    def run(self, code, **environment):
        return run(code, self.root, **self.environment | environment)


@pytest.fixture
def small(without_extension, tmp_path):
    """Copy the small package with numba's cache."""
    return Small(without_extension[0], tmp_path)


@pytest.fixture
def extended(with_extension, tmp_path):
    """Copy the small package with an extension module."""
    if 'no extension module' in with_extension[1]:
        pytest.skip(f'no C++ compiler here: {with_extension[1]}')
    return Small(with_extension[0], tmp_path)


def test_a_process_with_the_extension_module_does_not_load_numba(extended):
    code = f'{WAY}\nassert not {{"numba", "llvmlite"}} & set(sys.modules)'
    assert extended.output(code) == '6.0 extension False'
    assert extended.output(COMPILE) == 'compiled already'
    assert extended.output(WAY, NUMBA_DISABLE_JIT='1') == '6.0 plain False'
    without = f'import sys; sys.modules["numba"] = None\n{WAY}'
    extended.extension.unlink()
    assert extended.output(without) == '6.0 plain False'


@pytest.mark.parametrize(
    ('change', 'why'),
    [
        ('sys.modules["numba"] = None', 'install numba for speed'),
        ('sys.modules["numba.core"] = None', 'numba fails here (import of numba.core halted'),
        ('sys.modules["numpy"].__version__ = "99.0"', 'numba fails here (Numba needs NumPy'),
        (
            'sys.modules["gyro_drift_filter.accelerate.numba_internals"] = None',
            'numba fails here (import of gyro_drift_filter.accelerate.numba_internals halted',
        ),
    ],
)
def test_a_numba_that_fails_is_as_none_and_says_why(small, change, why):
    """As one that is older than numpy: to install numba would be no advice."""
    code = f'import sys, numpy\n{change}\n{WAY}\nprint(kernels.why_plain())'
    way, told = small.output(code).split('\n')
    assert way == '6.0 plain False'
    assert told.startswith(why)


def test_the_extension_module_is_found_where_nothing_can_be_written(extended):
    code = f'import os; os.access = lambda *_: False\n{WAY}'
    assert extended.output(code) == '6.0 extension False'


def test_a_damaged_extension_module_is_passed_over_and_built_anew(extended, monkeypatch):
    monkeypatch.setattr(cache, 'folder', lambda: extended.kept)
    whole = extended.extension.read_bytes()
    assert cache.is_extension_whole()
    for damaged in (b'', b'nothing of the kind', whole[:-1], whole[:3000]):
        extended.extension.write_bytes(damaged)
        assert not cache.is_extension_whole()
    assert extended.output(WAY) == '6.0 numba True'
    extended.output(COMPILE)
    assert extended.output(WAY) == '6.0 extension False'
    assert not list(extended.kept.glob('build_*'))


def test_a_process_that_waits_for_the_kernels_takes_the_extension_module(extended):
    """Else it would compile them once more, by numba."""
    code = f"""
from gyro_drift_filter.accelerate import kernels
from gyro_drift_filter.core.outer import counted, sum_of, twice
assert kernels.is_cache_cold()
import subprocess, sys
subprocess.run([sys.executable, '-c', {COMPILE!r}], check=True, stdout=subprocess.DEVNULL)
assert not kernels.is_cache_cold()
print(twice(2.0), twice(3.0), counted(b"abc"), twice.signatures, sum_of.signatures)
"""
    extended.extension.unlink()
    assert extended.output(code) == '6.0 8.0 294 [] []'


def test_an_extension_module_that_can_not_be_loaded_is_told(extended):
    """As on a disk from which nothing may be executed: numba's cache is filled instead."""
    refuse = 'from gyro_drift_filter.accelerate import cache; cache.load_extension = lambda: None\n'
    extended.extension.unlink()
    done = extended.run(refuse + COMPILE)
    assert done.returncode == 0, done.stderr
    (told,) = [line for line in done.stderr.splitlines() if not line.startswith('compiled: ')]
    assert told.startswith(f'no extension module: {extended.kept} can not hold one; without, ')
    extended.extension.unlink()
    assert extended.output(WAY) == '6.0 numba False'


@pytest.mark.parametrize(
    'lost',
    [
        'os.dup2(os.open("/dev/full", os.O_WRONLY), 2)',
        'os.dup2(os.pipe()[1], 2); os.closerange(3, 10)',
        'os.close(1)',
        'os.close(2)',
    ],
    ids=['stderr full', 'nobody reads stderr', 'stdout closed', 'stderr closed'],
)
def test_the_extension_module_is_kept_where_nothing_can_be_told(lost, extended):
    extended.extension.unlink()
    often = 'from gyro_drift_filter.cli import progress; progress._LINE_SECONDS = 0.05'
    done = extended.run(f'import os; {lost}\n{often}\n{COMPILE}')
    assert done.returncode == 0
    assert extended.output(WAY) == '6.0 extension False'
    assert not list(extended.kept.glob('build_*'))


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_nothing_of_a_build(number, extended):
    extended.extension.unlink()
    command = sys.executable, '-c', COMPILE
    environment = os.environ | extended.environment
    with subprocess.Popen(
        command,
        env=environment,
        cwd=extended.root,
        # Tests that run in the background inherit that interrupts are ignored.
        preexec_fn=partial(signal.signal, number, signal.SIG_DFL),
    ) as process:
        end = time.monotonic() + 60
        while not list(extended.kept.glob('build_*')):
            assert time.monotonic() < end
            time.sleep(0.01)
        time.sleep(0.2)
        process.send_signal(number)
    assert process.returncode == 128 + number
    assert not list(extended.kept.glob('build_*'))


def test_a_damaged_file_of_a_kernel_is_made_anew(small):
    files = list(small.kept.glob('gyro_drift_filter.core.*'))
    assert len(files) == 2  # one for each kernel that Python calls
    for path, size in zip(files, (0, 100), strict=True):
        path.write_bytes(path.read_bytes()[:size])
    done = small.run(WAY)
    assert (done.stdout, done.stderr) == ('6.0 numba False\n', '')
    assert min(path.stat().st_size for path in files) > 100


def test_a_numba_without_what_saves_compiling_does_as_well(small):
    """Where it has changed too much, kernels for kernels alone are compiled as all others."""
    change = (
        'from gyro_drift_filter.accelerate import numba_internals\n'
        'assert numba_internals._inner_compiler() is not None\n'
        'numba_internals._inner_compiler = lambda: None\n'
    )
    shutil.rmtree(small.kept)
    assert small.output(change + WAY) == '6.0 numba True'


@pytest.mark.parametrize(('llvm', 'joins'), [(14, False), (22, True)])
def test_numbas_setting_is_as_it_was_behind_the_kernels(llvm, joins, monkeypatch):
    """It holds for all that is compiled in this process; and old versions of LLVM made errors."""
    numba = pytest.importorskip('numba')
    from gyro_drift_filter.accelerate import numba_internals

    monkeypatch.setattr('llvmlite.binding.llvm_version_info', (llvm, 0, 0))
    before = numba.config.SLP_VECTORIZE
    with numba_internals._joining_scalars():
        assert bool(numba.config.SLP_VECTORIZE) is joins
    assert before == numba.config.SLP_VECTORIZE


@pytest.mark.parametrize('lacking', ['compiler', 'headers', 'setuptools', 'pycc'])
def test_without_a_compiler_numba_is_loaded(lacking, small, tmp_path):
    """Nor without what it needs; the reason is told in one line, and no start tries again."""
    shutil.rmtree(small.kept)
    wrapper = tmp_path / 'compiler'
    wrapper.write_text('#!/bin/sh\necho "Python.h: error: no such file" >&2; exit 1\n')
    wrapper.chmod(0o755)
    environment, code = {'TMPDIR': str(tmp_path)}, COMPILE
    if lacking == 'compiler':
        environment |= NO_COMPILER
    elif lacking == 'headers':
        environment |= {'CC': str(wrapper), 'CXX': str(wrapper)}
    else:
        module = 'numba.pycc' if lacking == 'pycc' else lacking
        code = f'import sys; sys.modules[{module!r}] = None\n{code}'
    done = small.run(code, **environment)
    assert done.returncode == 0, done.stderr
    assert 'no extension module: it needs a C++ compiler' in done.stderr
    told = [line for line in done.stderr.splitlines() if not line.startswith('compiled: ')]
    assert len(told) == 1
    assert small.output(WAY) == '6.0 numba False'
    assert not list(tmp_path.rglob('*pycc*'))
    assert not list(tmp_path.rglob('build_*'))


def test_an_edit_of_a_callee_in_another_file_is_seen(small):
    """Numba's own cache keeps a caller's old code when only the callee's file changes."""
    inner = small.root / 'gyro_drift_filter' / 'core' / 'inner.py'
    inner.write_text(INNER.replace('STEP = 1.0', 'STEP = 2.0'))
    assert small.output(WAY) == '8.0 numba True'
    assert len(list(small.kept.parent.iterdir())) == 2


def test_an_edit_of_a_file_without_kernels_compiles_nothing(small):
    (small.root / 'gyro_drift_filter' / 'core' / 'text.py').write_text('TEXT = 2')
    assert small.output(WAY) == '6.0 numba False'
    assert list(small.kept.parent.iterdir()) == [small.kept]


def test_other_types_than_the_declared_ones_are_refused(small):
    code = """
import numpy as np
from gyro_drift_filter.core.outer import sum_of
assert sum_of(np.arange(4, dtype=np.uint8)) == 6  # read_only takes both
for wrong in (np.zeros(4), np.zeros((4, 2), np.uint8)[:, 0], np.zeros((2, 2), np.uint8)):
    try:
        sum_of(wrong)
    except TypeError as error:
        assert 'No matching definition' in str(error)
        print('refused', len(sum_of.signatures))
"""
    assert small.output(code).split('\n') == ['refused 1'] * 3


def test_a_kernel_for_kernels_alone_is_plain_python_to_python(small, tmp_path):
    """It has no function for Python: calling one that is not there would end the process."""
    code = """
from gyro_drift_filter.core.inner import shifted
from gyro_drift_filter.core.outer import twice
print(shifted(1.0), len(shifted.signatures))
print(twice(1.0), shifted(1), len(shifted.signatures))
"""
    compiled_anew = small.output(code, XDG_CACHE_HOME=str(tmp_path / 'other'))
    assert compiled_anew.split('\n') == ['2.0 0', '4.0 2.0 1']
    assert small.output(code).split('\n') == ['2.0 0', '4.0 2.0 0']  # of the cache twice alone


def test_old_caches_are_removed_when_a_new_one_is_complete(small):
    inner = small.root / 'gyro_drift_filter' / 'core' / 'inner.py'
    inner.write_text(INNER.replace('STEP = 1.0', 'STEP = 2.0'))
    root, now = small.kept.parent, time.time()
    folders = [root / f'{k:016x}' for k in range(5)]
    others = [root / 'notes', root / ('f' * 17), root / 'A123456789abcdef']
    for age, folder in enumerate([*folders, *others]):
        folder.mkdir()
        (folder / 'complete_0.1').touch()
        os.utime(folder, (now + 1000 - age, now + 1000 - age))
    (root / ('0' * 15 + 'f')).touch()
    code = 'from gyro_drift_filter.accelerate.ahead import compile_all; compile_all()'
    assert small.output(code, **NO_COMPILER) == ''
    left = set(root.iterdir())
    assert left > {*folders[:3], *others, root / ('0' * 15 + 'f')}
    assert not left & {*folders[3:], small.kept}
    assert small.output(WAY) == '8.0 numba False'


# --- where nothing can be kept

ONE_WARNING = r'kernels can not be kept in .*: .+; each start compiles them anew\n'


def without_cache(small, limit='', **environment):
    """Run with a cold cache that can't be used; the kernels have to work, with one warning."""
    done = small.run(limit + WAY, **environment)
    assert re.fullmatch(r'6.0 numba (False|True)\n', done.stdout), done.stderr
    assert re.fullmatch(ONE_WARNING, done.stderr), done.stderr


def test_works_where_the_cache_is_a_file(small, tmp_path):
    """As with a read-only home: no folder can be made."""
    (tmp_path / 'cache').write_text('')
    without_cache(small, XDG_CACHE_HOME=str(tmp_path / 'cache'))


def test_without_a_home_nothing_is_written_into_the_root_folder(small):
    without_cache(small, HOME='', XDG_CACHE_HOME='')
    code = 'from gyro_drift_filter.accelerate.cache import folder; print(folder())'
    assert small.output(code, HOME='', XDG_CACHE_HOME='').startswith('/dev/null')
    # A relative path has no meaning there.
    assert small.output(code, XDG_CACHE_HOME='here').startswith(f'{small.root}/.cache/')


def test_a_full_disk_is_one_warning(small, tmp_path):
    limit = 'import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n'
    environment = {'XDG_CACHE_HOME': str(tmp_path / 'full')}
    without_cache(small, limit, **environment)
    done = small.run(limit + COMPILE, **environment)
    assert done.returncode == 1
    assert 'GyroDriftFilterError: compiled kernels can not be kept' in done.stderr
    assert not list((tmp_path / 'full').rglob('complete_*'))
