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

"""What docs/architecture.md says on adding something is done as it is written there."""

import re
import shutil
import sys

import pytest

from support.paths import REPOSITORY, TESTS
from support.processes import run_command

PAGE = (REPOSITORY / 'docs' / 'architecture.md').read_text()
AVERAGE = """
import numpy as np
from gyro_drift_filter.core import Filter, Parameters

z = 0.01 * np.random.default_rng(0).standard_normal((400, 3)) + 0.1
parameters = {'method': 'average', 'sample_rate': 100.0, 'bias_enabled': False}
filter_ = Filter(Parameters(**parameters))
got = filter_.run(10**18 + 10_000_000 * np.arange(400), z, np.zeros_like(z))
expected, gain = [z[0]], 1.0 - np.exp(-0.01)
for sample in z[1:]:
    expected.append(expected[-1] + gain * (sample - expected[-1]))
np.testing.assert_allclose(got['angular_velocity'], expected, rtol=1e-12)
# Another method takes over where this one is, and this one from another.
for method in ('adaptive', 'average'):
    filter_.configure(Parameters(**(parameters | {'method': method})))
    before = filter_.state['result']['angular_velocity'].copy()
    now = filter_.step(0, before, (0.0, 0.0, 0.0))['angular_velocity']
    np.testing.assert_allclose(now, before, atol=1e-9)
# The error grows while nothing is measured, and what was learned of the noise outlives a gap.
filter_ = Filter(Parameters(**parameters))
state, nothing = filter_.state['methods']['average'], (0.0, 0.0, 0.0)
filter_.run(10**18 + 10_000_000 * np.arange(400), z, np.zeros_like(z))
error, noise = state['variance'].copy(), state['innovation_variance'].copy()
np.testing.assert_allclose(noise, 1e-4, rtol=0.3)
# It fits its sensor: its innovations are as large as it says, and R is that of the noise.
counts = filter_.state['counts']
np.testing.assert_allclose(counts['nis_sum'] / counts['nis_samples'], 1.0, atol=0.5)
np.testing.assert_allclose(filter_.state['result']['measurement_noise'], 1e-4, rtol=0.3)
for k in range(400, 420):
    filter_.step(10**18 + 10_000_000 * k, (np.nan,) * 3, nothing)
assert (state['variance'] > 1.1 * error).all()
filter_.step(10**18 + 10**10, z[0], nothing)
np.testing.assert_allclose(state['innovation_variance'], noise, rtol=0.1)
filter_.reset()
filter_.step(10**18, z[0], nothing)
assert (state['innovation_variance'] > 10.0 * noise).all()
"""
VALUE = """
import numpy as np
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.health import Health
from gyro_drift_filter.messages.message_filter import MessageFilter

input_, _ = Health().judge(MessageFilter(Parameters()).report(), 1.0)
assert input_.values['Smallest change of the rate (rad/s) y'] == '0', input_.values
"""
PARAMETER = """
from pathlib import Path
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.cli.parameter_file import read_parameters
from tools.write_parameter_files import parameter_files

assert Filter(Parameters(largest_rate=20.0)).record[0]['settings']['largest_rate'] == 20.0
for path, text in parameter_files().items():
    assert 'largest_rate' in text
    path.write_text(text)
assert read_parameters(Path('config/gyro_drift_filter.yaml')) == Parameters()
"""
STORAGE = """
from pathlib import Path
import numpy as np
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.fleet.measuring import Job, measure
from gyro_drift_filter.fleet.sources import find_bags
from gyro_drift_filter.simulation.bag import imu_message

log = Path('logs/one.imulog')
log.parent.mkdir()
with log.open('wb') as file:
    for k in range(120):
        message = imu_message(10**18 + 10_000_000 * k, (0.1, 0.2, 0.3), (0.0, 0.0, 9.8))
        file.write(np.int64(10**18 + 10_000_000 * k).tobytes() + np.uint32(len(message)).tobytes())
        file.write(message)
(summary,) = replay(log, Path('out'), parameters=Parameters())
assert (summary.received, summary.written) == (120, 120), summary
(summary,) = replay(log, Path('part'), parameters=Parameters(), selection=Selection(end=1.0))
assert summary.received == 101, summary
(bag,) = find_bags(['logs'], None)
rows = measure(bag, Job(Parameters(), bags=Path('bags'))).rows
assert [row['messages'] for row in rows] == [120, 120, 120], rows
assert Path('bags/one').is_dir()
"""


def section(title):
    """Return the fenced blocks of a section of the page: (language, text)."""
    (body,) = re.findall(rf'^### {title}\n(.*?)(?=^##|\Z)', PAGE, re.MULTILINE | re.DOTALL)
    return body, re.findall(r'^```(\w+)\n(.*?)^```', body, re.MULTILINE | re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('title', 'files', 'code'),
    [
        ('A method', 2, AVERAGE),
        ('A diagnostic value', 2, VALUE),
        ('A parameter', 1, PARAMETER),
        ('A storage', 2, STORAGE),
    ],
)
def test_what_the_page_adds_works(title, files, code, tmp_path):
    assert len(apply(title, tmp_path)) == files
    environment = {'PYTHONPATH': str(tmp_path), 'NUMBA_DISABLE_JIT': '1'}
    code = f"import sys; sys.modules['numba'] = None  # which takes a second to load\n{code}"
    done = run_command(sys.executable, '-c', code, environment=environment, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_storage_that_the_page_adds_is_a_recording_to_mypy(tmp_path):
    touched = apply('A storage', tmp_path)
    shutil.copy(REPOSITORY / 'mypy.ini', tmp_path)
    known = REPOSITORY / '.mypy_cache'
    if known.is_dir():  # as after `make lint`: what is not touched need not be checked again
        shutil.copytree(known, tmp_path / known.name)
    done = run_command(sys.executable, '-m', 'mypy', *sorted(touched), cwd=tmp_path)
    assert done.returncode == 0, done.stdout


def apply(title, folder):
    """Make what a section of the page adds in a copy of the package; return the files of it."""
    for name in ('gyro_drift_filter', 'tools', 'config', 'docs'):
        # With Python's own files, but for those that are being written.
        shutil.copytree(REPOSITORY / name, folder / name, ignore=shutil.ignore_patterns('*.pyc.*'))
    body, blocks = section(title)
    touched = set()
    for language, text in blocks:
        if language == 'python':
            (path,) = re.findall(r'^`(gyro_drift_filter/.*\.py)`$', body, re.MULTILINE)
            (folder / path).write_text(text)
            touched.add(path)
        else:
            applied = run_command('git', 'apply', '-', input=text, cwd=folder)
            assert applied.returncode == 0, (
                f'the code has changed: make the change of docs/architecture.md, "{title}", anew, '
                f'and put in what `git diff -U1` shows\n{applied.stderr}'
            )
            touched |= set(re.findall(r'^\+\+\+ b/(.*)$', text, re.MULTILINE))
    return touched


def test_each_test_that_docs_robustness_names_exists():
    file, missing = '', []
    for line in (REPOSITORY / 'docs' / 'robustness.md').read_text().split('\n'):
        if not line.startswith('|'):
            continue
        for named, name in re.findall(r'`(?:(test_\w+\.py)::)?(test_\w+)`', line):
            file = named or file
            if f'def {name}(' not in (TESTS / file).read_text():
                missing.append(f'{file}::{name}')
    assert missing == []
