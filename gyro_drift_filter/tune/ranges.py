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

"""Which parameters are tuned for a method, and between what."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core import Parameters


@dataclass(frozen=True)
class Range:
    """A parameter on its way from 0 to 1.

    Attributes:
        name: Of the parameter.
        low: Its value at 0.
        high: Its value at 1.
        scale: 'logarithm', or 'memory', the logarithm of 1 / (1 - value).
        of_noise: Whether low and high are for each axis in units of the variance of its noise.
    """

    name: str
    low: float
    high: float
    scale: str = 'logarithm'
    of_noise: bool = False

    def value(self, place: float, base: Parameters, noise: Floats) -> Any:
        """Return the value at a place from 0 to 1, of the type that the parameter has in `base`.

        `noise` (3,) is the standard deviation of each axis in rad/s.
        """
        low, high = self._scaled(self.low), self._scaled(self.high)
        number = low + min(max(place, 0.0), 1.0) * (high - low)
        number = 1.0 - math.exp(-number) if self.scale == 'memory' else math.exp(number)
        before = base.names()[self.name]
        if isinstance(before, tuple):
            units = noise**2 if self.of_noise else np.ones(len(before))
            return tuple(float(f'{v:.4g}') for v in number * units)
        return round(number) if isinstance(before, int) else float(f'{number:.4g}')

    def place(self, parameters: Parameters, noise: Floats) -> float:
        """Return where from 0 to 1 the value of these parameters lies, 0 and 1 where beyond."""
        values = np.atleast_1d(parameters.names()[self.name])
        if self.of_noise:
            values = values / noise**2
        values = np.clip(values, self.low, self.high)
        scaled = float(np.mean([self._scaled(value) for value in values]))
        low, high = self._scaled(self.low), self._scaled(self.high)
        return (scaled - low) / (high - low)

    def _scaled(self, value: float) -> float:
        return -math.log(1.0 - value) if self.scale == 'memory' else math.log(value)


# Thresholds from one below which noise is held back to one which nothing exceeds; accelerations
# from those of a ship to those of a blow.
_MEMORY = Range('forgetting_factor', 0.9, 0.9995, 'memory')
_ADAPTIVE = (
    Range('outlier.threshold', 3.0, 100.0),
    Range('outlier.acceleration', 1.0, 1.0e4),
    Range('outlier.run', 1.0, 10.0),
    _MEMORY,
)
_KALMAN = (
    Range('model.process_noise', 1.0e-8, 1.0e5, of_noise=True),
    Range('model.measurement_noise', 1.0e-3, 1.0e3, of_noise=True),
    Range('model.phi', -0.5, 0.995, 'memory'),
    Range('epsilon', 1.0e-5, 1.0e3),
)
RANGES: dict[str, tuple[Range, ...]] = {
    'adaptive': _ADAPTIVE,
    'kalman': _KALMAN,
    'sage_husa': (*_KALMAN, _MEMORY),
}


def at_places(
    ranges: Sequence[Range], places: Sequence[float], base: Parameters, noise: Floats
) -> Parameters:
    """Return parameters with the values at these places, one for each range."""
    values = {r.name: r.value(p, base, noise) for r, p in zip(ranges, places, strict=True)}
    return base.with_names(values)
