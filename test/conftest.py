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

"""What the tests share: real recordings where they are there, and bags made on the spot."""

import gc
import os
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

# As in the command, before numpy is loaded: threads beside those of other workers wait busily.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import numpy as np
import pytest
from hypothesis import settings

from support.paths import NAMES, RECORDINGS, recorded

# ROS traffic of the tests stays on this machine.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

# A commit passes or fails alike wherever it is tested. `--hypothesis-profile default` draws other
# examples in each run, to search for what these do not show.
settings.register_profile('repeatable', derandomize=True, print_blob=True)
settings.load_profile('repeatable')
# Hypothesis also draws numbers that it finds in the modules that are loaded, and which those are
# depends on what ran before in the same process.
with suppress(ImportError, AttributeError):  # not in every version, as in that of Ubuntu 24.04
    from hypothesis.internal.conjecture import providers

    _NO_CONSTANTS = providers._local_constants
    providers._get_local_constants = lambda: _NO_CONSTANTS


# What ROS 2 from apt does not bring. `make test` installs all of it; `colcon test` on a robot's
# computer leaves the tests out that need it.
NOT_FROM_APT = (
    *('allantools', 'apsw', 'backports', 'dask', 'distributed', 'filterpy', 'fsspec', 'lz4'),
    *('matplotlib', 'mcap', 'moto', 'plotly', 'psutil', 'pyarrow', 'rosbags', 'ruptures', 's3fs'),
    *('scipy', 'selenium', 'shtab', 'statsmodels', 'tsdownsample'),
)
MISSING = [f"No module named '{name}" for name in NOT_FROM_APT if find_spec(name) is None]

# Files that filter little. The others would take hours where numba is not installed.
RUNS_UNCOMPILED = {
    *('test_cold_start.py', 'test_distribution.py', 'test_identify_timing.py', 'test_kernels.py'),
    *('test_layers.py', 'test_linters.py', 'test_memory.py', 'test_package.py'),
    *('test_parameters.py', 'test_whole_file.py'),
}


@contextmanager
def skipping_what_is_not_installed(whole_file):
    """Skip where an exception says that a library is missing which apt does not bring."""
    try:
        yield
    except Exception as error:
        for reason in MISSING:
            if reason in str(error):
                pytest.skip(reason + "'", allow_module_level=whole_file)
        raise


class Module(pytest.Module):
    """A file of tests."""

    def collect(self):
        with skipping_what_is_not_installed(whole_file=True):
            return list(super().collect())


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Look for no garbage among modules and kernels, of which there are many and which stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_pycollect_makemodule(module_path, parent):
    return Module.from_parent(parent, path=module_path)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item):
    with skipping_what_is_not_installed(whole_file=False):
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    with skipping_what_is_not_installed(whole_file=False):
        return (yield)


# Files whose tests stay together in one of several workers: they wait for the real node, and would
# only wait for a processor where there were several nodes at once, or share what takes long.
TOGETHER = {
    'test_node.py': 'node',
    'test_node_bias.py': 'node',
    'test_package.py': 'node',
    'test_robustness.py': 'node',
    'test_compiled.py': 'kernels',
    'test_identify_cli.py': 'identify',
    'test_layers.py': 'layers',
}


def together(nodeid):
    """Return what the test stays together with: a group of files, or its function's parameters.

    They may share what takes seconds, and each worker would make it anew.
    """
    file, _, _ = nodeid.partition('::')
    function, _, _ = nodeid.partition('[')
    return TOGETHER.get(Path(file).name, function)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Share tests out function by function, but for files that stay together."""
    from xdist.scheduler import LoadScopeScheduling

    config.option.loadscopereorder = False  # the order is that of `pytest_collection_modifyitems`
    scheduling = LoadScopeScheduling(config, log)
    scheduling._split_scope = together
    return scheduling


def pytest_collection_modifyitems(items):
    """Begin with what takes longest, so that no worker is left with it in the end."""

    def rank(item):
        if item.path.name in TOGETHER:
            return 0
        return 1 if item.get_closest_marker('slow') else 2

    items.sort(key=rank)
    for item in items:
        if 'browser' in item.fixturenames:
            # Chromium without a window stops drawing now and then, which no page is the cause of:
            # the driver then waits for it in vain, and another Chromium draws the same page.
            item.add_marker(pytest.mark.flaky(reruns=2, only_rerun='TimeoutException'))
    if find_spec('numba') is None:
        for item in items:
            if item.path.name not in RUNS_UNCOMPILED:
                item.add_marker(
                    pytest.mark.skip("No module named 'numba': too slow as plain Python")
                )


@pytest.fixture(params=NAMES)
def recording(request):
    """Path of each real recording in turn."""
    return recorded(RECORDINGS / request.param)


@pytest.fixture
def browser():
    """Start the system's Chromium without a window, or skip."""
    from support.browser import chromium

    with chromium() as driver:
        yield driver


@pytest.fixture
def random():
    return np.random.default_rng(20170)


@pytest.fixture(scope='session')
def real():
    """Return a function of a recording's name to stamps (n,), rates, accelerations (n, 3)."""
    from gyro_drift_filter.bags.imu_arrays import read_imu_arrays

    known = {}

    def load(name):
        path = recorded(RECORDINGS / name)
        if name not in known:
            data = read_imu_arrays(path)
            known[name] = data.stamps, data.angular_velocity, data.linear_acceleration
        return known[name]

    return load
