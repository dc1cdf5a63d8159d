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

"""Models of the drift: ARMA orders and their choice, AR(1) plus white noise, the filter's Q and R.

Everything is fitted to the periodogram (`spectrum.py`). The drift is scaled to unit variance for
the fits, so that no tolerance depends on the sensor.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats
from statsmodels.tsa.arima.estimators.hannan_rissanen import hannan_rissanen
from statsmodels.tsa.stattools import acf, q_stat

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.identify.series import Values, mean_square
from gyro_drift_filter.identify.spectrum import (
    Spectrum,
    climb,
    fit_density,
    likelihood_interval,
    spectrum,
)

Delays = NDArray[np.complex128]
Order = tuple[int, int]

# Table 1 of the paper, and white noise, which it does not consider.
ORDERS: tuple[Order, ...] = ((0, 0), (1, 0), (2, 0), (3, 0), (1, 1), (2, 1))

# A larger model has to lower AIC by this much to be chosen. By chance one more parameter lowers it
# by more than 10 once in 1,900 recordings; plain AIC takes it once in six.
MATERIAL = 10.0
_LJUNG_BOX_LAGS = 20
_LJUNG_BOX_SAMPLES = 50_000
_START_SAMPLES = 20_000
# The drift can be told from white noise where its correlation at lag 1 is so many standard errors
# from zero and its phi is known this well, or where that correlation is more distinct; and where
# the drift that explains it forgets so often within the recording.
_PRESENT = 4.0
_PRECISE = 0.1
_DISTINCT = 10.0
_LEAST_TIMES = 10.0
_LEAST_RATIO = 1e-10


@dataclass(frozen=True)
class ArmaFit:
    """A fitted ARMA(p, q), x(k) = sum phi_i x(k-i) + a(k) - sum theta_j a(k-j), equation (1).

    Attributes:
        order: (p, q).
        phi: (p,).
        theta: (q,), with the signs of equation (1).
        phi_deviation: (p,) standard errors.
        theta_deviation: (q,) standard errors.
        variance: Of a, in the units of the data squared.
        aic: Akaike's information criterion, comparable among fits of the same data.
        bic: Schwarz's.
        ljung_box: p-value of the Ljung-Box test of the residuals with 20 lags.
    """

    order: Order
    phi: Floats
    theta: Floats
    phi_deviation: Floats
    theta_deviation: Floats
    variance: float
    aic: float
    bic: float
    ljung_box: float

    def density(self, frequency: Floats) -> Floats:
        """Return the spectral density (m,) at angular frequencies (m,) in radians per sample.

        As the power of a `Spectrum`, its mean over all frequencies is the variance of x.
        """
        parameters = np.r_[self.phi, self.theta, math.log(self.variance)]
        return _arma_density(_delays(frequency, self.order), self.order, parameters)


def fit_arma(pieces: Sequence[Values], orders: Sequence[Order] = ORDERS) -> list[ArmaFit]:
    """Return a fit for each order.

    Args:
        pieces: Parts of a recording (n,), without mean, trend and gaps.
        orders: (p, q) each.
    """
    scale = _deviation(pieces)
    data = spectrum(pieces, scale)
    sample = max(pieces, key=len)[:_LJUNG_BOX_SAMPLES] / scale
    return [_fit_one(sample, data, order, scale) for order in orders]


def choose(fits: Sequence[ArmaFit]) -> ArmaFit:
    """Return the smallest model whose AIC is no more than `MATERIAL` above the best one's.

    Among models with as many parameters it is the one with the lowest AIC.
    """
    best = min(candidate.aic for candidate in fits)
    adequate = [candidate for candidate in fits if candidate.aic <= best + MATERIAL]
    return min(adequate, key=lambda candidate: (sum(candidate.order), candidate.aic))


def _deviation(pieces: Sequence[Values]) -> float:
    return math.sqrt(mean_square(pieces))


def _delays(frequency: Floats, order: Order) -> Delays:
    """Return exp(-i w k) for k from 1 up to what the order needs, at each frequency w."""
    return np.asarray(np.exp(-1j * np.outer(frequency, np.arange(1, max(order) + 1))))


def _arma_density(delays: Delays, order: Order, parameters: Floats) -> Floats:
    """Return the spectral density of phi (p,), theta (q,) and the logarithm of the variance.

    `delays` (m, k) as of `_delays`.
    """
    p, q = order
    phi, theta = parameters[:p], parameters[p : p + q]
    if not (is_stable(phi) and is_stable(theta)):
        return np.full(len(delays), np.nan)
    denominator = 1.0 - delays[:, :p] @ phi
    numerator = 1.0 - delays[:, :q] @ theta
    variance = math.exp(min(parameters[-1], 700.0))
    return np.asarray(variance * np.abs(numerator) ** 2 / np.abs(denominator) ** 2)


def is_stable(coefficients: Floats) -> bool:
    """Return whether the roots of 1 - c[0] z^-1 - c[1] z^-2 - ... lie within the unit circle.

    They do if all partial autocorrelations are less than one, which Levinson's recursion, run
    backward, gives one by one: many times as fast as the roots, for the likelihood's thousands.
    """
    while len(coefficients):
        partial = float(coefficients[-1])
        if not abs(partial) < 1.0:
            return False
        others = coefficients[:-1]
        coefficients = (others + partial * others[::-1]) / (1.0 - partial * partial)
    return True


def _fit_one(sample: Floats, data: Spectrum, order: Order, scale: float) -> ArmaFit:
    p, q = order
    starts = [_start(sample, order), np.r_[np.full(p, 0.1 / max(p, 1)), np.zeros(q)]]
    delays = _delays(data.frequency, order)
    results = [
        fit_density(data, lambda v: _arma_density(delays, order, v), [*start.tolist(), 0.0])
        for start in starts
    ]
    result = max(results, key=lambda candidate: candidate.log_likelihood)
    phi, theta = result.parameters[:p], result.parameters[p : p + q]
    # One ordinate stands for two samples, and the likelihood counts every ordinate once.
    deviance = -2.0 * result.log_likelihood
    count = p + q + 1
    return ArmaFit(
        order=order,
        phi=phi,
        theta=theta,
        phi_deviation=result.deviations[:p],
        theta_deviation=result.deviations[p : p + q],
        variance=scale**2 * math.exp(result.parameters[-1]),
        aic=deviance + 2.0 * count,
        bic=deviance + math.log(data.samples) * count,
        ljung_box=_whiteness(sample, phi, theta),
    )


def _start(sample: Floats, order: Order) -> Floats:
    """Return first values of phi and theta, by Hannan and Rissanen's regressions."""
    p, q = order
    if p == q == 0:
        return np.zeros(0)
    longest = sample[:_START_SAMPLES]
    try:
        guess, _ = hannan_rissanen(longest, ar_order=p, ma_order=q, demean=False, unbiased=False)
        phi, theta = np.asarray(guess.ar_params), -np.asarray(guess.ma_params)
    except (ValueError, np.linalg.LinAlgError):
        phi, theta = np.zeros(p), np.zeros(q)
    if not (is_stable(phi) and is_stable(theta)):
        phi, theta = np.full(p, 0.1 / max(p, 1)), np.zeros(q)
    return np.concatenate([phi, theta])


