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

"""The filters of the paper, one axis at a time: `kalman` and `sage_husa`.

X. Y. Wang and X. Y. Meng, "Research on Time-series Modeling and Filtering Methods for MEMS
Gyroscope Random Drift Error", IOP Conf. Ser.: Mater. Sci. Eng. 187 (2017) 012005. Equation numbers
are the paper's. State X = [r, x]: the angular rate and the autoregressive drift, both in rad/s;
A = [1 1; 0 phi], Gamma = [0 1]', H = [1 0].

Where the printed equations can't be run as they stand, or diverge, a safeguard departs from them.
Each is named where it stands:

- *first sample*: it sets X and counts as k = 1, so adaptation starts at k = 2. At k = 1
  equation (13) gives d = 1, and one sample would replace r, q, R and Q altogether.
- *transition once*: (17) has A P(k|k-1) A' in print, which applies the transition twice. As in
  Sage and Husa it is A P(k-1) A' here.
- *projection*: (17) gives a 2x2 matrix where (8) takes a scalar Q: Gamma' (...) Gamma.
- *floor*: (16) and (17) subtract, and can go below zero. R and Q stay above `NOISE_FLOOR` times
  their identified values.
- *corrected innovation*: (20) replaces Z in (11) alone. An outlier would still reach r, R and Q
  through (14), (16) and (17), so they take the same corrected innovation.
- *Joseph form*: (12) loses symmetry and sign to rounding; (I - K H) P (I - K H)' + K R K' does not.
- *offset*: r and the rate can't be told apart, only their sum H X + r is measured, and left alone
  r takes up some of the bias (on a real MPU6050 1.6 standard deviations of the noise). The rate
  that is reported is H X + r, so that the mean stays unchanged, as in the paper's Table 2.
- *coasting*: q stands for what innovations have shown, and runs away where no sample corrects it.
  A missing sample is predicted by A X alone, and never further out than *divergence* allows.
- *divergence*: r and q add up the same innovations and can drive each other. An estimate further
  out than `DIVERGED` times the largest sample restarts from the sample at hand.
"""

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from gyro_drift_filter.accelerate import inlined_kernel, kernel, record
from gyro_drift_filter.core.methods.advice import Advice

if TYPE_CHECKING:
    from gyro_drift_filter.core.settings import Settings

NOISE_FLOOR = 1e-3
DIVERGED = 10.0

# A period that differs by more than this share from the model's own rescales phi and Q.
MODEL_PERIOD_TOLERANCE = 0.1


class PaperCoefficients(TypedDict):
    """The model of one axis at the present sample period."""

    phi: float
    process_noise: float  # (rad/s)^2
    measurement_noise: float  # (rad/s)^2


class PaperAxis(TypedDict):
    """State of one axis after a sample."""

    rate: float  # X, rad/s
    drift: float
    rate_variance: float  # P, (rad/s)^2
    covariance: float
    drift_variance: float
    carried_variance: float  # Gamma' A P(k-1) A' Gamma
    samples: int  # k, 0 before the first
    measurement_mean: float  # r, rad/s
    rate_mean: float  # q, rad/s
    drift_mean: float
    measurement_noise: float  # R, (rad/s)^2
    process_noise: float  # Q, (rad/s)^2
    largest: float  # |Z| so far, rad/s
    divergences: int


class PaperWorkspace(TypedDict):
    """What one axis needs from its prediction to its estimate."""

    # Q and R with which the sample is taken in, (rad/s)^2
    process_noise: float
    measurement_noise: float


PAPER_COEFFICIENTS = record(PaperCoefficients)
PAPER_AXIS = record(PaperAxis)
PAPER_WORKSPACE = record(PaperWorkspace)


@kernel
def derive(settings: 'Settings', axis: int, period: float, coefficients: PaperCoefficients) -> None:
    """Fill the coefficients of one axis for a sample period in s.

    phi and Q belong to the period that they were identified at. Where the gyroscope runs at another
    one, the drift keeps its correlation time and its variance Q / (1 - phi^2). A negative or zero
    phi has no correlation time and is used as it is.
    """
    phi = settings['model_phi'][axis]
    process_noise = settings['model_process_noise'][axis]
    periods = period * settings['sample_rate']
    if phi > 0.0 and periods > 0.0 and abs(periods - 1.0) > MODEL_PERIOD_TOLERANCE:
        scaled = phi**periods
        process_noise *= (1.0 - scaled * scaled) / (1.0 - phi * phi)
        phi = scaled
    coefficients['phi'] = phi
    coefficients['process_noise'] = process_noise
    coefficients['measurement_noise'] = settings['model_measurement_noise'][axis]


