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

"""The parameters as kernels read them: a record with a field for each value of `Parameters`."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.core.parameters import FIELDS, Description, Parameters

# A record of SETTINGS. It has the fields of `Parameters`; a choice of several strings stands there
# as its index among them.
Settings: TypeAlias = np.void

_TYPES: dict[str, Any] = {
    'string': np.int64,
    'bool': np.bool_,
    'integer': np.int64,
    'double': np.float64,
}


def _type(description: Description) -> Any:
    if description.kind == 'double_array':
        return np.float64, (description.size,)
    return _TYPES[description.kind]


# What decides in each step whether `calibration_matrix` is applied, and whether
# `calibration_acceleration_sensitivity` is.
_DECIDED = 'is_calibrated', 'is_sensitive'
SETTINGS = np.dtype(
    [
        *((name, _type(description)) for name, description in FIELDS.items()),
        *((name, np.bool_) for name in _DECIDED),
    ],
    align=True,
)


def settings_of(parameters: Parameters) -> NDArray[Any]:
    """Return an array (1,) of SETTINGS with the values of the parameters."""
    settings = np.zeros(1, SETTINGS)
    for name, description in FIELDS.items():
        value = getattr(parameters, name)
        chosen = description.kind == 'string'
        settings[0][name] = description.choices.index(value) if chosen else value
    for name in _DECIDED:
        settings[0][name] = getattr(parameters, name)
    return settings
