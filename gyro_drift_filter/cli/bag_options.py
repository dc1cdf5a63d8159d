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

"""Which bags and which topic a command is about: each is named once."""

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gyro_drift_filter.errors import GyroDriftFilterError, printable

# What a bag may be, in the help of a command.
BAG = 'rosbag2 folder, a bare .mcap or .db3 file, or a .bag file of ROS 1'


class Once(argparse.Action):
    """An option that must not be given again, as only one of its values could count."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option: str | None = None,
    ) -> None:
        """Take the value."""
        if getattr(namespace, self.dest) is not None:
            parser.error(f'{option} is given twice, and this command takes one')
        setattr(namespace, self.dest, values)


def add_bag_argument(command: argparse.ArgumentParser) -> None:
    """Add the bag of a command that looks at one."""
    command.add_argument('bag', type=Path, help=BAG)


def add_topic_option(command: argparse.ArgumentParser, bag: str = 'the bag') -> None:
    """Add the option `--topic` of a command that looks at one Imu topic of each bag."""
    command.add_argument('--topic', action=Once, help=f'Imu topic, needed where {bag} has several')


def distinct_paths(bags: Sequence[Path]) -> list[Path]:
    """Return the paths of bags without symbolic links, but for those that lead to themselves.

    Raises:
        GyroDriftFilterError: A bag is named twice, or a folder and a file in it are.
    """
    paths = [Path(os.path.realpath(bag)) for bag in bags]
    for k, path in enumerate(paths):
        if path in paths[:k]:
            raise GyroDriftFilterError(f'{printable(str(bags[k]))} is named twice: name it once')
    for bag, path in zip(bags, paths, strict=True):
        if path.parent in paths and (path.parent / 'metadata.yaml').exists():
            folder = bags[paths.index(path.parent)]
            raise GyroDriftFilterError(
                f'{printable(str(bag))} is part of {printable(str(folder))}, which is named, too: '
                'name one of them'
            )
    return paths
