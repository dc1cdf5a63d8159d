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

"""The package as others meet it: metadata, the launch file, a colcon workspace, the demo."""

import ast
import os
import re
import shutil
import subprocess
import sys
import threading
import xml.etree.ElementTree as ElementTree
from importlib.metadata import packages_distributions, requires, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from gyro_drift_filter.accelerate import cache
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.message_filter import MessageFilter
from harness.live_node import LOSSLESS, LiveNode
from support.messages import simulated
from support.paths import NOT_COPIED, PACKAGE, PARAMETER_FILE, REPOSITORY
from support.processes import run_command

BIN = Path(sys.executable).parent
MAIN = 'gyro_drift_filter.launch.py'


def test_the_version_stands_once():
    package = ElementTree.parse(REPOSITORY / 'package.xml').getroot()
    assert package.get('format') == '3'
    assert version('gyro_drift_filter') == package.findtext('version')
    assert (REPOSITORY / 'resource' / package.findtext('name', '')).exists()


def test_package_xml_names_what_is_imported():
    package = ElementTree.parse(REPOSITORY / 'package.xml').getroot()
    declared = {element.text for element in package.findall('exec_depend')}
    imported = set()
    for path in (PACKAGE / 'ros').glob('*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                imported.add(str(node.module).split('.')[0])
    standard = set(sys.stdlib_module_names) | {'gyro_drift_filter'}
    assert imported - standard <= declared


COLLECT_WITH_LITTLE = """
import sys
from importlib.machinery import PathFinder
import pytest
from hypothesis.internal import conjecture
find, lacking = PathFinder.find_spec, set(sys.argv[1].split(','))
def find_or_lack(name, *others):
    return None if name.partition('.')[0] in lacking else find(name, *others)
PathFinder.find_spec = find_or_lack
sys.modules['hypothesis.internal.conjecture.providers'] = None
vars(conjecture).pop('providers', None)
sys.exit(pytest.main(['--collect-only', '--quiet', '-p', 'no:cacheprovider']))
"""


@pytest.mark.slow
def test_the_tests_are_collected_with_what_ubuntu_has():
    """As by `colcon test` on a robot: what comes from PyPI is missing, and hypothesis is old."""
    required = {Requirement(text) for text in requires('gyro_drift_filter') or ()}
    of_pypi = {canonicalize_name(r.name) for r in required if 'jazzy' not in str(r.marker)}
    of_pypi |= {'distributed'}  # which dask brings
    of_pypi -= {'numpy', 'pyyaml', 'setuptools', 'pytest', 'hypothesis'}
    lacking = {
        name
        for name, owners in packages_distributions().items()
        if of_pypi & set(map(canonicalize_name, owners))
    }
    assert {'apsw', 'backports', 'numba', 'rosbags', 'scipy'} <= lacking
    arguments = '-c', COLLECT_WITH_LITTLE, ','.join(lacking)
    done = run_command(
        sys.executable,
        *arguments,
        cwd=REPOSITORY,
        environment={'PYTEST_DISABLE_PLUGIN_AUTOLOAD': '1'},
    )
    assert done.returncode == 0, done.stdout
    assert 'test/test_linters.py::test_xml_is_well_formed' in done.stdout


def test_the_launch_file_hands_each_argument_to_the_node():
    """Its structure, read as text; `launch` itself comes with ROS 2 from apt alone."""
    tree = ast.parse((REPOSITORY / 'launch' / 'gyro_drift_filter.launch.py').read_text())
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]

    def first_arguments(name):
        return [ast.literal_eval(c.args[0]) for c in calls if getattr(c.func, 'id', '') == name]

    topics = {
        'input': 'imu/data_raw',
        'output': 'imu/data_filtered',
        'temperature': 'imu/temperature',
        'motion_hint': 'motion_hint',
    }
    arguments = {'params_file', 'name', 'namespace', 'log_level', 'use_sim_time', *topics}
    declared = first_arguments('DeclareLaunchArgument')
    assert sorted(declared) == sorted(first_arguments('LaunchConfiguration')) == sorted(arguments)
    (node,) = [call for call in calls if getattr(call.func, 'id', '') == 'Node']
    given = {keyword.arg: ast.unparse(keyword.value) for keyword in node.keywords}
    assert given['executable'] == "'gyro_drift_filter_node'"
    for name in ('name', 'namespace'):
        assert given[name] == f"LaunchConfiguration('{name}')"
    for name, option in (('params_file', '--params-file'), ('log_level', '--log-level')):
        assert f"'{option}', LaunchConfiguration('{name}')" in given['ros_arguments']
    for argument, topic in topics.items():
        assert f"('{topic}', LaunchConfiguration('{argument}'))" in given['remappings']
        (call,) = [c for c in calls if c.args and ast.unparse(c.args[0]) == f"'{argument}'"][:1]
        assert f"default_value='{topic}'" in ast.unparse(call)
    assert PARAMETER_FILE.exists()


def test_the_launch_file_loads_where_launch_is_installed():
    pytest.importorskip('launch_ros', reason='launch comes with ROS 2 from apt, not from PyPI')
    import runpy

    for name, entities in ((MAIN, 10), ('robot.launch.py', 7), ('two_imus.launch.py', 4)):
        path = REPOSITORY / 'launch' / name
        description = runpy.run_path(str(path))['generate_launch_description']()
        assert len(description.entities) == entities


