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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gyro_drift_filter.core.parameters import DESCRIPTIONS, GROUPS, is_misspelt, unknown_name
from gyro_drift_filter.errors import GyroDriftFilterError, ParameterError, yaml_reason
from gyro_drift_filter.messages.names import NODE_NAME

LARGEST_FILE = 1_000_000  # bytes

_CONTENT = 'ros__parameters'
# A mapping of YAML, in which a key may be there several times.
_Pairs = tuple[tuple[Any, Any], ...]


class NoSectionsError(ParameterError):
    """A parameter file is empty, or holds no names of nodes."""


def read_sections(path: Path, is_ours: Callable[[str], bool]) -> dict[str, dict[str, Any]]:
    """Return the full name of each section, and its parameters by their full names.

    In a name `*` stands for one part and `**` for any number. What is given twice is joined, be it
    a section or a group; of a parameter that is, the last value counts.

    Args:
        path: Of the file.
        is_ours: Tells by its name whether a section is for the node that asks. In those of other
            nodes it does not matter which of two values rcl takes.

    Raises:
        NoSectionsError: The file holds none.
        ParameterError: It can't be read, or rcl would refuse a value, or take another of two.
        GyroDriftFilterError: PyYAML is missing.
    """
    pairs = _load(path)
    try:
        return _joined(pairs, is_ours)
    except ParameterError as error:
        raise ParameterError(f'parameter file {path}: {error}') from error


def is_section_of(section: str, node: str) -> bool:
    """Tell whether a node, by its full name, gets the parameters of a section, as rclpy sees it."""
    pattern = re.escape(section).replace(r'/\*', r'(/\w+)')
    return re.fullmatch(pattern.replace(r'\*', '*'), node) is not None


def note_unknown(name: str, sections: list[str]) -> str:
    """Return what to say of a parameter that does not exist, given in these sections.

    Raises:
        ParameterError: It is meant for this node: by the name of a section, or by its own, which is
            nearly that of one that exists. In a section for many nodes it may be for another.
    """
    is_group = name in GROUPS
    if is_misspelt(name) or not all(section.endswith('*') for section in sections or ['']):
        raise ParameterError(_without_value(name) if is_group else unknown_name(name))
    unknown = _without_value(name) if is_group else f"unknown parameter '{name}'"
    return f'{unknown}: taken to be for another node, as its section is for many'


def _without_value(group: str) -> str:
    first = next(each.name for each in DESCRIPTIONS if each.name.startswith(f'{group}.'))
    return f"'{group}' is a group of parameters, such as '{first}', and has no value of its own"


def _load(path: Path) -> _Pairs:
    try:
        import yaml

        from gyro_drift_filter.messages.rcl_yaml import RclLoader
    except ImportError as error:
        raise GyroDriftFilterError(
            "parameter files need the Python package PyYAML: install it with 'pip install PyYAML' "
            "or 'apt install python3-yaml'"
        ) from error

    try:
        # A subclass of SafeLoader.
        document = yaml.load(_text(path), RclLoader)
    except OSError as error:
        raise ParameterError(f'parameter file {path}: {error.strerror}') from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise ParameterError(f'parameter file {path} is no YAML: {yaml_reason(error)}') from error
    if not isinstance(document, tuple):
        raise NoSectionsError(f'parameter file {path} holds no node names')
    return document


def _text(path: Path) -> str:
    with path.open('rb') as file:
        data = file.read(LARGEST_FILE + 1)
    if len(data) > LARGEST_FILE:
        raise ParameterError(f'parameter file {path} is longer than {LARGEST_FILE} bytes')
    return data.decode('utf-8')


def _joined(document: _Pairs, is_ours: Callable[[str], bool]) -> dict[str, dict[str, Any]]:
    sections: dict[str, dict[str, Any]] = {}
    for section, pairs in _sections('', document):
        content = sections.setdefault(section, {})
        for name, value in _flat('', pairs):
            why = _why_refused(value)
            if not why and is_ours(section):
                why = _why_mistaken(value, content.get(name, value))
            if why:
                raise ParameterError(f"parameter '{name}' {why}")
            content[name] = value
    return sections


def _sections(prefix: str, document: _Pairs) -> Iterator[tuple[str, _Pairs]]:
    """Yield node names and their parameters; namespaces may be nested or joined by slashes.

    Raises:
        ParameterError: There is what rcl takes for a value outside of `ros__parameters`.
    """
    for key, value in document:
        if not isinstance(value, tuple):
            raise ParameterError(
                f"'{key}' is in no section '{NODE_NAME}' or other with '{_CONTENT}' above it: "
                'move it below one'
            )
        name = f'{prefix}/{str(key).strip("/")}'
        contents = [content for inner, content in value if inner == _CONTENT]
        if len(contents) > 1:
            raise ParameterError(f"section '{key}' has '{_CONTENT}' twice: join them")
        if contents and not isinstance(contents[0], tuple):
            raise ParameterError(f"section '{key}' has no parameters below its '{_CONTENT}'")
        yield from ((name, content) for content in contents)
        yield from _sections(name, tuple(pair for pair in value if pair[0] != _CONTENT))


def _flat(prefix: str, pairs: _Pairs) -> Iterator[tuple[str, Any]]:
    for key, value in pairs:
        name = f'{prefix}{key}'
        if isinstance(value, tuple) and value:
            yield from _flat(f'{name}.', value)
        else:
            yield name, value


def _why_refused(value: Any) -> str:
    """Return why rcl refuses a file with this value in it, whatever node it is for."""
    if value is None:
        return 'has no value'
    if {int, float} <= _types(value):
        return 'is a list of whole and other numbers: write 0.0, not 0, where others have a point'
    return ''


def _why_mistaken(value: Any, before: Any) -> str:
    """Return why a node can't take a parameter, or would get another value than the last one."""
    if value == ():
        return 'has no value'
    # rcl keeps one value of each type, and takes the whole number though another one came later.
    if _types(value) != _types(before):
        return 'is given twice, with values of different types: leave one'
    return ''


def _types(value: Any) -> set[type]:
    return {list, *map(type, value)} if isinstance(value, list) else {type(value)}
