"""The parameters that users set: names, units, ranges and what they mean, in one table."""

import dataclasses
import difflib
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.errors import ParameterError

# Parameters that every ROS 2 node has.
OF_EVERY_NODE = ('use_sim_time', 'qos_overrides', 'start_type_description_service')

AXES = ('x', 'y', 'z')


@dataclass(frozen=True)
class Description:
    """What a user is told of one parameter.

    Attributes:
        name: ROS 2 name, with a dot between group and name.
        kind: 'string', 'bool', 'integer', 'double' or 'double_array' (one value per axis x, y, z).
        text: What it does, with its unit.
        low: Smallest value, itself allowed unless `low_excluded`.
        high: Largest value, itself allowed unless `high_excluded`.
        choices: The allowed strings.
    """

    name: str
    kind: str
    text: str
    low: float = -math.inf
    high: float = math.inf
    low_excluded: bool = False
    high_excluded: bool = False
    choices: tuple[str, ...] = ()

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
            return self._check_choice(value)
        if self.kind == 'bool':
            if isinstance(value, bool):
                return value
            raise ParameterError(f"parameter '{self.name}' must be true or false, not {value!r}")
        if self.kind == 'integer':
            if type(value) is not int:
                raise ParameterError(
                    f"parameter '{self.name}' must be a whole number, not {value!r}"
                )
            return int(self._check_number(value, ''))
        if self.kind == 'double':
            return self._check_number(value, '')
        if isinstance(value, str) or not hasattr(value, '__len__') or len(value) != len(AXES):
            shown = value if isinstance(value, str) or not hasattr(value, '__len__') else [*value]
            raise ParameterError(
                f"parameter '{self.name}' must be a list of three numbers, one per axis x, y, z, "
                f'not {shown!r}'
            )
        return tuple(
            self._check_number(v, f' (axis {axis})') for v, axis in zip(value, AXES, strict=True)
        )

    def _check_choice(self, value: Any) -> str:
        if isinstance(value, str) and value in self.choices:
            return value
        raise ParameterError(f"parameter '{self.name}' must be {self.limits}, not {value!r}")

    def _check_number(self, value: Any, where: str) -> float:
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number:
            raise ParameterError(f"parameter '{self.name}'{where} must be a number, not {value!r}")
        inside = (self.low < value if self.low_excluded else self.low <= value) and (
            value < self.high if self.high_excluded else value <= self.high
        )
        # An integer can be larger than any float.
        if not (inside and abs(value) <= sys.float_info.max):
            raise ParameterError(
                f"parameter '{self.name}'{where} must be {self.limits or 'finite'}, not {value!r}"
            )
        return float(value)


