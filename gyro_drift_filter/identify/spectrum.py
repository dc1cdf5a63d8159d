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

"""The periodogram of a recording, from which all models are fitted.

For a stationary Gaussian process the ordinates of the periodogram are independent and exponential
about the spectral density (Whittle, 1953). So the averages over narrow bins hold all that a
likelihood needs: a million samples become some hundred numbers, the same for every model.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import fft, optimize

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.identify.series import LARGEST_PART, Values, all_parts

# A spectral density per parameter vector, at the angular frequencies of the bins.
Density = Callable[[Floats], Floats]

# The lowest ordinates hold what is left of the trend.
_SKIPPED = 3
# Below this one bin per ordinate, above bins that grow by 3 %, no wider than a 512th of the band.
_SINGLE = 64
_GROWTH = 1.03
_WIDEST = 512

# Fisher scoring ends when a step gains less than this in log-likelihood.
_SCORING_STEPS, _HALVINGS, _LEAST_GAIN = 30, 6, 1e-6
# A 95 % interval ends where the log-likelihood has fallen by half the 95 % quantile of chi squared
# with one degree of freedom; the root of it.
_FALL_95 = math.sqrt(1.920729)


@dataclass(frozen=True)
class Spectrum:
    """Periodogram averaged over bins, m of them.

    Attributes:
        frequency: (m,) mean angular frequency in radians per sample, between 0 and pi.
        power: (m,) mean periodogram ordinate, normalised so that its mean over all frequencies is
            the variance.
        weight: (m,) ordinates in the bin.
        samples: Samples that went in.
    """

    frequency: Floats
    power: Floats
    weight: Floats
    samples: int


@dataclass(frozen=True)
class Fit:
    """Parameters that make the Whittle likelihood largest.

    Attributes:
        parameters: (p,).
        covariance: (p, p) from the Fisher information.
        log_likelihood: Up to a constant that all models of the same spectrum share.
    """

    parameters: Floats
    covariance: Floats
    log_likelihood: float

    @property
    def deviations(self) -> Floats:
        """Standard errors (p,)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


