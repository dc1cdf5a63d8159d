"""What the tests share: real recordings where they are there, and bags made on the spot."""

import os
from pathlib import Path

import numpy as np
import pytest

# ROS traffic of the tests stays on this machine.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'

REPOSITORY = Path(__file__).parent.parent
RECORDINGS = REPOSITORY.parent / 'shared' / 'bags'
NAMES = (
    'broad_09_fast_rotation_with_breaks',
    'broad_24_tapping',
    'static_adis16405',
    'static_mpu6050_bursty',
    'xio_fusion',
)


@pytest.fixture(params=NAMES)
def recording(request):
    """Path of each real recording in turn."""
    path = RECORDINGS / request.param
    if not path.exists():
        pytest.skip(f'the real recording {request.param} is not beside this clone')
    return path


@pytest.fixture
def random():
    return np.random.default_rng(20170)