def build(root, *options):
    """Build the package by colcon in a clean workspace; return where it is installed."""
    shutil.copytree(
        REPOSITORY,
        root / 'src' / 'gyro_drift_filter',
        ignore=NOT_COPIED,
    )
    environment = os.environ | {'PATH': f'{BIN}:{os.environ["PATH"]}', 'COLCON_HOME': str(root)}
    environment.pop('PYTHONDONTWRITEBYTECODE', None)  # setuptools warns of it
    done = subprocess.run(
        ['colcon', 'build', '--event-handlers', 'console_direct+', *options],
        cwd=root,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert '1 package finished' in done.stdout
    assert 'stderr output' not in done.stdout, done.stderr
    return root / 'install' / 'gyro_drift_filter'


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    """Make a clean workspace with the package, built by colcon."""
    return build(tmp_path_factory.mktemp('workspace'))


@pytest.mark.slow
def test_colcon_links_what_shall_be_edited(tmp_path):
    installed = build(tmp_path, '--symlink-install')
    shipped = installed / 'share' / 'gyro_drift_filter' / 'config' / 'gyro_drift_filter.yaml'
    assert shipped.resolve().is_relative_to(tmp_path / 'src')
    assert (installed / 'lib' / 'gyro_drift_filter' / 'gyro_drift_filter_node').exists()


@pytest.mark.slow
def test_the_examples_stand_beside_the_launch_file(workspace):
    launch = workspace / 'share' / 'gyro_drift_filter' / 'launch'
    names = {path.name for path in launch.iterdir()}
    assert names == {path.name for path in (REPOSITORY / 'launch').glob('*.launch.py')}
    declared = set(re.findall(r"DeclareLaunchArgument\(\s*'(\w+)'", (launch / MAIN).read_text()))
    for name, used in (
        ('robot.launch.py', {'input', 'motion_hint'}),
        ('two_imus.launch.py', {'namespace', 'params_file'}),
    ):
        text = (launch / name).read_text()
        assert used <= declared
        assert all(f"'{argument}': " in text for argument in used)


@pytest.mark.slow
def test_colcon_installs_what_ros_looks_for(workspace):
    for name in (
        'lib/gyro_drift_filter/gyro_drift_filter_node',
        'lib/gyro_drift_filter/gyro_drift',
        'share/gyro_drift_filter/package.xml',
        'share/gyro_drift_filter/config/gyro_drift_filter.yaml',
        'share/gyro_drift_filter/config/layouts/foxglove.json',
        'share/gyro_drift_filter/config/layouts/plotjuggler.xml',
        'share/gyro_drift_filter/launch/gyro_drift_filter.launch.py',
        'share/ament_index/resource_index/packages/gyro_drift_filter',
    ):
        assert (workspace / name).exists(), name
    modules = {p.name for p in workspace.rglob('site-packages/gyro_drift_filter/*') if p.is_dir()}
    assert {'core', 'bags', 'ros', 'cli'} <= modules


@pytest.mark.node
def test_the_built_node_filters_from_a_cold_start_on(workspace, monkeypatch, tmp_path):
    """Nothing of what comes while the kernels are compiled is lost, and the next start is warm."""
    folder = tmp_path / 'gyro_drift_filter' / cache.folder().name

    def compile_elsewhere():
        """Do as another process that ends before the node's own, which would take minutes."""
        files = [path for path in cache.folder().iterdir() if path.is_file()]
        for path in sorted(files, key=lambda path: path.name.startswith('complete_')):
            shutil.copy(path, folder / 'copied')
            (folder / 'copied').replace(folder / path.name)

    site = next(workspace.rglob('site-packages'))
    monkeypatch.setenv('PYTHONPATH', str(site))
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    shipped = workspace / 'share' / 'gyro_drift_filter' / 'config' / 'gyro_drift_filter.yaml'
    data = simulated(400)
    executable = workspace / 'lib' / 'gyro_drift_filter' / 'gyro_drift_filter_node'
    with LiveNode(['--params-file', str(shipped), *LOSSLESS], node=executable) as node:
        maps = Path(f'/proc/{node.process.pid}/environ').read_bytes()
        assert str(site).encode() in maps
        elsewhere = threading.Timer(3.0, compile_elsewhere)
        elsewhere.start()
        published = node.play(data)
        elsewhere.join()
    assert node.returncode == 0
    assert 'first start: compiling' in node.log
    assert re.search(r'compiled; \d+ messages kept, 0 too many', node.log)
    filter_ = MessageFilter(Parameters())
    assert published == [filter_.take(message) for message in data]
    with LiveNode(LOSSLESS, node=executable) as node:
        assert len(node.play(data[:10])) == 10
    assert 'compil' not in node.log


@pytest.mark.node
def test_the_demo(tmp_path):
    demo = sys.executable, '-m', 'demo.main', tmp_path / 'output'
    done = run_command(*demo, cwd=REPOSITORY, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert 'It helped: at rest the rates are' in done.stdout
    off = {
        name: abs(float(degrees))
        for name, degrees in re.findall(r'^(raw|adaptive) +(\S+) +\S+$', done.stdout, re.M)
    }
    assert off['adaptive'] < 0.1 * off['raw']
    assert 'live and offline agree in every bit of 12000 messages' in done.stdout
    shifts = {}
    for line in done.stdout.splitlines():
        row = re.fullmatch(r'(\w+) ([xyz]) +(\S+) +(\S+) +(\S+) +(\S+)', line)
        if row:
            shifts[row[1], row[2]] = (float(row[4]), float(row[6]))
    assert len(shifts) >= 9
    for (name, _), (shift, ratio) in shifts.items():
        assert abs(shift) < 3
        assert ratio < 1 or name == 'raw'
    for path in done.stdout.partition('wrote ')[2].split():
        assert Path(path).exists()
    for name in ('heading.png', 'static.png', 'dynamic.png'):
        assert (tmp_path / 'output' / name).read_bytes().startswith(b'\x89PNG')
