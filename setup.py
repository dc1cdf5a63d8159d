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

"""Packaging; name, version and description come from package.xml, so that they stand once."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

root = Path(__file__).resolve().parent  # `colcon build --symlink-install` links this file
package = ElementTree.parse(root / 'package.xml').getroot()
name = package.findtext('name', '')


def files(pattern: str) -> list[str]:
    """Return the files of a pattern, relative to this folder as setuptools wants them."""
    return [str(path.relative_to(root)) for path in sorted(root.glob(pattern))]


setup(
    name=name,
    version=package.findtext('version', ''),
    description=package.findtext('description', ''),
    long_description=(root / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license=package.findtext('license', ''),
    maintainer=package.findtext('maintainer', ''),
    maintainer_email=next(package.iter('maintainer')).get('email', ''),
    keywords=['ROS', 'IMU', 'gyroscope', 'drift', 'Kalman filter', 'Allan deviation'],
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3.11',
        'Programming Language :: Python :: 3.12',
        'Topic :: Scientific/Engineering',
        'Typing :: Typed',
    ],
    packages=find_packages(include=[name, f'{name}.*']),
    package_data={name: ['py.typed', 'report/page.css', 'report/page.js', 'fleet/page.js']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{name}']),
        (f'share/{name}', ['package.xml']),
        (f'share/{name}/config', files('config/*.yaml')),
        (f'share/{name}/config/layouts', files('config/layouts/*')),
        (f'share/{name}/launch', files('launch/*.launch.py')),
    ],
    python_requires='>=3.11,<3.13',
    # What all commands need. The node needs numpy and PyYAML alone, which package.xml declares;
    # colcon installs nothing of what stands here.
    install_requires=[
        'setuptools>=68.1',
        'numpy>=1.26',
        'PyYAML>=6.0.1',
        # Compiled kernels: the same numbers, some hundred times faster. What numba does not promise
        # to keep is used by accelerate/numba_internals.py alone. To raise the upper bound: install
        # the new version, read that file's head, and run test/test_compiled.py, test_node.py and
        # `make bench`; nothing may fail, nor be skipped that was not before. Where numba has no
        # wheels, kernels run as plain Python.
        'numba>=0.59,<0.69; platform_machine in "x86_64 AMD64 aarch64 arm64"',
        # Bags. rosbags brings the three below it, which are used here without it, too.
        'rosbags>=0.11.7,<0.12',
        'apsw>=3.45',
        'backports.zstd>=1.0',
        'lz4>=4.3.3',
        # Identification of the drift model, calibration, doctor and tuning.
        'allantools>=2024.6',
        'scipy>=1.12',
        'statsmodels>=0.14.6',
        # Figures, and the page of the report: it needs no network, and has long signals reduced.
        'matplotlib>=3.8',
        'plotly>=6',
        'tsdownsample>=0.1.3',
    ],
    extras_require={
        # Fleets: many bags on a cluster, from any store, in one table. Stores need a package each
        # beside it, which their users choose: s3fs, gcsfs, adlfs.
        'fleet': ['dask[distributed]>=2024.8', 'fsspec>=2024.6', 'pyarrow>=16', 'ruptures>=1.1.9'],
        # ROS 2 from PyPI; on a robot it comes from apt and rosdep.
        'jazzy': [
            'ros-jazzy-rclpy==7.1.6',
            'ros-jazzy-common-interfaces==5.3.6',
            'ros-jazzy-rmw-fastrtps-cpp==8.4.3',
        ],
        # The site of the documentation, `make docs`.
        'docs': [
            'mkdocs>=1.6,<2',
            'mkdocs-material>=9.6,<10',
            'mkdocstrings[python]>=0.30,<2',
        ],
        # What the benchmark compares with.
        'benchmark': ['filterpy>=1.4.5', 'OneEuroFilter>=0.2', 'psutil>=5.9'],
        'test': [
            'colcon-common-extensions>=0.3',
            'colcon-ros>=0.5',
            'coverage>=7.10',
            # With the plugins of ROS 2's ament_flake8.
            'flake8>=6',
            'flake8-builtins>=2',
            'flake8-comprehensions>=3',
            'flake8-docstrings>=1.7',
            'flake8-quotes>=3',
            'hypothesis>=6.100',
            'mcap>=1.2',
            'moto[server]>=5',
            'mypy>=1.13',
            'pytest>=8.2',
            'pytest-rerunfailures>=15',
            'pytest-xdist>=3.7',
            'ruff>=0.14',
            's3fs>=2024.6',
            'selenium>=4.20',
            'shtab>=1.7',
            'types-PyYAML>=6.0.12',
            'types-setuptools>=69',
        ],
    },
    zip_safe=True,
    entry_points={
        'console_scripts': [
            'gyro_drift = gyro_drift_filter.cli.main:main',
            'gyro_drift_filter_node = gyro_drift_filter.ros.command:main',
        ],
    },
)