def _whiteness(sample: Floats, phi: Floats, theta: Floats) -> float:
    residuals = signal.lfilter(
        np.concatenate([[1.0], -phi]), np.concatenate([[1.0], -theta]), sample
    )[len(phi) + len(theta) + 20 :]
    correlations = acf(residuals, nlags=_LJUNG_BOX_LAGS, fft=True)
    statistics, _ = q_stat(correlations[1:], len(residuals))
    # Less one degree of freedom for each coefficient fitted.
    return float(stats.chi2.sf(statistics[-1], _LJUNG_BOX_LAGS - len(phi) - len(theta)))


@dataclass(frozen=True)
class DriftAndWhite:
    """AR(1) drift plus white noise, as a description of the sensor.

    Attributes:
        identifiable: False where the recording can't tell the two apart, or the noise is of another
            kind; the rest is then of little worth.
        phi: Coefficient of the drift, and its 95 % interval.
        phi_interval: (low, high).
        drift_variance: Stationary variance of the drift, in the units of the data squared.
        drift_variance_interval: (low, high).
        white_variance: Of the white noise. An estimate below zero means that none is found.
        white_variance_interval: (low, high).
    """

    identifiable: bool
    phi: float
    phi_interval: tuple[float, float]
    drift_variance: float
    drift_variance_interval: tuple[float, float]
    white_variance: float
    white_variance_interval: tuple[float, float]