@kernel
def start(state: PaperAxis, coefficients: PaperCoefficients, sample: float) -> None:
    """Start at a sample (rad/s). Q and R, if learned before, are kept."""
    if state['samples'] == 0:
        state['samples'] = 1  # safeguard: first sample
        state['process_noise'] = coefficients['process_noise']
        state['measurement_noise'] = coefficients['measurement_noise']
    state['measurement_mean'] = state['rate_mean'] = state['drift_mean'] = 0.0
    phi = coefficients['phi']
    state['rate'] = sample
    state['drift'] = 0.0
    state['rate_variance'] = state['measurement_noise']
    state['covariance'] = 0.0
    state['drift_variance'] = state['process_noise'] / (1.0 - phi * phi)
    state['largest'] = max(abs(sample), np.sqrt(coefficients['measurement_noise']))


@kernel
def start_over(state: PaperAxis) -> None:
    """Forget what was learned of Q and R, before `start`."""
    state['samples'] = 0


@inlined_kernel
def innovation_variance(
    state: PaperAxis, workspace: PaperWorkspace, coefficients: PaperCoefficients, adapts: bool
) -> float:
    """Return the variance of the innovation to come; keep Q and R that the sample meets."""
    process, measurement = noise_of(state, coefficients, adapts)
    workspace['process_noise'] = process
    workspace['measurement_noise'] = measurement
    return state['rate_variance'] + measurement


@kernel
def noise_of(
    state: PaperAxis, coefficients: PaperCoefficients, adapts: bool
) -> tuple[float, float]:
    """Return Q and R in (rad/s)^2: the adapted ones, or the identified ones."""
    if adapts:
        return state['process_noise'], state['measurement_noise']
    return coefficients['process_noise'], coefficients['measurement_noise']


@inlined_kernel
def estimate(
    state: PaperAxis, workspace: PaperWorkspace, adapts: bool
) -> tuple[float, float, float, float]:
    """Return rate in rad/s (safeguard: offset), its variance, and Q and R before the sample."""
    rate = state['rate'] + (state['measurement_mean'] if adapts else 0.0)
    process, measurement = workspace['process_noise'], workspace['measurement_noise']
    return rate, state['rate_variance'], process, measurement


@kernel
def change_model(
    state: PaperAxis,
    before: 'Settings',
    after: 'Settings',
    axis: int,
    coefficients: PaperCoefficients,
) -> None:
    """Replace Q and R, which may have been adapted, where other settings give them anew.

    The coefficients are those of the settings `after`.
    """
    if after['model_process_noise'][axis] != before['model_process_noise'][axis]:
        state['process_noise'] = coefficients['process_noise']
    if after['model_measurement_noise'][axis] != before['model_measurement_noise'][axis]:
        state['measurement_noise'] = coefficients['measurement_noise']


@inlined_kernel
def predict(state: PaperAxis, coefficients: PaperCoefficients, adapts: bool) -> None:
    """One sample period ahead: equations (7), without q for the conventional filter, and (8)."""
    phi = coefficients['phi']
    state['rate'] += state['drift']  # (7)
    state['drift'] *= phi
    if adapts:
        state['rate'] += state['rate_mean']
        state['drift'] += state['drift_mean']
    _predict_covariance(state, coefficients, adapts)


@kernel
def coast(state: PaperAxis, coefficients: PaperCoefficients, adapts: bool) -> None:
    """One sample period ahead where the sample is missing (safeguard: coasting)."""
    furthest = DIVERGED * state['largest']
    state['rate'] = min(max(state['rate'] + state['drift'], -furthest), furthest)
    state['drift'] *= coefficients['phi']
    _predict_covariance(state, coefficients, adapts)


@kernel
def _predict_covariance(state: PaperAxis, coefficients: PaperCoefficients, adapts: bool) -> None:
    """Equation (8). Rounding may leave a difference of equals below zero."""
    phi = coefficients['phi']
    process_noise, _ = noise_of(state, coefficients, adapts)
    p00, p01, p11 = state['rate_variance'], state['covariance'], state['drift_variance']
    state['rate_variance'] = max(0.0, p00 + 2.0 * p01 + p11)
    state['carried_variance'] = phi * phi * p11
    state['drift_variance'] = state['carried_variance'] + process_noise
    state['covariance'] = _bounded_covariance(state, phi * (p01 + p11))


@kernel
def _bounded_covariance(state: PaperAxis, covariance: float) -> float:
    """Return a covariance that the variances allow, whatever rounding has made of it."""
    square = state['rate_variance'] * state['drift_variance']
    if covariance * covariance <= square:  # nearly always, and without waiting for a root
        return covariance
    return math.copysign(math.sqrt(square), covariance)


