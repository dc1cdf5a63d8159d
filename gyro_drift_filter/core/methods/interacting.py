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

"""Interacting Kalman filters of one axis: prediction, correction, and what they say together.

Each mode of the mode set (`mode_set.py`) is a Kalman filter with another Q. How well each predicted
the sample gives its probability (interacting multiple models; Blom and Bar-Shalom, IEEE
Transactions on Automatic Control 33, 1988): the mode probabilities are the adaptive Q.

Rates are in rad/s, variances in (rad/s)^2. Acceleration and jerk are angular, in rad/s per sample
and per sample squared. Equation numbers are the paper's.
"""

import math

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.methods.adaptive_axis import AdaptiveAxis, AdaptiveAxisWorkspace
from gyro_drift_filter.core.methods.mode_set import MODES, ModeSet, PerMode, Transitions
from gyro_drift_filter.core.methods.noise import (
    Noise,
    autoregression,
    largest_variance,
    prediction_of,
)

LEAST_PROBABILITY = 1e-30  # of a mode
# The least divisor in place of a mode probability: smaller ones are zero.
SMALLEST = 1e-300


@kernel
def put_modes_at(state: AdaptiveAxis, rate: float) -> None:
    """Start all modes at a rate."""
    for j in range(MODES):
        state['rate'][j] = rate
        state['acceleration'][j] = state['jerk'][j] = 0.0


@kernel
def make_certain(state: AdaptiveAxis, mode: int) -> None:
    """Give nearly all probability to one mode."""
    for j in range(MODES):
        state['probability'][j] = 1e-9
    state['probability'][mode] = 1.0


@kernel
def take_prediction(state: AdaptiveAxis, workspace: AdaptiveAxisWorkspace) -> None:
    """Take the prediction for the state."""
    for j in range(MODES):
        state['probability'][j] = workspace['prior'][j]
        state['rate'][j] = workspace['rate'][j]
        state['acceleration'][j] = workspace['acceleration'][j]
        state['jerk'][j] = workspace['jerk'][j]


@kernel
def limit_extrapolation(state: AdaptiveAxis, distance: float) -> None:
    """Keep an extrapolation within a distance (rad/s) of the last sample that was accepted."""
    rate, origin = state['rate'], state['last_accepted']
    for j in range(MODES):
        rate[j] = min(max(rate[j], origin - distance), origin + distance)


@kernel
def predict_modes(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    transitions: Transitions,
    modes: ModeSet,
) -> None:
    """Predict the next sample, into the workspace: each mode, and all together."""
    _mix(state, workspace, transitions, modes['up_further'])
    _predict_mixed(state, workspace, modes)


@kernel
def combine_modes(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    modes: ModeSet,
    noise_alone: bool,
    accepted: bool,
) -> tuple[float, float, float]:
    """Return what the modes say together: rate, its variance, and Q.

    Correlated noise comes out enlarged from a mode that averages over about its correlation time.
    So in motion the last sample, if it was `accepted`, stands in for the rate of each mode whose
    error exceeds the noise.
    """
    whole = largest_variance(state['noise'])
    _find_errors(state['noise'], whole, workspace, modes)
    probability, rate = state['probability'], state['rate']
    means, squares, others = workspace['means'], workspace['squares'], workspace['others']
    error, lag, ratio = workspace['error'], modes['unseen_lag'], modes['innovation_ratio']
    process = modes['process_ratio']
    noise = state['noise']['variance']
    growth = _growth_of_extrapolation(state)
    # In noise alone nothing lags, and what the modes differ by is noise, which their errors count.
    of_lag, apart = (0.0, 0.0) if noise_alone else (noise, 1.0)
    origin, sample = rate[MODES - 1], state['doubt']['last_sample']
    largest = whole if accepted and not noise_alone else math.inf
    for j in range(MODES):
        enlarged = error[j] > largest
        distance = (sample if enlarged else rate[j]) - origin
        filtered = whole if enlarged else error[j] + lag[j] * of_lag
        own = filtered if growth == 0.0 else (ratio[j] - 1.0) * growth
        means[j] = probability[j] * distance
        spread = distance * distance
        squares[j] = probability[j] * (max(own, spread) + apart * min(own, spread))
        others[j] = probability[j] * process[j]
    mean = _sum(means)
    variance = max(_sum(squares) - mean * mean, error[0])
    return origin + mean, variance, _sum(others) * noise


@kernel
def _growth_of_extrapolation(state: AdaptiveAxis) -> float:
    """Return the variance in (rad/s)^2 that an extrapolation adds, per innovation ratio less 1.

    Its error grows about as the number of samples, and so the variance as their square.
    """
    held = state['doubt']['unaccepted']
    return float(state['noise']['variance'] * held * held)


