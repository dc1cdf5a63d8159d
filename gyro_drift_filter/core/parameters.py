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

"""The parameters that users set: names, units, ranges and what they mean, in one table.

The node, parameter files, config/gyro_drift_filter.yaml and docs/parameters.md follow this table;
`make parameters` writes the latter two anew.
"""

import dataclasses
import difflib
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.errors import ParameterError

# Parameters that every ROS 2 node has.
OF_EVERY_NODE = ('use_sim_time', 'qos_overrides', 'start_type_description_service')

AXES = ('x', 'y', 'z')

# What the parameters of a group have in common.
GROUPS = {
    'input': 'What the driver delivers.',
    'outlier': 'What becomes of samples far from their prediction.',
    'bias': 'The bias is learned whenever the sensor stands still.',
    'calibration': 'Scale and misalignment of the axes, and what accelerations do to them; '
    '`gyro_drift calibrate` finds those of a sensor.',
    'model': 'The drift model of the paper, and the noise at rest; one value per axis x, y, z. '
    '`gyro_drift identify` finds those of a sensor.',
}

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
NO_SENSITIVITY = (0.0,) * 9
# What is beyond these is no calibration but another unit, a swapped axis, or how it is mounted.
SCALES = 0.5, 2.0
LARGEST_TURN = 20.0  # deg

_KINDS = {str: 'string', bool: 'bool', int: 'integer', float: 'double', tuple: 'double_array'}


@dataclass(frozen=True)
class Description:
    """What users read about one parameter, and which values it takes.

    Attributes:
        name: ROS 2 name, with a dot between group and name.
        kind: 'string', 'bool', 'integer', 'double' or 'double_array'.
        text: What it does.
        unit: The unit of its value, empty for a plain number.
        low: Smallest value, itself allowed unless `low_excluded`.
        high: Largest value, itself allowed unless `high_excluded`.
        choices: The allowed strings.
        size: Of an array: one value per axis x, y, z, or 9 of a matrix, row by row.
    """

    name: str
    kind: str
    text: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    low_excluded: bool = False
    high_excluded: bool = False
    choices: tuple[str, ...] = ()
    size: int = len(AXES)

    @property
    def meaning(self) -> str:
        """What it does, with its unit."""
        return f'{self.text} Unit: {self.unit}.' if self.unit else self.text

    @property
    def limits(self) -> str:
        """The allowed values in words, for descriptions and error messages."""
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        parts = []
        if self.low > -math.inf:
            parts.append(f'{"greater than" if self.low_excluded else "at least"} {self.low:g}')
        if self.high < math.inf:
            parts.append(f'{"less than" if self.high_excluded else "at most"} {self.high:g}')
        return ' and '.join(parts)

    def check(self, value: Any) -> Any:
        """Return `value` in the parameter's own type.

        An integer is taken where a double belongs; a sequence becomes a tuple.

        Raises:
            ParameterError: The type is wrong or the value lies outside the range.
        """
        if self.kind == 'string':
            if isinstance(value, str) and value in self.choices:
                return value
            raise self._refusal(value, self.limits)
        if self.kind == 'bool':
            if isinstance(value, bool):
                return value
            raise self._refusal(value, 'true or false')
        if self.kind == 'integer':
            if type(value) is not int:
                raise self._refusal(value, 'a whole number')
            return int(self._check_number(value))
        if self.kind == 'double':
            return self._check_number(value)
        names, each = [f'axis {axis}' for axis in AXES], 'three numbers, one per axis x, y, z'
        if self.size > len(AXES):
            each = 'nine numbers, row by row'
            names = [f'row {row}, column {column}' for row in AXES for column in AXES]
        is_sequence = hasattr(value, '__len__') and not isinstance(value, str)
        if not is_sequence or len(value) != self.size:
            raise self._refusal([*value] if is_sequence else value, f'a list of {each}')
        return tuple(
            self._check_number(v, f' ({name})') for v, name in zip(value, names, strict=True)
        )

    def _refusal(self, value: Any, needed: str, where: str = '') -> ParameterError:
        return ParameterError(f"parameter '{self.name}'{where} must be {needed}, not {value!r}")

    def _check_number(self, value: Any, where: str = '') -> float:
        if not isinstance(value, (int, float)) or isinstance(value, bool):
            raise self._refusal(value, 'a number', where)
        inside = (self.low < value if self.low_excluded else self.low <= value) and (
            value < self.high if self.high_excluded else value <= self.high
        )
        # An integer can be larger than any float.
        if not (inside and abs(value) <= sys.float_info.max):
            raise self._refusal(value, self.limits or 'finite', where)
        return float(value)


