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

"""Python packages that a command needs and that may be missing."""

from collections.abc import Iterator
from contextlib import contextmanager

from gyro_drift_filter.errors import GyroDriftFilterError


@contextmanager
def needing(what: str, *packages: str) -> Iterator[None]:
    """Import within this what needs packages, by the names that pip knows.

    Raises:
        GyroDriftFilterError: One is missing; `what` is said to need them all.
    """
    try:
        yield
    except ImportError as error:
        *others, last = packages
        names = f'packages {", ".join(others)} and {last}' if others else f'package {last}'
        raise GyroDriftFilterError(
            f'{what} needs the Python {names} ({error}): install {"them" if others else "it"} '
            f"with 'pip install {' '.join(packages)}', on Ubuntu within a venv"
        ) from error


@contextmanager
def needing_fleet() -> Iterator[None]:
    """Import within this what fleets need: setup.py has those packages as an extra.

    Raises:
        GyroDriftFilterError: One is missing.
    """
    try:
        yield
    except ImportError as error:
        raise GyroDriftFilterError(
            f'fleets need more Python packages ({error}): install them with '
            '\'pip install ".[fleet]"\' in the folder of this repository, on Ubuntu within a venv'
        ) from error
