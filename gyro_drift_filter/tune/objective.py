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

"""How good parameters are on a recording, stretch by stretch, by what over-smoothing can't cheat.

Without truth it is the likelihood of each sample given those before it. Innovation and variance are
fixed before the filter sees the sample, so that a filter which smooths motion away predicts badly,
and one that claims to know little pays for that, too. The part of the output's error that is lag
is added. With truth it is the error of the output.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.parameters import AXES, IDENTITY, NO_SENSITIVITY
from gyro_drift_filter.core.sample import LARGEST_RATE, SampleStatus
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.phrases import rounded_down, without_rate

# Half of the stretches are held back. Fewer tell little of the scatter between them; shorter ones
# than half a second are no longer independent, as one motion covers several.
STRETCHES = 20
LEAST_SAMPLES, LEAST_SECONDS = 50, 0.5
# A sample in a hundred may be anything that gyroscopes can measure, 2000 deg/s either way: what a
# spike costs, which no filter can predict, is bounded by that.
SPIKES = 0.01
_SPIKE_DENSITY = 1.0 / (2.0 * math.radians(2000.0))
# The rate is taken without lag for the median of so many samples around each: it has no runs of
# three spikes any more. Lag is looked for where that changes from one sample to the next by more
# than so many deviations of the noise, as elsewhere smoothing would pass for lag.
_MEDIAN = 7
_LAGGING = 5.0


@dataclass(frozen=True)
class Material:
    """A recording that parameters are judged on, n samples.

    Attributes:
        stamps: (n,) in ns.
        rates: (n, 3) raw, in rad/s.
        accelerations: (n, 3) in m/s^2; NaN where not reported.
        truth: (n, 3) true rates in rad/s, with or without a bias, None where not known; NaN
            where they are not known for a sample.
    """

    stamps: Integers
    rates: Floats
    accelerations: Floats
    truth: Floats | None = None


class Objective:
    """The costs of parameters on each stretch of a recording: the less, the better.

    Attributes:
        edges: (STRETCHES + 1,) the first sample of each stretch, and the number of samples.
        noise: (3,) standard deviation of the noise, as the default filter learns it, in rad/s.
        is_error: Whether costs are mean squared errors in (rad/s)^2, and not nats a sample.
    """

    def __init__(self, material: Material) -> None:
        """Look at the recording.

        Raises:
            GyroDriftFilterError: It is too short to hold anything back.
        """
        self._material = material
        self.is_error = material.truth is not None
        _require_enough(material.stamps)
        rates = material.rates
        if why := without_rate([bool(np.isfinite(axis).any()) for axis in rates.T], LARGEST_RATE):
            raise GyroDriftFilterError(
                f'{why}, so that nothing can be filtered: the gyroscope or its driver does not work'
            )
        self.edges = np.linspace(0, len(rates), STRETCHES + 1).round().astype(int)
        self._counts = np.array([_resolution(rates[:, axis]) for axis in range(len(AXES))])
        if not self._counts.any():
            raise GyroDriftFilterError('the rates never change: there is nothing to tune by')
        self.noise = self._learn_noise()
        if not self.is_error:
            self._reference = median_filter(np.nan_to_num(rates), (_MEDIAN, 1), mode='nearest')
            self._slopes = np.gradient(self._reference, axis=0)
            self._lagging = np.abs(self._slopes) > _LAGGING * self.noise

    def _learn_noise(self) -> Floats:
        filter_ = Filter()
        for results in self._results(filter_):
            last = np.sqrt(results['measurement_noise'][-1])
        noise = np.maximum(last, self._counts / math.sqrt(12.0))
        # That of a dead axis is none.
        return np.asarray(np.where(self._counts > 0.0, noise, noise.max()))

    def _results(self, filter_: Filter) -> Any:
        material = self._material
        for first, end in zip(self.edges[:-1], self.edges[1:], strict=True):
            part = slice(first, end)
            yield filter_.run(
                material.stamps[part], material.rates[part], material.accelerations[part]
            )

    def costs(self, parameters: Parameters) -> Floats:
        """Return the cost of each stretch (STRETCHES,).

        The filter runs through the whole recording: a stretch is predicted with what was learned on
        those before it, and by nothing behind it.
        """
        values: dict[str, Any] = {'bias.enabled': False}  # which is not what is judged
        if not self.is_error:  # the rates are compared with raw ones
            values['calibration.matrix'] = IDENTITY
            values['calibration.acceleration_sensitivity'] = NO_SENSITIVITY
        filter_ = Filter(parameters.with_names(values))
        out = np.empty(STRETCHES)
        for k, results in enumerate(self._results(filter_)):
            part = slice(self.edges[k], self.edges[k + 1])
            known = results['status'] == SampleStatus.FILTERED
            if self._material.truth is not None:
                out[k] = _mean_square(results, self._material.truth[part], known)
            else:
                out[k] = self._surprise(results, part, known) + self._lag(results, part, known)
        return out

    def _surprise(self, results: NDArray[Any], part: slice, known: Bools) -> float:
        """Return minus the mean logarithm of the density that was predicted for the samples."""
        alive = self._counts > 0.0
        usable = np.isfinite(self._material.rates[part]) & known[:, None] & alive
        # A sample is known no better than to a count.
        variance = results['innovation_variance'] + np.where(alive, self._counts**2 / 12.0, 1.0)
        squares = results['innovation'] ** 2 / variance
        density = np.exp(-0.5 * squares) / np.sqrt(2.0 * np.pi * variance)
        density = (1.0 - SPIKES) * density + SPIKES * _SPIKE_DENSITY
        return float(-np.log(density[usable]).mean()) if usable.any() else 0.0

    def _lag(self, results: NDArray[Any], part: slice, known: Bools) -> float:
        """Return what the lag of the output in motion costs, in the same unit.

        Lag in samples times the slope is an error; beside the noise of the sensor it costs as much
        as noise that is larger by it. Medians, as knocks and steps are no lag.
        """
        cost = 0.0
        for axis in range(len(AXES)):
            where = self._lagging[part, axis] & known
            if not where.any():
                continue
            slopes = np.abs(self._slopes[part, axis][where])
            behind = (self._reference[part, axis] - results['angular_velocity'][:, axis])[where]
            behind *= np.sign(self._slopes[part, axis][where])
            lag = float(np.median(behind / slopes))
            cost += 0.5 * float(np.log1p((lag * slopes / self.noise[axis]) ** 2).sum())
        return cost / (len(AXES) * len(results))


def _require_enough(stamps: Integers) -> None:
    """Look whether there is enough of a recording to hold some of it back.

    Raises:
        GyroDriftFilterError: There is not, or its stamps go back.
    """
    n = len(stamps)
    # So long do n samples last: the last one stands for a period, too.
    seconds = (int(stamps[-1]) - int(stamps[0])) * 1e-9 * n / (n - 1) if n > 1 else 0.0
    if seconds < 0.0:
        raise GyroDriftFilterError(
            f'the stamps go back, by {-seconds:.1f} s from the first to the last: record again '
            'with a driver whose stamps advance'
        )
    needed = STRETCHES * LEAST_SECONDS
    if n < STRETCHES * LEAST_SAMPLES or seconds < (1.0 - 1e-9) * needed:
        raise GyroDriftFilterError(
            f'{n} samples in {rounded_down(seconds)} s are too few to tune by, as half of them '
            f'are held back: {STRETCHES * LEAST_SAMPLES} samples in {needed:g} s are the least'
        )


def _mean_square(results: NDArray[Any], truth: Floats, known: Bools) -> float:
    """Return the mean squared error about its mean, as the bias is not what is judged."""
    used = known & np.isfinite(truth).all(axis=1)
    error = (results['angular_velocity'] - truth)[used]
    return float(error.var(axis=0).mean()) if len(error) else 0.0


def _resolution(values: Floats) -> float:
    """Return the smallest change of a signal, in its unit; 0 where it never changes."""
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    steps = steps[steps > 0.0]
    return float(steps.min()) if len(steps) else 0.0