def _parameter(default: Any, name: str, text: str, **limits: Any) -> Any:
    description = Description(name, _KINDS[type(default)], text, **limits)
    return dataclasses.field(default=default, metadata={'description': description})


@dataclass(frozen=True)
class Parameters:
    """All that a user can set, in SI units. Checked as a whole when it is made.

    Raises:
        ParameterError: A value has the wrong type or lies outside its range.
    """

    method: str = _parameter(
        'adaptive',
        'method',
        'The filter. adaptive follows motion and smooths at rest. kalman is the conventional '
        'Kalman filter of the paper, equations (5) to (12), and sage_husa the same with its noise '
        'statistics adapted, equations (7) to (17): both are for a gyroscope that hardly moves.',
        choices=METHOD_NAMES,
    )
    forgetting_factor: float = _parameter(
        0.98,
        'forgetting_factor',
        'How much weight the adapted noise statistics keep from one update to the next (b of '
        'equation (13)): 0.98 remembers about 50 updates. sage_husa updates at every sample, '
        'adaptive after every half second of rest, as if that were five updates. The paper uses '
        '0.95 to 0.99.',
        low=0.9,
        high=0.9999,
    )
    epsilon: float = _parameter(
        2.0e-2,
        'epsilon',
        'Half the width of the band in which the square of a sample may differ from its expected '
        'value before it counts as an outlier (equation (18)). The band is in squares, so it '
        'grows tight as the robot turns: raise it if motion is flagged. For kalman and sage_husa.',
        unit='(rad/s)^2',
        low=0.0,
        low_excluded=True,
        high=1.0e4,
    )
    sample_rate: float = _parameter(
        0.0,
        'sample_rate',
        'Rate of the gyroscope, and the rate that the values of model.* belong to. 0 learns it '
        'from the stamps; less than 1 Hz counts as 1 Hz.',
        unit='Hz',
        low=0.0,
        high=10_000.0,
    )
    gap_limit: float = _parameter(
        1.0,
        'gap_limit',
        'Longest gap between two stamps that is bridged by prediction. After a longer one, or a '
        'longer jump backward, the filter starts anew from the present sample.',
        unit='s',
        low=0.001,
        high=10.0,
    )
    input_quantisation: str = _parameter(
        'auto',
        'input.quantisation',
        'How the sensor quantises. truncate: it cuts values towards zero to whole counts, and half '
        'a count is added again; round or none: rates are used as they are. auto finds out at '
        'rest, within seconds, or in motion, within minutes, and adds half a count from then on if '
        'it is needed.',
        choices=('auto', 'none', 'round', 'truncate'),
    )
    motion_hint: str = _parameter(
        'none',
        'motion_hint',
        'Type of the messages on the topic motion_hint, by which the robot says whether it moves. '
        'While it moves, no bias is learned. While it stands, the mean of the measured rates is '
        'the bias, even where it is shaken and never still.',
        choices=('none', 'twist', 'twist_stamped', 'odometry'),
    )
    outlier_enabled: bool = _parameter(
        True,
        'outlier.enabled',
        'Whether outliers are shortened (kalman and sage_husa, equations (18) to (20)) or held '
        'back (adaptive); false takes them as they are.',
    )
    outlier_threshold: float = _parameter(
        7.0,
        'outlier.threshold',
        'A sample is held back where its innovation is beyond both this and outlier.acceleration; '
        'the samples after it show whether it was motion. For adaptive.',
        unit='typical innovations (in motion less than the root of ~/innovation_variance, with '
        'correlated noise more)',
        low=3.0,
        high=100.0,
    )
    outlier_acceleration: float = _parameter(
        80.0,
        'outlier.acceleration',
        'A sample is held back where its innovation is beyond both outlier.threshold and what the '
        'body could reach in one sample period with this angular acceleration; below 50 Hz more, '
        'as less of a motion is foreseen. While the sensor stands still, a smaller limit takes the '
        'place of this one. What no body does is held back anyway. For adaptive; with the other '
        'methods it tells which of the samples that they flag show the bias in motion.',
        unit='rad/s^2',
        low=0.0,
        high=1.0e6,
    )
    outlier_run: int = _parameter(
        3,
        'outlier.run',
        'Longest run of equal outliers that the gyroscope delivers. A real step is followed one '
        'sample after that, one beyond 1000 rad/s^2 three samples after. For adaptive.',
        unit='samples',
        low=1,
        high=20,
    )
    bias_enabled: bool = _parameter(
        True,
        'bias.enabled',
        'Whether the bias is subtracted from the rates. It is learned in any case. If it is not '
        'subtracted, angular_velocity_covariance is that of the noise alone.',
    )
    bias_in_motion: bool = _parameter(
        True,
        'bias.in_motion',
        'Whether the bias is followed in motion, too, where gravity shows it. It needs an '
        'accelerometer.',
    )
    bias_max: float = _parameter(
        0.17453292519943295,
        'bias.max',
        'Largest bias on an axis; a faster constant rate counts as a turn. 0.1745 is 10 deg/s.',
        unit='rad/s',
        low=0.0,
        high=10.0,
    )
    bias_random_walk: float = _parameter(
        1.6e-4,
        'bias.random_walk',
        'How fast the bias may wander at most; how fast it does is learned. 1.6e-4 is 0.07 deg/s '
        'in a minute. Lower it if slow turns are taken for bias, raise it if a bias that warms up '
        'is not followed.',
        unit='rad/s per square root of a second',
        low=1.0e-8,
        high=0.1,
    )
    bias_initial: tuple[float, float, float] = _parameter(
        (0.0, 0.0, 0.0),
        'bias.initial',
        'Bias of each axis x, y, z until the first rest, where none is remembered; at most '
        'bias.max. Another value that is set while the node runs replaces what was learned of the '
        'bias.',
        unit='rad/s',
        low=-10.0,
        high=10.0,
    )
    bias_turn_on_deviation: float = _parameter(
        0.04,
        'bias.turn_on_deviation',
        'Standard deviation of bias.initial, part of angular_velocity_covariance until the first '
        'rest: half of what the data sheet gives as +/- zero-rate offset. 0.04 is 2.3 deg/s, for '
        'the 3 to 5 deg/s of many MEMS gyroscopes; the best have 0.5, an MPU-6050 20.',
        unit='rad/s',
        low=0.0,
        high=10.0,
    )
    bias_calibration_time: float = _parameter(
        5.0,
        'bias.calibration_time',
        'How long ~/calibrate averages the rate at rest.',
        unit='s',
        low=0.5,
        high=600.0,
    )
    bias_memory: bool = _parameter(
        True,
        'bias.memory',
        'Whether the node keeps the bias in a file under ROS_HOME (~/.ros), and takes it from '
        'there at its next start.',
    )
    bias_temperature_step: float = _parameter(
        2.0,
        'bias.temperature_step',
        'A change of imu/temperature by more than this makes the bias less certain.',
        unit='K',
        low=0.1,
        high=100.0,
    )
    bias_temperature_coefficient: float = _parameter(
        5.0e-4,
        'bias.temperature_coefficient',
        'How far the bias may move with the temperature. 5e-4 is 0.03 deg/s for each kelvin.',
        unit='rad/s per K',
        low=0.0,
        high=0.1,
    )
    calibration_matrix: tuple[float, ...] = _parameter(
        IDENTITY,
        'calibration.matrix',
        'Applied last, after the bias is subtracted: nine numbers, row by row. Refused '
        'where a scale lies outside of 0.5 to 2 or an axis is turned by more than 20 deg. Bias, '
        "noise and outliers stay those of the sensor's own axes.",
        low=-2.5,
        high=2.5,
        size=len(IDENTITY),
    )
    calibration_acceleration_sensitivity: tuple[float, ...] = _parameter(
        NO_SENSITIVITY,
        'calibration.acceleration_sensitivity',
        'What each m/s^2 along an axis adds to the rates (g-sensitivity), subtracted first: nine '
        'numbers, row by row. 1e-4 is 0.06 deg/s for 1 g. Needs the linear acceleration of the '
        'Imu.',
        unit='rad/s per m/s^2',
        low=-0.01,
        high=0.01,
        size=len(NO_SENSITIVITY),
    )
    model_phi: tuple[float, float, float] = _parameter(
        (0.218, 0.218, 0.218),
        'model.phi',
        'Coefficient of the first-order autoregressive drift (phi of equation (2)).',
        low=-1.0,
        low_excluded=True,
        high=1.0,
        high_excluded=True,
    )
    model_process_noise: tuple[float, float, float] = _parameter(
        (2.38e-5, 2.38e-5, 2.38e-5),
        'model.process_noise',
        'Variance of the noise that drives the drift (Q; the paper takes the variance of the '
        'residuals of the autoregressive model). For kalman and sage_husa.',
        unit='(rad/s)^2',
        low=0.0,
        low_excluded=True,
        high=1.0e6,
    )
    model_measurement_noise: tuple[float, float, float] = _parameter(
        (2.5e-5, 2.5e-5, 2.5e-5),
        'model.measurement_noise',
        'Variance of the measurement (R; the paper takes the variance of the motionless '
        'recording). For kalman and sage_husa.',
        unit='(rad/s)^2',
        low=0.0,
        low_excluded=True,
        high=1.0e6,
    )
    model_noise_deviation: tuple[float, float, float] = _parameter(
        (0.0, 0.0, 0.0),
        'model.noise_deviation',
        'Standard deviation of the noise at rest that learning starts from, with model.phi as its '
        'correlation; 0 learns both from the first samples. For adaptive.',
        unit='rad/s',
        low=0.0,
        high=1.0e3,
    )

    def __post_init__(self) -> None:
        """Check all values and bring them into their own types."""
        for field, description in FIELDS.items():
            object.__setattr__(self, field, description.check(getattr(self, field)))
        _check_bias(self.bias_initial, self.bias_max)
        if self.is_calibrated:
            _check_matrix(self.calibration_matrix)

    @property
    def is_calibrated(self) -> bool:
        """Whether there is a matrix to be applied."""
        return self.calibration_matrix != IDENTITY

    @property
    def is_sensitive(self) -> bool:
        """Whether accelerations are to be taken off."""
        return self.calibration_acceleration_sensitivity != NO_SENSITIVITY

    @classmethod
    def from_names(cls, values: Mapping[str, Any]) -> 'Parameters':
        """Return parameters from ROS 2 names such as 'model.phi'; the others keep their defaults.

        Raises:
            ParameterError: A name is unknown or a value is wrong.
        """
        by_name = {description.name: field for field, description in FIELDS.items()}
        for name in values:
            if name not in by_name:
                raise ParameterError(unknown_name(name))
        return cls(**{by_name[name]: value for name, value in values.items()})

    def with_names(self, values: Mapping[str, Any]) -> 'Parameters':
        """Return these parameters with some replaced, by ROS 2 name.

        Raises:
            ParameterError: As from `from_names`.
        """
        return Parameters.from_names({**self.names(), **values})

    def names(self) -> dict[str, Any]:
        """Return the values by ROS 2 name."""
        return {description.name: getattr(self, field) for field, description in FIELDS.items()}


