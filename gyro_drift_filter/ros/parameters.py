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

"""The filter's parameters as ROS 2 parameters: declared with descriptions, checked as a whole."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.parameters import DESCRIPTIONS, OF_EVERY_NODE, Description
from gyro_drift_filter.errors import ParameterError
from gyro_drift_filter.messages.parameter_sections import (
    NoSectionsError,
    is_section_of,
    note_unknown,
    read_sections,
)

_NAMES = {description.name: description for description in DESCRIPTIONS}


class LiveParameters:
    """Hold the parameters of a node; the node takes each valid change at once."""

    def __init__(
        self, node: Node, changed: Callable[[Parameters], None], files: Sequence[Path]
    ) -> None:
        """Declare the parameters.

        Args:
            node: Made with `automatically_declare_parameters_from_overrides`, so that what the
                user gave is there as it was typed: an integer where a double belongs, a name that
                does not exist.
            changed: Called with the new parameters after each change.
            files: The parameter files that the process was given.

        Raises:
            ParameterError: A name or a value is wrong.
        """
        self._node = node
        self._changed = changed
        # It is annotated to return values.
        found = cast(Mapping[str, Parameter], node.get_parameters_by_prefix(''))
        given = {
            name: parameter.value
            for name, parameter in found.items()
            if name.split('.')[0] not in OF_EVERY_NODE
        }
        sections = self._sections(files)
        for name in given:
            if name not in _NAMES:
                holders = [section for section, content in sections if name in content]
                node.get_logger().warning(note_unknown(name, holders))
        ours = {name: value for name, value in given.items() if name in _NAMES}
        self.current = Parameters.from_names(ours)
        for name in ours:
            node.undeclare_parameter(name)
        for name, value in self.current.names().items():
            value = list(value) if isinstance(value, tuple) else value
            node.declare_parameter(name, value, _descriptor(_NAMES[name]), ignore_override=True)
        node.add_pre_set_parameters_callback(self._with_doubles)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _sections(self, files: Sequence[Path]) -> list[tuple[str, dict[str, Any]]]:
        """Return the sections of files that are for the node; warn of a file that has none.

        Raises:
            ParameterError: A file can't be read. rcl may have read it otherwise (several documents,
                UTF-16), and what it took from there is not known.
        """
        node, log = self._node.get_fully_qualified_name(), self._node.get_logger()
        ours = []
        for file in files:
            try:
                sections = read_sections(file, lambda section: is_section_of(section, node))
            except NoSectionsError as error:
                log.warning(f'{error}: nothing of it is used')
                continue
            found = [item for item in sections.items() if is_section_of(item[0], node)]
            if not found:
                names = ', '.join(sections) or 'no node at all'
                log.warning(
                    f'parameter file {file} is not used: it has parameters for {names}, but this '
                    f'node is {node}. A section /**: is for every node'
                )
            ours += found
        return ours

    def _with_doubles(self, parameters: list[Parameter]) -> list[Parameter]:
        """Turn integers into doubles where doubles belong: `ros2 param set` types 1 as integer."""
        return [
            Parameter(parameter.name, value=_as_double(_NAMES[parameter.name], parameter.value))
            if parameter.name in _NAMES and parameter.value is not None
            else parameter
            for parameter in parameters
        ]

    def _candidate(self, parameters: list[Parameter]) -> Parameters:
        changes = {p.name: p.value for p in parameters if p.name in _NAMES}
        return self.current.with_names(changes)

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            self._candidate(parameters)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters: list[Parameter]) -> None:
        candidate = self._candidate(parameters)
        if candidate != self.current:
            self.current = candidate
            self._changed(candidate)


def _as_double(description: Description, value: Any) -> Any:
    if description.kind == 'double' and type(value) is int:
        return float(value)
    is_array = isinstance(value, Iterable) and not isinstance(value, str)
    if description.kind == 'double_array' and is_array:
        items = list(value)
        if all(type(item) is int for item in items):
            return [float(item) for item in items]
    return value


def _descriptor(description: Description) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=description.meaning,
        additional_constraints=description.limits,
    )
    low, high = description.low, description.high
    if description.kind == 'double':
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=low, to_value=high, step=0.0)
        ]
    if description.kind == 'integer':
        descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
    return descriptor
