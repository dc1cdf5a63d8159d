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

"""A ROS 2 parameter file: sections, each with the parameters of one node or of many."""

import re
from pathlib import Path
from typing import Any

from gyro_drift_filter.core.parameters import is_misspelt, unknown_name
from gyro_drift_filter.errors import GyroDriftFilterError, ParameterError, yaml_reason

LARGEST_FILE = 1_000_000  # bytes


class NoSectionsError(ParameterError):
    """A parameter file is empty, or holds no names of nodes."""


def read_sections(path: Path) -> dict[str, dict[str, Any]]:
    """Return the full name of each section, and its parameters by their full names.

    In a name `*` stands for one part and `**` for any number.

    Raises:
        NoSectionsError: The file holds none.
        ParameterError: It can't be read.
        GyroDriftFilterError: PyYAML is missing.
    """
    sections: dict[str, dict[str, Any]] = {}
    for name, values in _sections('', _load(path)):
        sections.setdefault(name, {}).update(_flat('', values))
    return sections


def is_section_of(section: str, node: str) -> bool:
    """Tell whether a node, by its full name, gets the parameters of a section, as rclpy sees it."""
    pattern = re.escape(section).replace(r'/\*', r'(/\w+)')
    return re.fullmatch(pattern.replace(r'\*', '*'), node) is not None


def note_unknown(name: str, sections: list[str]) -> str:
    """Return what to say of a parameter that does not exist, given in these sections.

    Raises:
        ParameterError: It is meant for this node: by the name of a section, or by its own, which
            is nearly that of one that exists. In a section for many nodes it may be for another.
    """
    if is_misspelt(name) or not all(section.endswith('*') for section in sections or ['']):
        raise ParameterError(unknown_name(name))
    return f"unknown parameter '{name}': taken to be for another node, as its section is for many"


def _load(path: Path) -> dict[Any, Any]:
    try:
        import yaml
    except ImportError as error:
        raise GyroDriftFilterError(
            "parameter files need the Python package PyYAML: install it with 'pip install PyYAML' "
            "or 'apt install python3-yaml'"
        ) from error

    class Loader(yaml.SafeLoader):
        """YAML as rcl reads it: 2e-5 is a number, where PyYAML wants 2.0e-5, and no aliases."""

        def compose_node(self, parent: Any, index: Any) -> Any:
            # A few lines of them can stand for more values than there is memory.
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError('aliases (*name) are not taken')
            return super().compose_node(parent, index)

    Loader.add_implicit_resolver(
        'tag:yaml.org,2002:float',
        re.compile(r'[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$'),
        list('-+0123456789.'),
    )
    try:
        # A subclass of SafeLoader.
        document = yaml.load(_text(path), Loader)
    except OSError as error:
        raise ParameterError(f'parameter file {path}: {error.strerror}') from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise ParameterError(f'parameter file {path} is no YAML: {yaml_reason(error)}') from error
    if not isinstance(document, dict):
        raise NoSectionsError(f'parameter file {path} holds no node names')
    return document


def _text(path: Path) -> str:
    with path.open('rb') as file:
        data = file.read(LARGEST_FILE + 1)
    if len(data) > LARGEST_FILE:
        raise ParameterError(f'parameter file {path} is longer than {LARGEST_FILE} bytes')
    return data.decode('utf-8')


def _sections(prefix: str, document: dict[Any, Any]) -> list[tuple[str, dict[Any, Any]]]:
    """Return node names and their parameters; namespaces may be nested or joined by slashes."""
    found = []
    for key, value in document.items():
        if not isinstance(value, dict):
            continue
        name = f'{prefix}/{str(key).strip("/")}'
        content = value.get('ros__parameters')
        if isinstance(content, dict):
            found.append((name, content))
        nested = {k: v for k, v in value.items() if k != 'ros__parameters'}
        found += _sections(name, nested)
    return found


def _flat(prefix: str, values: dict[Any, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f'{prefix}{key}'
        if isinstance(value, dict):
            flat |= _flat(f'{name}.', value)
        else:
            flat[name] = value
    return flat
