"""The parameters as kernels read them: a record with a field for each value of `Parameters`."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.core.parameters import AXES, FIELDS, Parameters

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

SETTINGS = np.dtype(
    [(name, _TYPES[description.kind]) for name, description in FIELDS.items()], align=True
)


def settings_of(parameters: Parameters) -> NDArray[Any]:
    """Return an array (1,) of SETTINGS with the values of the parameters."""
    settings = np.zeros(1, SETTINGS)
    for name, description in FIELDS.items():
        value = getattr(parameters, name)
        chosen = description.kind == 'string'
        settings[0][name] = description.choices.index(value) if chosen else value
    return settings
