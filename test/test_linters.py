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

"""The rules of ROS 2's linters, by these where they are installed, else by what they call."""

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from support.paths import REPOSITORY
from support.processes import run_command

INSTALLED = ('gyro_drift_filter', 'launch', 'examples')
GENERATED = ('build', 'install', 'log', 'site')


def lint(*command):
    """Run a linter as a module of this Python; return its status and what it printed."""
    done = run_command(sys.executable, '-m', *command, cwd=REPOSITORY)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
def test_flake8():
    """With the rules of pep257; ruff looks at what stands beside the package."""
    pytest.importorskip('flake8')
    status, printed = lint('flake8', '--jobs', '1', *INSTALLED)
    assert status == 0, printed


@pytest.mark.slow
def test_ament_flake8():
    """With all plugins that ROS 2 has."""
    pytest.importorskip('ament_flake8', reason='ament_flake8 comes with ROS 2 from apt')
    status, printed = lint('ament_flake8.main', '--config', '.flake8', *INSTALLED)
    assert status == 0, printed


def test_xml_is_well_formed():
    """With a schema, xmllint would fetch it; catkin_pkg checks what package.xml holds."""
    found = [
        path for folder in ('.', 'config/layouts') for path in REPOSITORY.glob(f'{folder}/*.xml')
    ]
    assert {path.name for path in found} >= {'package.xml', 'plotjuggler.xml'}
    for path in found:
        ElementTree.parse(path)


def test_ament_copyright():
    pytest.importorskip('ament_copyright', reason='ament_copyright comes with ROS 2 from apt')
    status, printed = lint('ament_copyright.main', '.')
    assert status == 0, printed


def test_the_licence_is_known():
    """By the terms that ament_copyright looks for in LICENSE, CONTRIBUTING.md and each source."""
    licence = (REPOSITORY / 'LICENSE').read_text()
    assert 'Apache License\n                           Version 2.0, January 2004' in licence
    contributing = ' '.join((REPOSITORY / 'CONTRIBUTING.md').read_text().split())
    assert 'will be under the Apache 2 License' in contributing
    header = Path(__file__).read_text().split('\n\n')[0]
    assert '"AS IS" BASIS' in header
    sources = [
        path
        for folder in REPOSITORY.iterdir()
        if folder.is_dir() and not folder.name.startswith('.') and folder.name not in GENERATED
        for path in folder.rglob('*.py')
    ]
    assert len(sources) > 250
    without = [str(path) for path in sources if not path.read_text().startswith(header)]
    assert without == []
