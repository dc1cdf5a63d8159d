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
    from gyro_drift_filter.bags.imu_arrays import read_imu_arrays

    known = {}

    def load(name):
        path = path_of(name)
        if name not in known:
            data = read_imu_arrays(path)
            known[name] = data.stamps, data.angular_velocity, data.linear_acceleration
        return known[name]

    return load
