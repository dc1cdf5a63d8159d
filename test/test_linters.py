"""The rules of ROS 2's linters, by these where they are installed, else by what they call."""

import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import pytest

from support.paths import REPOSITORY

# Those that ament_pep257 ignores, and D402: shapes stand in parentheses. Sections are Google's.
IGNORED = ','.join([*(f'D10{digit}' for digit in range(8)), 'D402'])


def lint(*command):
    """Run a linter as a module of this Python; return its status and what it printed."""
    done = subprocess.run(
        [sys.executable, '-m', *command],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
def test_flake8():
    pytest.importorskip('flake8')
    status, printed = lint('flake8', '--jobs', '1')
    assert status == 0, printed


@pytest.mark.slow
def test_ament_flake8():
    """With all plugins that ROS 2 has."""
    pytest.importorskip('ament_flake8', reason='ament_flake8 comes with ROS 2 from apt')
    status, printed = lint(
        'ament_flake8.main', '--config', '.flake8', 'gyro_drift_filter', 'launch'
    )
    assert status == 0, printed


@pytest.mark.slow
def test_pep257():
    pytest.importorskip('pydocstyle')
    folders = ('gyro_drift_filter', 'launch', 'examples', 'harness')
    status, printed = lint(
        'pydocstyle', '--convention', 'google', '--add-ignore', IGNORED, *folders
    )
    assert status == 0, printed


def test_xml_is_well_formed():
    """With a schema, xmllint would fetch it; catkin_pkg checks what package.xml holds."""
    found = [
        path for folder in ('.', 'config/layouts') for path in REPOSITORY.glob(f'{folder}/*.xml')
    ]
    assert {path.name for path in found} >= {'package.xml', 'plotjuggler.xml'}
    for path in found:
        ElementTree.parse(path)


def test_the_licence_is_known():
    """By the terms that ament_copyright looks for in LICENSE and CONTRIBUTING.md."""
    licence = (REPOSITORY / 'LICENSE').read_text()
    assert 'Apache License\n                           Version 2.0, January 2004' in licence
    contributing = ' '.join((REPOSITORY / 'CONTRIBUTING.md').read_text().split())
    assert 'will be under the Apache 2 License' in contributing