def fit_drift_and_white(pieces: Sequence[Values]) -> DriftAndWhite:
    """Fit AR(1) plus white noise by maximum likelihood.

    Fitted are phi, the covariance at lag 1 and the variance of the sum, which the data determine
    best; the two variances follow. The white one may come out below zero, as long as the density
    stays positive: cut off at zero the estimates of the others would be biased.

    Args:
        pieces: Parts of a recording (n,), without mean, trend and gaps.
    """
    scale = _deviation(pieces)
    data = spectrum(pieces, scale)
    cosine = np.cos(data.frequency)

    def density(v: Floats) -> Floats:
        """Of phi, the drift's variance and the white noise's."""
        phi, drift, white = v
        if not 1e-9 < abs(phi) < 1.0:
            return np.full_like(cosine, np.nan)
        return np.asarray(drift * (1 - phi * phi) / (1 - 2 * phi * cosine + phi * phi) + white)

    def by_moments(v: Floats) -> Floats:
        """Return phi and both variances from phi, covariance at lag 1 and variance of the sum."""
        phi, covariance, total = v
        return np.array([phi, covariance / phi, total - covariance / phi])

    starts = ((0.2, 0.2, 1.0), (0.9, 0.5, 1.0), (0.9, 0.1, 1.0), (-0.2, -0.1, 1.0))
    results = [fit_density(data, lambda v: density(by_moments(v)), start) for start in starts]
    likeliest = max(results, key=lambda result: result.log_likelihood)
    best = climb(data, density, by_moments(likeliest.parameters))
    phi, drift, white = (float(v) for v in best.parameters)
    total = drift + white
    correlation = drift * phi / total
    distinct = abs(correlation) * math.sqrt(data.samples)
    spread = float(best.covariance[0, 0])
    # A variance ends at zero, unless the likeliest value lies below: that is no drift.
    least = 0.0 if drift > 0.0 else -math.inf
    bounds = ((-1.0, 1.0), (least, math.inf), (-math.inf, math.inf))
    phi_interval, drift_interval, white_interval = (
        likelihood_interval(data, density, best, index, bounds[index]) for index in range(3)
    )
    precise = math.sqrt(spread) < _PRECISE * abs(phi)
    # It is phi times the drift's share of the variance, which is all at most: with a phi that is
    # nearer to zero than it, or of the other sign, the noise is of another kind.
    farthest = phi_interval[1] if correlation > 0.0 else -phi_interval[0]
    identifiable = (
        (distinct > _DISTINCT or (distinct > _PRESENT and precise))
        and farthest >= abs(correlation)
        and (1.0 - abs(phi)) * data.samples > _LEAST_TIMES
    )
    return DriftAndWhite(
        identifiable=identifiable,
        phi=phi,
        phi_interval=phi_interval,
        drift_variance=scale**2 * drift,
        drift_variance_interval=_scaled(drift_interval, scale),
        white_variance=scale**2 * white,
        white_variance_interval=_scaled(white_interval, scale),
    )


def _scaled(interval: tuple[float, float], scale: float) -> tuple[float, float]:
    return scale**2 * interval[0], scale**2 * interval[1]


@dataclass(frozen=True)
class FilterNoise:
    """Q and R of the filter's own state space, (3) and (4), in the data's units squared."""

    process_noise: float
    measurement_noise: float


def fit_filter_noise(pieces: Sequence[Values], phi: float) -> FilterNoise:
    """Return the Q and R that make the recording likeliest for the filter's own model.

    In (3) the drift x adds to the rate from step to step, so the differences of the measurement are
    stationary: z(k) - z(k-1) = x(k-1) + v(k) - v(k-1), with the spectral density
    Q / |1 - phi e^-iw|^2 + R |1 - e^-iw|^2.

    Args:
        pieces: Parts of a recording (n,), without mean, trend and gaps.
        phi: Coefficient of the drift.
    """
    scale = _deviation(pieces)
    data = spectrum(pieces, scale, differences=True)
    cosine = np.cos(data.frequency)
    drift = 1.0 / (1.0 - 2.0 * phi * cosine + phi * phi)
    difference = 2.0 - 2.0 * cosine

    def density(v: Floats) -> Floats:
        """Of the logarithms of Q / R and of R."""
        ratio = max(math.exp(min(v[0], 50.0)), _LEAST_RATIO)
        return np.asarray(math.exp(min(v[1], 50.0)) * (ratio * drift + difference))

    results = [fit_density(data, density, (math.log(ratio), 0.0)) for ratio in (1e-6, 1e-3, 1.0)]
    best = max(results, key=lambda result: result.log_likelihood)
    ratio = max(math.exp(best.parameters[0]), _LEAST_RATIO)
    measurement = scale**2 * math.exp(best.parameters[1])
    return FilterNoise(ratio * measurement, measurement)


def paper_noise(drift: ArmaFit, deviation: float) -> FilterNoise:
    """Return Q and R as the paper takes them: Q the variance of the residuals, R of the data.

    Args:
        drift: The fitted AR(1).
        deviation: Of the data.
    """
    return FilterNoise(drift.variance, deviation**2)
