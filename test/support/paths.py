"""Where the repository is, and the real recordings beside it."""

import shutil
from pathlib import Path

REPOSITORY = Path(__file__).parent.parent.parent
TESTS = REPOSITORY / 'test'
RECORDINGS = REPOSITORY.parent / 'shared' / 'bags'
MOTION = REPOSITORY.parent / 'shared' / 'quality' / 'data' / 'motion'
FLIGHTS = REPOSITORY.parent / 'shared' / 'quality' / 'data' / 'dead_reckoning'
NAMES = (
    'broad_09_fast_rotation_with_breaks',
    'broad_24_tapping',
    'static_adis16405',
    'static_mpu6050_bursty',
    'xio_fusion',
)

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