def spectrum(spans: Sequence[Values], scale: float = 1.0, *, differences: bool = False) -> Spectrum:
    """Return the binned periodogram of one or several stretches of a recording.

    A stretch that is longer than a million samples is taken in parts; what is lost are frequencies
    of which it holds a few periods.

    Args:
        spans: Each (n,), even in time, without gap and mean; the longest part sets the bins.
        scale: What the samples are divided by.
        differences: Whether those from sample to sample are taken in place of the samples.
    """
    longest = max(-(-len(span) // -(-len(span) // LARGEST_PART)) for span in spans)
    edges = _edges(longest - differences)
    count, power, moment = (np.zeros(len(edges) - 1) for _ in range(3))
    for part in all_parts(spans):
        piece = (np.diff(part) if differences else part) / scale
        n = _fast_length(len(piece))
        ordinates = np.abs(fft.rfft(piece[:n])) ** 2 / n
        k = np.arange(_SKIPPED, (n - 1) // 2)
        frequency = 2.0 * np.pi * k / n
        bins = np.searchsorted(edges, frequency, side='right') - 1
        inside = (bins >= 0) & (bins < len(count))
        bins, frequency, chosen = bins[inside], frequency[inside], ordinates[k[inside]]
        count += np.bincount(bins, minlength=len(count))
        power += np.bincount(bins, chosen, minlength=len(count))
        moment += np.bincount(bins, frequency, minlength=len(count))
    used = count > 0
    return Spectrum(
        moment[used] / count[used],
        power[used] / count[used],
        count[used],
        sum(len(span) - differences for span in spans),
    )


def _fast_length(n: int) -> int:
    """Return the longest length up to n that transforms fast, a percent less at most."""
    return next(m for m in range(n, 0, -1) if fft.next_fast_len(m, real=True) == m)


def _edges(n: int) -> Floats:
    step = 2.0 * np.pi / n
    edges = [(_SKIPPED - 0.5) * step]
    widest = max(step, np.pi / _WIDEST)
    while edges[-1] < np.pi:
        number = len(edges)
        width = step if number < _SINGLE else min(edges[-1] * (_GROWTH - 1.0), widest)
        edges.append(edges[-1] + max(width, step))
    return np.array(edges)


def fit_density(data: Spectrum, density: Density, start: Sequence[float]) -> Fit:
    """Return the parameters of a spectral density that maximise the Whittle likelihood.

    Args:
        data: The spectrum.
        density: Parameters (p,) to densities at `data.frequency` (m,); it may return values that
            are not positive where the parameters describe no process.
        start: First guess (p,).
    """
    # The simplex needs no derivatives and takes infinite costs; scoring makes its end exact.
    found: Any = optimize.minimize(
        lambda parameters: _cost(data, density, parameters),
        np.asarray(start, float),
        method='Nelder-Mead',
        options={'xatol': 1e-5, 'fatol': 1e-4, 'maxiter': 400 * len(start), 'adaptive': True},
    )
    return climb(data, density, found.x)


def climb(data: Spectrum, density: Density, start: Floats) -> Fit:
    """Return the parameters of largest likelihood near a good first guess, by Fisher scoring.

    Args:
        data: The spectrum.
        density: As for `fit_density`.
        start: (p,).
    """
    parameters, lowest = np.asarray(start, float), _cost(data, density, start)
    covariance, score = _information(data, density, parameters)
    for _ in range(_SCORING_STEPS if np.isfinite(lowest) else 0):
        step, before = covariance @ score, lowest
        for _ in range(_HALVINGS):
            value = _cost(data, density, parameters + step)
            if value < lowest:
                parameters, lowest = parameters + step, value
                covariance, score = _information(data, density, parameters)
                break
            step = 0.5 * step
        if before - lowest < _LEAST_GAIN:
            break
    return Fit(parameters, covariance, -lowest)


def likelihood_interval(
    data: Spectrum, density: Density, best: Fit, index: int, bounds: tuple[float, float]
) -> tuple[float, float]:
    """Return the 95 % interval of one parameter by its profile likelihood.

    The profile at a value is the largest likelihood that the other parameters can give it. Unlike
    an interval by standard errors, this one is as lopsided as the data ask for.

    Args:
        data: The spectrum.
        density: As for `fit_density`.
        best: Most likely parameters (p,).
        index: Of the parameter.
        bounds: The interval ends there where the likelihood is still high.
    """
    estimate, deviation = float(best.parameters[index]), float(best.deviations[index])
    others = np.delete(best.parameters, index)

    def shortfall(value: float) -> float:
        """Return how far the profile has fallen, less what ends the interval."""
        profile = climb(
            data,
            lambda v: density(np.concatenate([v[:index], [value], v[index:]])),
            others,
        )
        # Of the root, which is nearly a straight line, and finite for those who interpolate.
        fallen = min(best.log_likelihood - profile.log_likelihood, 1e6)
        return math.sqrt(max(fallen, 0.0)) - _FALL_95

    def limit(bound: float) -> float:
        inner, step = estimate, math.copysign(deviation, bound - estimate)
        while abs(bound - inner) > abs(step):
            outer = inner + step
            if shortfall(outer) >= 0.0:
                return float(optimize.brentq(shortfall, inner, outer, xtol=0.01 * deviation))
            inner, step = outer, 1.5 * step
        return bound

    if not (deviation > 0.0 and bounds[0] < estimate < bounds[1]):
        return bounds
    return limit(bounds[0]), limit(bounds[1])


def _cost(data: Spectrum, density: Density, parameters: Floats) -> float:
    """Return minus the log-likelihood, infinite where the parameters describe no process."""
    value = density(parameters)
    if not value.min() > 0.0:  # nor where one is no number
        return np.inf
    return float(data.weight @ (np.log(value) + data.power / value))


def _information(data: Spectrum, density: Density, parameters: Floats) -> tuple[Floats, Floats]:
    """Return the inverse of the Fisher information (p, p), and the score (p,)."""
    value = density(parameters)
    slopes = []
    with np.errstate(invalid='ignore', divide='ignore'):
        for i, parameter in enumerate(parameters):
            width = 1e-5 * max(abs(parameter), 1e-3)
            ahead, behind = parameters.copy(), parameters.copy()
            ahead[i] += width
            behind[i] -= width
            slopes.append((np.log(density(ahead)) - np.log(density(behind))) / (2.0 * width))
    jacobian = np.nan_to_num(slopes)
    information = (jacobian * data.weight) @ jacobian.T
    score = jacobian @ (data.weight * (data.power / value - 1.0))
    return np.linalg.pinv(information), np.asarray(score)
