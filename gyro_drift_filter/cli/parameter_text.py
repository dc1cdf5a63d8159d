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

"""The text of ROS 2 parameter files, as commands write them."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import chain
from typing import Any

import numpy as np

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.parameters import AXES, FIELDS
from gyro_drift_filter.errors import GyroDriftFilterError


def parameter_text(
    head: Sequence[str], values: Mapping[str, Any], remarks: Mapping[str, Sequence[str]]
) -> str:
    """Return the text of a file with values and remarks by the names of their parameters.

    Its head, and the remarks above parameters, are lines of comments.

    Raises:
        ParameterError: The node and replay would refuse the file.
    """
    Parameters.from_names({name: _flat(value) for name, value in values.items()})
    groups: dict[str, list[str]] = {'': []}
    for name, value in values.items():
        group, _, last = name.rpartition('.')
        indent = (6 if group else 4) * ' '
        lines = groups.setdefault(group, [f'    {group}:'])
        lines += [f'{indent}# {remark}' for remark in remarks.get(name, ())]
        lines.append(f'{indent}{last}: {as_yaml(value)}')
    comments = [f'# {line}' for line in head]
    return '\n'.join([*comments, '/**:', '  ros__parameters:', *chain(*groups.values()), ''])


def as_yaml(value: Any) -> str:
    """Return a value as both YAML and rcl read it, an array row by row: a double has a point."""
    value = _flat(value)
    if isinstance(value, tuple):
        return f'[{", ".join(map(as_yaml, value))}]'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and 0.0 < abs(value) < 1e-3:
        return np.format_float_scientific(value, trim='0', exp_digits=1)
    return str(value)


def _flat(value: Any) -> Any:
    """Return an array as a tuple, row by row, and any other value as it is."""
    return tuple(value.ravel().tolist()) if isinstance(value, np.ndarray) else value


def bias_parameters(bias: Sequence[float]) -> dict[str, Any]:
    """Return the parameters of a sensor with a bias (3,) in rad/s, by their names.

    Where the bias lies beyond the default of `bias.max`, that is raised to what it may be at the
    next start.

    Raises:
        GyroDriftFilterError: The node and replay would refuse it.
    """
    default, largest = Parameters(), FIELDS['bias_initial'].high
    for axis, rate in zip(AXES, bias, strict=True):
        if abs(rate) > largest:
            raise GyroDriftFilterError(
                f'the bias about {axis} is {rate:.4g} rad/s, where {largest:g} is the most that is '
                'taken: are the rates in deg/s?'
            )
    values = {}
    if (size := max(map(abs, bias))) > default.bias_max:
        values['bias.max'] = min(size + default.bias_turn_on_deviation, FIELDS['bias_max'].high)
    return values | {'bias.initial': tuple(bias)}


def today() -> str:
    """Return the day on which a file is written, for a comment in it."""
    return datetime.now(UTC).strftime('%Y-%m-%d')