@kernel
def mode_of(size: float, variance: float, modes: ModeSet) -> int:
    """Return the slowest mode to which a jump of this size (rad/s) is nothing special."""
    ratio = modes['innovation_ratio']
    mode = MODES - 1
    while mode > 0 and ratio[mode - 1] * variance > size * size:
        mode -= 1
    return mode


# The loops below are cut so that compilers turn them into vector instructions: what can be done in
# each mode apart from what goes from mode to mode, and sums by `_sum`.


@kernel
def _sum(values: PerMode) -> float:
    """Return the sum over the modes: four sums side by side, as each waits for its last term."""
    a = b = c = d = 0.0
    for j in range(0, MODES, 4):
        a += values[j]
        b += values[j + 1]
        c += values[j + 2]
        d += values[j + 3]
    return (a + b) + (c + d)


@kernel
def _largest(values: PerMode) -> float:
    """Return the largest value over the modes, as `_sum` does."""
    a = b = c = d = values[0]
    for j in range(0, MODES, 4):
        a = max(a, values[j])
        b = max(b, values[j + 1])
        c = max(c, values[j + 2])
        d = max(d, values[j + 3])
    largest: float = max(max(a, b), max(c, d))
    return largest


@kernel
def _mix(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    transitions: Transitions,
    up_further: PerMode,
) -> None:
    """Multiply by the transition matrix: the mixing step of interacting models.

    Each mode passes on a share of its probability upwards and one downwards, which end with
    falling probability in one of the modes beyond. One pass each way does it, as the shares are
    geometric. What arrives in a mode is averaged into its state. Leaves the mixed states and the
    prior in the workspace.
    """
    probability, prior = state['probability'], workspace['prior']
    rate, acceleration, jerk = state['rate'], state['acceleration'], state['jerk']
    mixed_rate, mixed_acceleration = workspace['rate'], workspace['acceleration']
    mixed_jerk, weighted = workspace['jerk'], workspace['weighted']
    from_below, from_above = workspace['from_below'], workspace['from_above']
    stay, up_first = transitions['stay'], transitions['up_first']
    down_first, down_further = transitions['down_first'], transitions['down_further']
    for j in range(MODES):
        weight = probability[j]
        weighted[j, 0] = weight
        weighted[j, 1] = weight * rate[j]
        weighted[j, 2] = weight * acceleration[j]
        weighted[j, 3] = weight * jerk[j]
    up = up_rate = up_acceleration = up_jerk = 0.0
    down = down_rate = down_acceleration = down_jerk = 0.0
    for i in range(1, MODES):
        # Both ways at once, as each waits for its last step: to i from below and to k from above.
        first, further = up_first[i - 1], up_further[i]
        up = up * further + weighted[i - 1, 0] * first
        up_rate = up_rate * further + weighted[i - 1, 1] * first
        up_acceleration = up_acceleration * further + weighted[i - 1, 2] * first
        up_jerk = up_jerk * further + weighted[i - 1, 3] * first
        from_below[i, 0] = up
        from_below[i, 1] = up_rate
        from_below[i, 2] = up_acceleration
        from_below[i, 3] = up_jerk
        k = MODES - 1 - i
        down = down * down_further[k, 0] + weighted[k + 1, 0] * down_first[k + 1, 0]
        down_rate = down_rate * down_further[k, 1] + weighted[k + 1, 1] * down_first[k + 1, 1]
        down_acceleration = (
            down_acceleration * down_further[k, 2] + weighted[k + 1, 2] * down_first[k + 1, 2]
        )
        down_jerk = down_jerk * down_further[k, 3] + weighted[k + 1, 3] * down_first[k + 1, 3]
        from_above[k, 0] = down
        from_above[k, 1] = down_rate
        from_above[k, 2] = down_acceleration
        from_above[k, 3] = down_jerk
    for j in range(MODES):
        prior[j] = weighted[j, 0] * stay[j] + from_below[j, 0] + from_above[j, 0]
        share = 1.0 / max(prior[j], SMALLEST)
        mixed_rate[j] = (weighted[j, 1] * stay[j] + from_below[j, 1] + from_above[j, 1]) * share
        mixed_acceleration[j] = (
            weighted[j, 2] * stay[j] + from_below[j, 2] + from_above[j, 2]
        ) * share
        mixed_jerk[j] = (weighted[j, 3] * stay[j] + from_below[j, 3] + from_above[j, 3]) * share


