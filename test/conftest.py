"""What the tests share: real recordings where they are there, and bags made on the spot."""

import os

import numpy as np
import pytest

from support.paths import NAMES, RECORDINGS

# ROS traffic of the tests stays on this machine.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'


def path_of(name):
    """Return the path of a real recording, or skip the test where there is none."""
    path = RECORDINGS / name
    if not path.exists():
        pytest.skip(f'the real recording {name} is not beside this clone')
    return path


def pytest_collection_modifyitems(config, items):
    """Begin with what takes longest; where there are several workers, nodes stay in one of them.

    Nodes wait for each other's messages: several at once would only wait for a processor.
    """
    if config.pluginmanager.has_plugin('xdist'):
        for item in items:
            if item.get_closest_marker('node') and not item.get_closest_marker('xdist_group'):
                item.add_marker(pytest.mark.xdist_group('node'))
    items.sort(key=rank)


def rank(item):
    """Return a smaller number for what begins earlier."""
    if item.get_closest_marker('xdist_group'):
        return 0
    return 1 if item.get_closest_marker('slow') else 2


@pytest.fixture(params=NAMES)
def recording(request):
    """Path of each real recording in turn."""
    return path_of(request.param)


@pytest.fixture
def real_bag():
    """Return a function of a recording's name to its path."""
    return path_of


@pytest.fixture
def random():
    return np.random.default_rng(20170)


@pytest.fixture(scope='session')
def real():
    """Return a function of a recording's name to stamps (n,), rates, accelerations (n, 3)."""
    from gyro_drift_filter.bags.recording import messages, open_bag
    from gyro_drift_filter.messages.cdr import IMU_TYPE, read_imu

    known = {}

    def load(name):
        path = path_of(name)
        if name not in known:
            with open_bag(path) as reader:
                read = [read_imu(d) for c, _, d in messages(reader) if c.msgtype == IMU_TYPE]
            known[name] = (
                np.array([imu.stamp for imu in read]),
                np.array([imu.angular_velocity for imu in read]),
                np.array([imu.linear_acceleration for imu in read]),
            )
        return known[name]

    return load
