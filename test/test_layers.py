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

"""What may import what: layers go one way, the core needs no ROS and no files."""

import ast
import functools
import sys

from support.paths import PACKAGE, TESTS
from support.processes import run_command

# Modules that stand below all layers.
BELOW = {'arrays', 'errors', 'gravity', 'phrases', 'rotations', 'version', 'whole_file'}
# What each layer may import of the others.
ALLOWED = {
    'accelerate': set(),
    'core': {'accelerate'},
    'messages': {'accelerate', 'core'},
    'mcap': {'accelerate'},
    'bags': {'accelerate', 'core', 'mcap', 'messages'},
    'identify': {'core'},
    'calibrate': {'core'},
    'doctor': {'core', 'identify', 'messages'},
    'report': {'accelerate', 'core', 'doctor', 'identify', 'messages'},
    'simulation': {'bags', 'messages'},
    'tune': {'core'},
    'recordings': {'bags', 'core', 'doctor', 'identify', 'messages', 'report'},
    'fleet': {'bags', 'core', 'doctor', 'identify', 'messages', 'recordings', 'report'},
    'ros': {'accelerate', 'core', 'messages'},
    'cli': {
        'accelerate',
        'bags',
        'calibrate',
        'core',
        'doctor',
        'fleet',
        'identify',
        'messages',
        'recordings',
        'report',
        'simulation',
        'tune',
    },
}
ROS = {'rclpy', 'sensor_msgs', 'geometry_msgs', 'diagnostic_msgs', 'std_srvs', 'rcl_interfaces'}


@functools.cache
def statements(path):
    """Return the imports and functions of a file."""
    kinds = ast.Import, ast.ImportFrom, ast.FunctionDef
    return [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, kinds)]


def imports(path):
    for node in statements(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module


def test_imports_go_one_way():
    seen = set()
    for path in PACKAGE.glob('*/**/*.py'):
        layer = path.relative_to(PACKAGE).parts[0]
        for name in imports(path):
            parts = name.split('.')
            if (
                parts[0] == 'gyro_drift_filter'
                and len(parts) > 1
                and parts[1] not in {layer} | BELOW
            ):
                assert parts[1] in ALLOWED[layer], f'{path} imports {name}'
                seen.add((layer, parts[1]))
            if layer != 'ros':
                assert parts[0] not in ROS, f'{path} imports {name}'
            if layer == 'core':
                assert parts[0] not in {'rosbags', 'mcap', 'yaml'}, f'{path} imports {name}'
    assert seen == {(layer, other) for layer, others in ALLOWED.items() for other in others}


def test_tests_share_what_is_in_support_and_harness():
    """No test stands on another one, on the demo or on pytest's conftest."""
    paths = sorted(TESTS.rglob('*.py'))
    others = {path.stem for path in paths if path.parent == TESTS} | {'test', 'demo'}
    found = [f'{path.name}: {name}' for path in paths for name in imports(path)]
    assert [line for line in found if line.split(': ')[1].split('.')[0] in others] == []
    assert 'test_bias.py: support.sensor' in found
    assert not (TESTS / '__init__.py').exists(), "it would hide the standard library's test"


def test_the_core_is_importable_with_numpy_alone():
    code = """
import sys
for name in ('numba', 'rclpy', 'rosbags', 'mcap', 'yaml', 'matplotlib'):
    sys.modules[name] = None
from gyro_drift_filter.core import Filter
print(Filter().step(1, (1.0, 2.0, 3.0), (0.0, 0.0, 9.8))['angular_velocity'])
"""
    done = run_command(sys.executable, '-c', code, timeout=60)
    assert done.stdout.strip() == '[1. 2. 3.]', done.stderr


def test_the_node_and_what_it_compiles_need_the_apt_packages_alone():
    """`gyro_drift compile`, which the node starts beside itself, imports all that holds kernels."""
    code = """
import importlib
import sys
for name in ('rosbags', 'mcap', 'matplotlib', 'scipy', 'statsmodels', 'allantools', 'plotly'):
    sys.modules[name] = None
import gyro_drift_filter.ros.node
from gyro_drift_filter.accelerate.cache import kernel_modules
for name in kernel_modules():
    importlib.import_module(name)
"""
    done = run_command(sys.executable, '-c', code, timeout=60)
    assert done.returncode == 0, done.stderr


def test_no_function_has_more_than_eight_arguments():
    """More are grouped in a record, a dataclass or a NamedTuple."""
    checked = 0
    for path in PACKAGE.rglob('*.py'):
        for node in statements(path):
            if isinstance(node, ast.FunctionDef):
                arguments = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
                names = [argument.arg for argument in arguments if argument.arg != 'self']
                assert len(names) <= 8, f'{path}: {node.name}{tuple(names)}'
                checked += 1
    assert checked > 400
