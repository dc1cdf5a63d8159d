"""The parameters as kernels read them: a record with a field for each value of `Parameters`."""

import dataclasses
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.core.parameters import AXES, Description, Parameters

# A record of SETTINGS. It has the fields of `Parameters`; a choice of several strings stands there
# as its index among them.
Settings: TypeAlias = np.void

_TYPES: dict[str, Any] = {
    'string': np.int64,
    'bool': np.bool_,
    'integer': np.int64,
    'double': np.float64,
    'double_array': (np.float64, (len(AXES),)),
}
_DESCRIPTIONS: dict[str, Description] = {
    field.name: field.metadata['description'] for field in dataclasses.fields(Parameters)
}

SETTINGS = np.dtype(
    [(name, _TYPES[description.kind]) for name, description in _DESCRIPTIONS.items()], align=True
)


def settings_of(parameters: Parameters) -> NDArray[Any]:
    """Return an array (1,) of SETTINGS with the values of the parameters."""
    settings = np.zeros(1, SETTINGS)
    for name, description in _DESCRIPTIONS.items():
        value = getattr(parameters, name)
        chosen = description.kind == 'string'
        settings[0][name] = description.choices.index(value) if chosen else value
    return settings