@kernel
def _predict_mixed(state: AdaptiveAxis, workspace: AdaptiveAxisWorkspace, modes: ModeSet) -> None:
    """Predict the sample with each mode, equation (7), and all together: mean and variance.

    The innovation of a mode is the sample less the predicted rate and less the noise that the last
    two residuals predict: this makes the innovations of a slow mode white although the sensor's
    noise is not.
    """
    rate, acceleration, jerk = workspace['rate'], workspace['acceleration'], workspace['jerk']
    expected, variance = workspace['expected'], workspace['variance']
    means, squares, others = workspace['means'], workspace['squares'], workspace['others']
    prior, noise, residual = workspace['prior'], state['noise'], state['residual']
    lag_ratio, logarithm = modes['lag_ratio'], modes['innovation_logarithm']
    of_last, of_before, predicted = prediction_of(noise)
    key = workspace['variance_key']
    if (
        key[0] != noise['variance']
        or key[1] != noise['roughness']
        or key[2] != of_last
        or key[3] != of_before
    ):
        key[0] = noise['variance']
        key[1] = noise['roughness']
        key[2] = of_last
        key[3] = of_before
        _predict_variances(noise, predicted, workspace, modes)
    sample = state['doubt']['last_sample']
    # Mean and variance by one pass, from the fastest mode, which is never far off.
    origin = rate[MODES - 1]
    for j in range(MODES):
        last_residual = sample - rate[j]
        predicted_noise = of_last * last_residual + of_before * residual[j]
        residual[j] = last_residual
        rate[j] += acceleration[j]
        expected[j] = rate[j] + predicted_noise
        acceleration[j] = lag_ratio[j] * acceleration[j] + jerk[j]
        jerk[j] *= lag_ratio[j]
        distance = expected[j] - origin
        means[j] = prior[j] * distance
        squares[j] = prior[j] * (variance[j] + distance * distance)
        others[j] = prior[j] * logarithm[j]
    mean = _sum(means)
    workspace['prediction'] = origin + mean
    total = max(_sum(squares) - mean * mean, variance[0])
    growth = _growth_of_extrapolation(state)
    if growth > 0.0:
        ratio = modes['innovation_ratio']
        for j in range(MODES):
            squares[j] = prior[j] * (ratio[j] - 1.0)
        total += _sum(squares) * growth
    workspace['prediction_variance'] = total
    # The geometric mean is not blown up by the small chance of a fast mode.
    workspace['typical_innovation'] = math.sqrt(noise['variance'] * math.exp(_sum(others)))


@kernel
def _predict_variances(
    noise: Noise, predicted: float, workspace: AdaptiveAxisWorkspace, modes: ModeSet
) -> None:
    """Write the variance of each mode's innovation.

    Residuals predict the share `predicted` of the noise's variance. With gain K a residual holds
    1 - K of the noise, so this takes predicted * (1 - K) ** 2 off the variance. The prediction of
    a fast mode follows the noise itself, which leaves all of it at K = 0 and `roughness` at K = 1.
    """
    variance, half_precision = workspace['variance'], workspace['half_precision']
    density, gain, ratio = workspace['density'], modes['gain_rate'], modes['innovation_ratio']
    for j in range(MODES):
        left = 1.0 - gain[j]
        rough = noise['roughness'] + (1.0 - noise['roughness']) * left
        variance[j] = noise['variance'] * (ratio[j] * rough - predicted * left * left)
        half_precision[j] = 0.5 / variance[j]
        density[j] = math.sqrt(half_precision[j])


@kernel
def _find_errors(
    noise: Noise, largest: float, workspace: AdaptiveAxisWorkspace, modes: ModeSet
) -> None:
    """Write the variance of the error that noise of variance `largest` leaves in each mode's rate.

    Two lags can't tell noise behind a low-pass, which in slow modes is nearer to AR(1), from a
    vibration, which is nearer to AR(2). So the larger of both errors counts.
    """
    first, second = noise['autocorrelation'][0], noise['autocorrelation'][1]
    error, key = workspace['error'], workspace['error_key']
    if key[0] == largest and key[1] == first and key[2] == second:
        return
    key[0] = largest
    key[1] = first
    key[2] = second
    first_of_two, second_of_two = autoregression(first, second)
    for j in range(MODES):
        of_two = _error_ratio(first_of_two, second_of_two, first, modes, j)
        error[j] = largest * max(of_two, _error_ratio(first, 0.0, first, modes, j))


