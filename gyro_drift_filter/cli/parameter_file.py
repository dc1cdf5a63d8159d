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

"""ROS 2 parameter files: `replay` takes those that the node takes."""

import logging
from pathlib import Path
from typing import Any

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.parameters import DESCRIPTIONS, OF_EVERY_NODE
from gyro_drift_filter.errors import ParameterError
from gyro_drift_filter.messages.names import NODE_NAME
from gyro_drift_filter.messages.parameter_sections import note_unknown, read_sections

_log = logging.getLogger(__name__)

_NAMES = {description.name for description in DESCRIPTIONS}


def read_parameters(path: Path) -> Parameters:
    """Return the filter's parameters from a ROS 2 parameter file.

    Taken are the sections that rcl gives to a node called gyro_drift_filter, in whatever namespace;
    `*` stands for one part of a name and `**` for any number. A parameter that does not exist is
    what it is to the node: an error, or a warning where it may be meant for another one.

    Raises:
        ParameterError: The file can't be read, has no such section or several for different
            namespaces, a parameter that does not exist or a wrong value.
        GyroDriftFilterError: PyYAML is missing.
    """
    values: dict[str, Any] = {}
    for name, content in _ours(path).items():
        for key, value in content.items():
            if key.split('.')[0] in OF_EVERY_NODE:
                continue
            if key in _NAMES:
                values[key] = value
                continue
            try:
                _log.warning('parameter file %s: %s', path, note_unknown(key, [name]))
            except ParameterError as error:
                raise ParameterError(f'parameter file {path}: {error}') from error
    try:
        return Parameters.from_names(values)
    except ParameterError as error:
        raise ParameterError(f'parameter file {path}: {error}') from error


def _ours(path: Path) -> dict[str, dict[str, Any]]:
    """Return the sections of our node by their names; as for rcl the last one wins."""
    sections = read_sections(path, _is_ours)
    found = {name: content for name, content in sections.items() if _is_ours(name)}
    if not found:
        others = f', only for {", ".join(sections)}' if sections else ''
        raise ParameterError(
            f"parameter file {path} has no section '{NODE_NAME}' with 'ros__parameters' in it"
            f"{others}: begin it with '/**:' and, indented below that, 'ros__parameters:'"
        )
    named = [name for name in found if '*' not in name]
    if len(named) > 1:
        raise ParameterError(
            f'parameter file {path} has sections for several nodes: {", ".join(named)}: leave one'
        )
    return found


def _is_ours(section: str) -> bool:
    return section.rpartition('/')[2] in (NODE_NAME, '*', '**')