@inlined_kernel
def update(
    state: PaperAxis,
    coefficients: PaperCoefficients,
    settings: 'Settings',
    adapts: bool,
    sample: float,
) -> tuple[float, bool]:
    """Take a sample (rad/s) in after `predict`: equations (9) to (20).

    Returns:
        The innovation as it came, in rad/s, and whether the sample was flagged as an outlier.
    """
    epsilon = settings['epsilon'] if settings['outlier_enabled'] else np.inf
    predicted = state['rate']
    p00, p01, p11 = state['rate_variance'], state['covariance'], state['drift_variance']
    _, noise = noise_of(state, coefficients, adapts)
    mean = state['measurement_mean'] if adapts else 0.0
    innovation_variance = p00 + noise
    precision = 1.0 / innovation_variance
    gain_rate = p00 * precision  # (9)
    gain_drift = p01 * precision
    innovation = sample - predicted  # (10)

    expected_square = predicted * predicted + innovation_variance  # J of (18)
    outlier = abs(sample * sample - expected_square) > epsilon
    used = innovation
    # (19) only shortens: a square below the band is flagged, and used as it is, as in print.
    if outlier and abs(sample) > np.sqrt(expected_square):
        used = sample * (np.sqrt(expected_square) / abs(sample)) - predicted  # (19)
    state['rate'] = predicted + gain_rate * (used - mean)  # (11), (20)
    state['drift'] += gain_drift * (used - mean)

    # (12); safeguard: Joseph form. Rounding may still leave a difference of equals below zero.
    kept = 1.0 - gain_rate
    state['rate_variance'] = kept * kept * p00 + gain_rate * gain_rate * noise
    state['drift_variance'] = max(
        0.0, p11 - 2.0 * gain_drift * p01 + gain_drift * gain_drift * innovation_variance
    )
    covariance = kept * (p01 - gain_drift * p00) + gain_rate * gain_drift * noise
    state['covariance'] = _bounded_covariance(state, covariance)

    if adapts:
        _adapt(state, coefficients, settings['forgetting_factor'], used, gain_rate, gain_drift, p00)
    state['largest'] = max(state['largest'], abs(sample))
    if not abs(state['rate']) <= DIVERGED * state['largest']:  # safeguard: divergence
        state['divergences'] += 1
        state['samples'] = 0
        start(state, coefficients, sample)
    return innovation, outlier


@kernel
def _adapt(
    state: PaperAxis,
    coefficients: PaperCoefficients,
    forgetting_factor: float,
    innovation: float,
    gain_rate: float,
    gain_drift: float,
    rate_variance: float,
) -> None:
    """Sage and Husa's estimator of the noise statistics: equations (13) to (17).

    `innovation` is the corrected one (safeguard: corrected innovation) and `rate_variance` is
    H P(k|k-1) H'; the state holds P(k) already.
    """
    state['samples'] += 1
    weight = (1.0 - forgetting_factor) / (
        1.0 - forgetting_factor ** float(state['samples'])
    )  # (13)
    unexpected = innovation - state['measurement_mean']
    state['measurement_mean'] += weight * unexpected  # (14)
    state['rate_mean'] += weight * gain_rate * unexpected  # (15): X(k) - A X(k-1) = q + K (e - r)
    state['drift_mean'] += weight * gain_drift * unexpected
    residual = innovation - state['measurement_mean']
    measured = residual * residual - rate_variance
    noise = state['measurement_noise'] + weight * (measured - state['measurement_noise'])  # (16)
    state['measurement_noise'] = max(noise, NOISE_FLOOR * coefficients['measurement_noise'])
    # (17); safeguards: projection, transition once
    driving = gain_drift * residual * (gain_drift * residual)
    driving += state['drift_variance'] - state['carried_variance']
    noise = state['process_noise'] + weight * (driving - state['process_noise'])
    state['process_noise'] = max(noise, NOISE_FLOOR * coefficients['process_noise'])


class Reason(IntEnum):
    """Why a sample is an outlier, or is none."""

    EXPECTED = 0
    BEYOND_EPSILON = 1


REASONS: Mapping[int, str] = {
    Reason.EXPECTED: 'within the limit',
    Reason.BEYOND_EPSILON: 'the square of the rate differs from what is expected by more than '
    'epsilon',
}
ADVICE = Advice(
    outliers='for a robot that moves, set method to adaptive; else raise epsilon',
    large_innovations='it lags behind motion; set method to adaptive, or raise model.process_noise '
    'and model.measurement_noise (gyro_drift identify finds them)',
    small_innovations='no outlier will be found; lower model.process_noise and '
    'model.measurement_noise (gyro_drift identify finds them)',
)