@kernel
def _error_ratio(a: float, b: float, correlation: float, modes: ModeSet, mode: int) -> float:
    """Return the variance of a mode's rate where noise of variance 1 is all that it is given.

    The noise is r(n) = a r(n-1) + b r(n-2) in its autocorrelation r, which is `correlation` at n =
    1. What it leaves in the mode's state follows x(k) = F x(k-1) + K v(k). White noise leaves the
    covariance C, and the rates of two states that are n samples apart have (F**n C)[0, 0].
    Correlated noise leaves the sum of this over all n, before and after, times r(n):

        sum of r(n) F**n from n = 0 on = (I + (r(1) - a) F) (I - a F - b F F)^-1
    """
    r, kept = modes['lag_ratio'][mode], 1.0 - modes['gain_rate'][mode]
    # The rows of F are (kept, kept, 0), (f10, f11, 1), (f20, f20, r).
    f10, f20 = -modes['gain_acceleration'][mode], -modes['gain_jerk'][mode]
    f11 = r + f10
    m00 = 1.0 - a * kept - b * kept * (kept + f10)
    m01 = -a * kept - b * kept * (kept + f11)
    m02 = -b * kept
    m10 = -a * f10 - b * (f10 * kept + f11 * f10 + f20)
    m11 = 1.0 - a * f11 - b * (f10 * kept + f11 * f11 + f20)
    m12 = -a - b * (f11 + r)
    m20 = -a * f20 - b * f20 * (kept + f10 + r)
    m21 = -a * f20 - b * f20 * (kept + f11 + r)
    m22 = 1.0 - a * r - b * (f20 + r * r)
    # I - a F - b F F, times x, is the first column of C; by Cramer's rule.
    c0, c1 = modes['noise_rate'][mode], modes['noise_acceleration'][mode]
    c2 = modes['noise_jerk'][mode]
    minor0, minor1 = m11 * m22 - m12 * m21, m12 * m20 - m10 * m22
    determinant = m00 * minor0 + m01 * minor1 + m02 * (m10 * m21 - m11 * m20)
    x0 = c0 * minor0 + c1 * (m02 * m21 - m01 * m22) + c2 * (m01 * m12 - m02 * m11)
    x1 = c0 * minor1 + c1 * (m00 * m22 - m02 * m20) + c2 * (m02 * m10 - m00 * m12)
    one_way = (x0 + (correlation - a) * kept * (x0 + x1)) / determinant
    return float(2.0 * one_way - c0)


@kernel
def correct(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    sample: float,
    steps: float,
    modes: ModeSet,
) -> None:
    """Correct each mode, equations (10) and (11), and weigh the modes by their likelihood.

    `steps` is the number of samples since the last one that was accepted: the innovation has built
    up over all of them, and gains for one step would overshoot in acceleration and jerk.
    """
    probability, prior = state['probability'], workspace['prior']
    rate, acceleration, jerk = state['rate'], state['acceleration'], state['jerk']
    predicted_rate, predicted_acceleration = workspace['rate'], workspace['acceleration']
    predicted_jerk, expected = workspace['jerk'], workspace['expected']
    gain_rate, gain_acceleration = modes['gain_rate'], modes['gain_acceleration']
    gain_jerk = modes['gain_jerk']
    half_precision, density = workspace['half_precision'], workspace['density']
    share = 1.0 / steps
    for j in range(MODES):
        innovation = sample - predicted_rate[j]
        rate[j] = predicted_rate[j] + gain_rate[j] * innovation
        acceleration[j] = predicted_acceleration[j] + gain_acceleration[j] * innovation * share
        jerk[j] = predicted_jerk[j] + gain_jerk[j] * innovation * (share * share)
        surprise = sample - expected[j]
        probability[j] = -(surprise * surprise * half_precision[j])
    largest = _largest(probability)
    for j in range(MODES):
        probability[j] = prior[j] * density[j] * _exponential(probability[j] - largest)
    whole = 1.0 / _sum(probability)
    for j in range(MODES):
        probability[j] = max(probability[j] * whole, LEAST_PROBABILITY)


@kernel
def _exponential(exponent: float) -> float:
    """Return exp(exponent), limited to exponents of -80 to 0; to 1e-7 of it from -10 on.

    By its series for a 128th of it, and seven squares. Unlike `math.exp` it can be a vector
    instruction.
    """
    x = min(max(exponent, -80.0), 0.0) * (1.0 / 128.0)
    square = x * x
    root = (1.0 + x) + square * (0.5 + x * (1.0 / 6.0))
    root += square * square * (1.0 / 24.0 + x * (1.0 / 120.0))
    root *= root
    root *= root
    root *= root
    root *= root
    root *= root
    root *= root
    return root * root