def _check_bias(initial: tuple[float, ...], largest: float) -> None:
    """Check that the bias to begin with is one that rest may have.

    Raises:
        ParameterError: It is larger, so that no rest would ever replace it.
    """
    for axis, rate in zip(AXES, initial, strict=True):
        if abs(rate) > largest:
            raise ParameterError(
                f"parameter 'bias.initial' (axis {axis}) is {rate:g} rad/s, beyond bias.max, "
                f'{largest:g} rad/s: no rest would replace it'
            )


def _check_matrix(values: tuple[float, ...]) -> None:
    """Check what a matrix says of the sensor: a row of its inverse is what one axis measures.

    Raises:
        ParameterError: It is singular, or no calibration of a gyroscope.
    """
    matrix = np.reshape(values, (3, 3))
    try:
        measured = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        measured = np.zeros((3, 3))
    lengths = np.linalg.norm(measured, axis=1)
    if not (np.isfinite(measured).all() and lengths.all()):
        raise ParameterError("parameter 'calibration.matrix' is singular")
    for axis, name in enumerate(AXES):
        scale = 1.0 / lengths[axis]
        if not SCALES[0] <= scale <= SCALES[1]:
            raise ParameterError(
                f"parameter 'calibration.matrix' scales axis {name} by {scale:.3g}: a calibration "
                f'lies between {SCALES[0]:g} and {SCALES[1]:g}; is the unit rad/s?'
            )
        turn = math.degrees(math.acos(min(1.0, max(-1.0, measured[axis, axis] * scale))))
        if turn > LARGEST_TURN:
            raise ParameterError(
                f"parameter 'calibration.matrix' turns axis {name} by {turn:.3g} deg: a "
                f'calibration turns by {LARGEST_TURN:g} at most; tf says how the sensor is mounted'
            )


# By the names of the fields of `Parameters`.
FIELDS: dict[str, Description] = {
    field.name: field.metadata['description'] for field in dataclasses.fields(Parameters)
}

DESCRIPTIONS: tuple[Description, ...] = tuple(FIELDS.values())
_ALL_NAMES = [description.name for description in DESCRIPTIONS]


def unknown_name(name: str) -> str:
    """Return the message for a parameter that does not exist, with the nearest one that does."""
    near = difflib.get_close_matches(name, _ALL_NAMES, n=1)
    hint = f"did you mean '{near[0]}'?" if near else f'there are {", ".join(_ALL_NAMES)}'
    return f"unknown parameter '{name}': {hint}"


def is_misspelt(name: str) -> bool:
    """Tell whether a name that does not exist is as near to one that does as a slip leaves it."""
    return bool(difflib.get_close_matches(name, _ALL_NAMES, n=1, cutoff=0.8))