def _parameter(default: Any, name: str, kind: str, text: str, **limits: Any) -> Any:
    description = Description(name, kind, text, **limits)
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
        'string',
        'Filter: adaptive follows motion and smooths at rest; kalman is the conventional Kalman '
        'filter of the paper, equations (5) to (12), and sage_husa the one that adapts its noise '
        'statistics, equations (7) to (17): both for a gyroscope that hardly moves.',
        choices=METHOD_NAMES,
    )
    forgetting_factor: float = _parameter(
        0.98,
        'forgetting_factor',
        'double',
        'How much weight the adapted noise statistics keep from one update to the next (b of '
        'equation (13)): 0.98 remembers about 50 updates. sage_husa updates at every sample, for '
        'adaptive an update is a tenth of a second of rest. The paper uses 0.95 to 0.99. Without '
        'unit.',
        low=0.9,
        high=0.9999,
    )
    epsilon: float = _parameter(
        2.0e-2,
        'epsilon',
        'double',
        'Half the width of the band in which the square of a sample may differ from its expected '
        'value before it counts as an outlier (equation (18)), in (rad/s)^2. Raise it if motion '
        'is flagged. Of kalman and sage_husa.',
        low=0.0,
        low_excluded=True,
        high=1.0e4,
    )
    outlier_enabled: bool = _parameter(
        True,
        'outlier.enabled',
        'bool',
        'Whether outliers are shortened (equations (18) to (20)) or held back (adaptive), or taken '
        'as they are.',
    )
    outlier_threshold: float = _parameter(
        9.0,
        'outlier.threshold',
        'double',
        'A sample further than this from its prediction, in predicted standard deviations, is held '
        'back until the samples after it tell whether it was motion. Of adaptive.',
        low=3.0,
        high=100.0,
    )
    outlier_acceleration: float = _parameter(
        80.0,
        'outlier.acceleration',
        'double',
        'A sample that the body could reach from its prediction with this angular acceleration, in '
        'rad/s^2, is never held back. Of adaptive.',
        low=0.0,
        high=1.0e6,
    )
    outlier_run: int = _parameter(
        3,
        'outlier.run',
        'integer',
        'Longest run of equal outliers that the gyroscope delivers, in samples. A real step is '
        'followed one sample after that, one beyond 1000 rad/s^2 three samples after. Of adaptive.',
        low=1,
        high=20,
    )
    sample_rate: float = _parameter(
        0.0,
        'sample_rate',
        'double',
        'Rate of the gyroscope in Hz, and the rate that the model below belongs to. '
        '0 learns it from the stamps.',
        low=0.0,
        high=10_000.0,
    )
    gap_limit: float = _parameter(
        1.0,
        'gap_limit',
        'double',
        'Longest gap between two stamps, in s, that is bridged by prediction. After a longer one, '
        'or a longer jump backward, the filter starts from the sample at hand.',
        low=0.001,
        high=10.0,
    )
    bias_enabled: bool = _parameter(
        True,
        'bias.enabled',
        'bool',
        'Whether the bias, learned whenever the sensor stands still, is taken off the rates. It is '
        'learned in any case.',
    )
    bias_max: float = _parameter(
        0.17453292519943295,
        'bias.max',
        'double',
        'Largest bias per axis, in rad/s (0.1745 is 10 deg/s). A faster constant rate counts as a '
        'turn.',
        low=0.0,
        high=10.0,
    )
    bias_random_walk: float = _parameter(
        1.6e-4,
        'bias.random_walk',
        'double',
        'How fast the bias may wander at most, in rad/s per square root of a second (1.6e-4: 0.07 '
        'deg/s in a minute). How fast it does is learned. Lower it if slow turns are taken for '
        'bias, raise it if a bias that warms up is not followed.',
        low=1.0e-8,
        high=0.1,
    )
    bias_initial: tuple[float, float, float] = _parameter(
        (0.0, 0.0, 0.0),
        'bias.initial',
        'double_array',
        'Bias per axis until the first rest, in rad/s, where none is remembered.',
        low=-10.0,
        high=10.0,
    )
    bias_calibration_time: float = _parameter(
        5.0,
        'bias.calibration_time',
        'double',
        'How long ~/calibrate averages the rate at rest, in s.',
        low=0.5,
        high=600.0,
    )
    bias_memory: bool = _parameter(
        True,
        'bias.memory',
        'bool',
        'Whether the bias is kept in a file under ROS_HOME (~/.ros) and taken from there at the '
        'next start. Of the node.',
    )
    motion_hint: str = _parameter(
        'none',
        'motion_hint',
        'string',
        'Type of the messages on the topic motion_hint, by which the robot says whether it moves: '
        'a motion says that this is no rest, standing still that a constant rate is bias.',
        choices=('none', 'twist', 'twist_stamped', 'odometry'),
    )
    bias_temperature_step: float = _parameter(
        2.0,
        'bias.temperature_step',
        'double',
        'Change of imu/temperature in K from which on the bias becomes uncertain.',
        low=0.1,
        high=100.0,
    )
    bias_temperature_coefficient: float = _parameter(
        5.0e-4,
        'bias.temperature_coefficient',
        'double',
        'How far the bias may move per K, in rad/s (5e-4 is 0.03 deg/s).',
        low=0.0,
        high=0.1,
    )
    model_phi: tuple[float, float, float] = _parameter(
        (0.218, 0.218, 0.218),
        'model.phi',
        'double_array',
        'Coefficient of the first-order autoregressive drift per axis (phi of equation (2)), '
        'without unit.',
        low=-1.0,
        low_excluded=True,
        high=1.0,
        high_excluded=True,
    )
    model_process_noise: tuple[float, float, float] = _parameter(
        (2.38e-5, 2.38e-5, 2.38e-5),
        'model.process_noise',
        'double_array',
        'Variance of the noise that drives the drift per axis (Q; the paper takes the variance of '
        'the residuals of the autoregressive model), in (rad/s)^2.',
        low=0.0,
        low_excluded=True,
        high=1.0e6,
    )
    model_measurement_noise: tuple[float, float, float] = _parameter(
        (2.5e-5, 2.5e-5, 2.5e-5),
        'model.measurement_noise',
        'double_array',
        'Variance of the measurement per axis (R; the paper takes the variance of the motionless '
        'recording), in (rad/s)^2.',
        low=0.0,
        low_excluded=True,
        high=1.0e6,
    )

    model_noise_deviation: tuple[float, float, float] = _parameter(
        (0.0, 0.0, 0.0),
        'model.noise_deviation',
        'double_array',
        'Standard deviation of the noise at rest per axis, in rad/s, that learning starts from, '
        'with model.phi as its correlation; 0 learns both from the first samples. Of adaptive.',
        low=0.0,
        high=1.0e3,
    )

    def __post_init__(self) -> None:
        """Check all values and bring them into their own types."""
        for field, description in _FIELDS.items():
            object.__setattr__(self, field, description.check(getattr(self, field)))

    @classmethod
    def from_names(cls, values: Mapping[str, Any]) -> 'Parameters':
        """Return parameters from ROS 2 names such as 'model.phi'; the others keep their defaults.

        Raises:
            ParameterError: A name is unknown or a value is wrong.
        """
        by_name = {description.name: field for field, description in _FIELDS.items()}
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
        return {description.name: getattr(self, field) for field, description in _FIELDS.items()}


_FIELDS: dict[str, Description] = {
    field.name: field.metadata['description'] for field in dataclasses.fields(Parameters)
}

DESCRIPTIONS: tuple[Description, ...] = tuple(_FIELDS.values())


def unknown_name(name: str) -> str:
    """Return the message for a parameter that does not exist, with the nearest one that does."""
    names = [description.name for description in DESCRIPTIONS]
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean '{near[0]}'?" if near else f'there are {", ".join(names)}'
    return f"unknown parameter '{name}': {hint}"
