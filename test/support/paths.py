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

"""Where the repository is, and the real recordings beside it."""

import shutil
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent.parent
PACKAGE = REPOSITORY / 'gyro_drift_filter'
PARAMETER_FILE = REPOSITORY / 'config' / 'gyro_drift_filter.yaml'
TESTS = REPOSITORY / 'test'
RECORDINGS = REPOSITORY.parent / 'shared' / 'bags'
WITH_TRUTH = REPOSITORY.parent / 'shared' / 'quality' / 'data'
MOTION = WITH_TRUTH / 'motion'
FLIGHTS = WITH_TRUTH / 'dead_reckoning'
NAMES = (
    'broad_09_fast_rotation_with_breaks',
    'broad_24_tapping',
    'static_adis16405',
    'static_mpu6050_bursty',
    'xio_fusion',
)


def recorded(path: Path) -> Path:
    """Return the path of real recordings, or skip the test where they are not."""
    if not path.exists():
        pytest.skip(f'the real recordings {path.relative_to(REPOSITORY.parent)} are not there')
    return path


# What a copy of the repository leaves out: what is made in it.
NOT_COPIED = shutil.ignore_patterns(
    *(
        '.git',
        '.venv',
        '.*_cache',
        '.hypothesis',
        '__pycache__',
        '*.egg-info',
        '.coverage',
        '.coverage.*',
    ),
    *('build', 'install', 'log', 'site', '*_output'),
)
