"""Method `adaptive`: interacting Kalman filters per axis, from rest to fast motion.

Each level of the ladder (`ladder.py`) is a Kalman filter with another Q. How well each predicted
the sample gives its probability (interacting multiple models; Blom and Bar-Shalom, IEEE
Transactions on Automatic Control 33, 1988): the probabilities are the adaptive Q. R and the noise's
correlation are learned at rest (`noise.py`). A doubtful sample is held back (`outliers.py`).

Rates are in rad/s, variances in (rad/s)^2, slope and bend in rad/s per sample. Equation numbers are
the paper's.
"""

import math
from typing import Any

import numpy as np

from gyro_drift_filter.core.compiled import compiled
from gyro_drift_filter.core.ladder import FALLS, LADDER, LEVELS, derive_ladder
from gyro_drift_filter.core.noise import (
    BLOCK_SECONDS,
    FORGETTING_SECONDS,
    LEAST_BLOCK,
    NOISE,
    interrupt_block,
    learn_noise,
    restart_block,
    start_noise,
)
from gyro_drift_filter.core.outliers import (
    BELIEVE,
    DOUBT,
    FIRST_CHANGE,
    HOLD,
    JOLTS,
    OUTLIER_LIMITS,
    RESTART,
    derive_limits,
    feel_jolt,
    is_constant,
    judge,
    note_held,
    note_missing,
    note_verdict,
    start_doubt,
)

LEAST_PROBABILITY = 1e-30
# What was motion among held samples is made up for within this time, so that the heading holds, as
# far as it is no more than this angle: more at once no knock turns a body.
MAKE_UP_SECONDS = 0.2
LARGEST_DEBT = 0.02  # rad
# Zeros on all axes are a drop-out where they are a surprise on any of them by this many standard
# deviations of the noise, or steps of its resolution. A driver with nothing to say reports zeros;
# a robot at rest may, too.
DROPOUT = 3.0

_LEVEL_ARRAY = (LEVELS,)

ADAPTIVE_COEFFICIENTS = np.dtype(
    [
        ('ladder', LADDER),
        ('limits', OUTLIER_LIMITS),
        ('block_samples', np.int64),
        ('block_forgetting', np.float64),  # b of equation (13), from block to block of noise
    ]
)

ADAPTIVE_STATE = np.dtype(
    [
        ('tracking', np.bool_),  # the ladder stands at the sample before
        ('learning', np.bool_),  # the noise has been given a first value
        # the ladder after the last sample
        ('probability', np.float64, _LEVEL_ARRAY),
        ('rate', np.float64, _LEVEL_ARRAY),
        ('slope', np.float64, _LEVEL_ARRAY),
        ('bend', np.float64, _LEVEL_ARRAY),
        # the ladder before the present sample
        ('prior', np.float64, _LEVEL_ARRAY),
        ('predicted_rate', np.float64, _LEVEL_ARRAY),
        ('predicted_slope', np.float64, _LEVEL_ARRAY),
        ('predicted_bend', np.float64, _LEVEL_ARRAY),
        ('predicted_noise', np.float64, _LEVEL_ARRAY),  # what its correlation foretells of it
        ('variance', np.float64, _LEVEL_ARRAY),  # of the innovation of each level
        ('prediction', np.float64),
        ('prediction_variance', np.float64),  # of the innovation
        ('spread', np.float64),  # typical innovation, rad/s: the yardstick of outliers
        ('sample_believed', np.bool_),  # the last sample
        ('believed', np.float64),  # the last sample that was, rad/s
        ('noise', NOISE),
        ('doubt', DOUBT),
        ('jolt', JOLTS),  # of the accelerometer along the same axis
        ('confirmed', np.bool_),  # the last sample showed those held back to be motion
        ('knocked', np.bool_),  # a jolt was felt while samples were held back
        ('withheld', np.float64),  # rad, what the held samples turned beyond what was put out
        ('owed', np.float64),  # rad, of it that was motion and is still to be made up for
    ],
    align=True,
)


def derive_adaptive(
    forgetting_factor: float,
    threshold: float,
    acceleration: float,
    run: int,
    period: float,
    coefficients: Any,
) -> None:
    """Fill the coefficients for a sample period in s.

    The forgetting factor is for `FORGETTING_SECONDS`; the others are as for `derive_limits`.
    """
    derive_ladder(period, coefficients['ladder'])
    derive_limits(threshold, acceleration, run, period, coefficients['limits'])
    samples = max(LEAST_BLOCK, int(BLOCK_SECONDS / period))
    coefficients['block_samples'] = samples
    coefficients['block_forgetting'] = forgetting_factor ** (samples * period / FORGETTING_SECONDS)


@compiled
def start_adaptive(axis: Any, sample: float, deviation: float, phi: float) -> None:
    """Begin at a sample: nothing known but that the rate is near it.

    What was learned of the noise is kept; before that it is as for `start_noise`.
    """
    if not axis['learning']:
        start_noise(axis['noise'], deviation, phi)
        axis['jolt']['usual_change'] = FIRST_CHANGE
        axis['learning'] = True
    restart_block(axis['noise'])
    _restart(axis, sample)
    _believe_level(axis, LEVELS - 1)
    axis['withheld'] = 0.0
    axis['owed'] = 0.0
    axis['knocked'] = False
    axis['tracking'] = True
    axis['sample_believed'] = False
    axis['believed'] = sample
    start_doubt(axis['doubt'], sample)


@compiled
def _restart(axis: Any, sample: float) -> None:
    """Put all levels on a sample."""
    rate, slope, bend = axis['rate'], axis['slope'], axis['bend']
    for j in range(LEVELS):
        rate[j] = sample
        slope[j] = 0.0
        bend[j] = 0.0
    axis['doubt']['held'] = 0
    axis['doubt']['agreeing'] = 0


@compiled
def _believe_level(axis: Any, level: int) -> None:
    """Put one level on top of the others."""
    probability = axis['probability']
    for j in range(LEVELS):
        probability[j] = 1e-9
    probability[level] = 1.0


@compiled
def rescale_adaptive(axis: Any, periods: float) -> None:
    """Carry slope and bend, which are per sample, over to another period, `periods` old ones."""
    slope, bend = axis['slope'], axis['bend']
    for j in range(LEVELS):
        slope[j] *= periods
        bend[j] *= periods * periods


@compiled
def predict_adaptive(axis: Any, ladder: Any) -> None:
    """Predict the next sample: its mean and variance are in the state then."""
    _mix(axis, ladder)
    _predict(axis, ladder)


@compiled
def coast_adaptive(axis: Any) -> None:
    """Take the prediction for the state: the sample is missing or not believed."""
    probability, prior = axis['probability'], axis['prior']
    rate, slope, bend = axis['rate'], axis['slope'], axis['bend']
    predicted_rate, predicted_slope = axis['predicted_rate'], axis['predicted_slope']
    predicted_bend = axis['predicted_bend']
    for j in range(LEVELS):
        probability[j] = prior[j]
        rate[j] = predicted_rate[j]
        slope[j] = predicted_slope[j]
        bend[j] = predicted_bend[j]


@compiled
def miss_adaptive(axis: Any) -> None:
    """Pass over a sample that is missing or no number, after its prediction."""
    coast_adaptive(axis)
    axis['sample_believed'] = False
    note_missing(axis['doubt'], axis['spread'])
    interrupt_block(axis['noise'])


@compiled
def jolts(axis: Any, acceleration: float) -> bool:
    """Tell whether the acceleration along the axis (m/s^2) has just jumped; call once a sample."""
    return feel_jolt(axis['jolt'], acceleration)


@compiled
def surprises(axis: Any, sample: float) -> bool:
    """Tell whether a sample is far from its prediction and the last one, measured by the noise."""
    noise = axis['noise']
    surprise = min(abs(sample - axis['prediction']), abs(sample - axis['believed']))
    usual = DROPOUT * max(math.sqrt(noise['variance']), noise['resolution'])
    return bool(noise['blocks'] > 0 and surprise > max(usual, axis['spread']))


@compiled
def update_adaptive(
    axis: Any,
    sample: float,
    dropout: bool,
    jolted: bool,
    coefficients: Any,
) -> bool:
    """Take a sample (rad/s) in after its prediction; return whether it was held back.

    `dropout` says that the sensor had nothing to say, `jolted` that the accelerometer was shaken.
    """
    doubt, noise, limits = axis['doubt'], axis['noise'], coefficients['limits']
    prediction, spread = axis['prediction'], axis['spread']
    verdict = judge(doubt, sample, prediction, spread, dropout, jolted, limits)
    if is_constant(doubt, sample, noise['variance']):
        _restart(axis, sample)
        verdict = BELIEVE
    elif verdict == HOLD:
        note_held(doubt, sample, prediction, spread, dropout, limits)
        coast_adaptive(axis)
        _stay_within_reach(axis, limits['growth_limit'] * doubt['held'])
    elif verdict == RESTART:
        _restart(axis, sample)
        jump = abs(sample - prediction)
        _believe_level(axis, _level_of(jump, noise['variance'], coefficients['ladder']))
    else:
        steps = 1.0 + doubt['held']
        doubt['held'] = 0
        _correct(axis, sample, steps, coefficients['ladder'])
    axis['confirmed'] = verdict == RESTART
    doubt['sample'] = sample
    note_verdict(doubt, verdict == HOLD and not dropout)
    axis['sample_believed'] = verdict != HOLD
    if verdict == HOLD:
        interrupt_block(noise)
        return True
    axis['believed'] = sample
    if verdict == BELIEVE:
        learn_noise(noise, sample, coefficients['block_samples'], coefficients['block_forgetting'])
    else:
        restart_block(noise)
    return False


@compiled
def make_up(axis: Any, sample: float, rate: float, jolted: bool, period: float) -> float:
    """Return what to add to `rate`, the output in rad/s, for motion that was held back before.

    Motion it was where it was confirmed, or where the accelerometer felt a knock.
    """
    if axis['doubt']['held'] > 0:
        axis['withheld'] += (sample - rate) * period
        axis['knocked'] = axis['knocked'] or jolted
    elif axis['withheld'] != 0.0:
        moved = axis['confirmed'] or axis['knocked']
        if moved and abs(axis['withheld']) <= LARGEST_DEBT:
            owed = axis['owed'] + axis['withheld']
            axis['owed'] = min(max(owed, -LARGEST_DEBT), LARGEST_DEBT)
        axis['withheld'] = 0.0
        axis['knocked'] = False
    payment = axis['owed'] * min(period / MAKE_UP_SECONDS, 1.0)
    axis['owed'] -= payment
    return float(payment / period)


@compiled
def _stay_within_reach(axis: Any, reach: float) -> None:
    """Keep an extrapolation within `reach` (rad/s) of the last sample that was believed."""
    rate, believed = axis['rate'], axis['believed']
    for j in range(LEVELS):
        rate[j] = min(max(rate[j], believed - reach), believed + reach)


@compiled
def estimate_adaptive(axis: Any, ladder: Any) -> tuple[float, float, float]:
    """Return what the levels say together: rate, its variance, and Q, in place of (17)."""
    probability, rate = axis['probability'], axis['rate']
    gain, process = ladder['gain_rate'], ladder['process_ratio']
    ratio = ladder['innovation_ratio']
    noise = axis['noise']['variance']
    # The error of an extrapolation grows about as the number of samples.
    growth = 1.0 * axis['doubt']['held'] * axis['doubt']['held']
    mean = 0.0
    process_noise = 0.0
    for j in range(LEVELS):
        mean += probability[j] * rate[j]
        process_noise += probability[j] * process[j]
    variance = 0.0
    for j in range(LEVELS):
        distance = rate[j] - mean
        own = gain[j] if growth == 0.0 else (ratio[j] - 1.0) * growth
        variance += probability[j] * (own * noise + distance * distance)
    return mean, variance, process_noise * noise


@compiled
def _mix(axis: Any, ladder: Any) -> None:
    """Move probability, and the states with it, along the chain: interacting models.

    Each level passes on a share upwards and a share downwards, which end with falling probability
    on one of the levels beyond. Two passes do it, as the shares are geometric. What arrives on a
    level is averaged into its state. Leaves the mixed states in predicted_*, and the prior.
    """
    probability, prior = axis['probability'], axis['prior']
    rate, slope, bend = axis['rate'], axis['slope'], axis['bend']
    mixed_rate, mixed_slope = axis['predicted_rate'], axis['predicted_slope']
    mixed_bend = axis['predicted_bend']
    climb, fall = ladder['climb'], ladder['fall']
    climb_on, climb_first = ladder['climb_on'], ladder['climb_first']
    keep_slope, keep_bend = ladder['keep_slope'], ladder['keep_bend']
    weight = weighted_rate = weighted_slope = weighted_bend = 0.0
    for j in range(LEVELS):
        stay = probability[j] * (1.0 - climb[j] - fall[j])
        prior[j] = stay + weight
        mixed_rate[j] = stay * rate[j] + weighted_rate
        mixed_slope[j] = stay * slope[j] + weighted_slope
        mixed_bend[j] = stay * bend[j] + weighted_bend
        on = climb_on[j + 1] if j + 1 < LEVELS else 0.0
        leave = probability[j] * climb[j] * climb_first[j]
        weight = weight * on + leave
        weighted_rate = weighted_rate * on + leave * rate[j]
        weighted_slope = weighted_slope * on + leave * slope[j]
        weighted_bend = weighted_bend * on + leave * bend[j]
    weight = weighted_rate = weighted_slope = weighted_bend = total = 0.0
    for j in range(LEVELS - 1, -1, -1):
        prior[j] += weight
        mixed_rate[j] += weighted_rate
        mixed_slope[j] += weighted_slope
        mixed_bend[j] += weighted_bend
        total += prior[j]
        leave = probability[j] * fall[j] * (1.0 - FALLS)
        weight = weight * FALLS + leave
        weighted_rate = weighted_rate * FALLS + leave * rate[j]
        weighted_slope = (weighted_slope * FALLS + leave * slope[j]) * keep_slope[j]
        weighted_bend = (weighted_bend * FALLS + leave * bend[j]) * keep_bend[j]
    for j in range(LEVELS):
        share = 1.0 / prior[j]
        mixed_rate[j] *= share
        mixed_slope[j] *= share
        mixed_bend[j] *= share
        prior[j] /= total


@compiled
def _predict(axis: Any, ladder: Any) -> None:
    """Predict the sample with each level, equation (7), and all together: mean and variance.

    The innovation of a level is the sample less the predicted rate and less the noise that the
    last residual foretells, correlation * residual: this makes the innovations of a slow level
    white although the sensor's noise is not. With gain K the residual holds 1 - K of the noise, so
    the variance falls by (correlation * (1 - K)) ** 2. A fast level sees less noise, as far as its
    own prediction follows the noise: from all of it at K = 0 to `roughness` at K = 1.
    """
    rate, slope, bend = axis['predicted_rate'], axis['predicted_slope'], axis['predicted_bend']
    foretold, variance, prior = axis['predicted_noise'], axis['variance'], axis['prior']
    lag_ratio, gain = ladder['lag_ratio'], ladder['gain_rate']
    ratio, logarithm = ladder['innovation_ratio'], ladder['innovation_logarithm']
    noise = axis['noise']
    r, rough = noise['variance'], noise['roughness']
    correlation = noise['correlation'] if axis['sample_believed'] else 0.0
    sample = axis['doubt']['sample']
    prediction = 0.0
    mean_logarithm = 0.0
    for j in range(LEVELS):
        foretold[j] = correlation * (sample - rate[j])
        rate[j] += slope[j]
        slope[j] = lag_ratio[j] * slope[j] + bend[j]
        bend[j] *= lag_ratio[j]
        prediction += prior[j] * (rate[j] + foretold[j])
        mean_logarithm += prior[j] * logarithm[j]
    total = 0.0
    for j in range(LEVELS):
        left = 1.0 - gain[j]
        known = correlation * left
        variance[j] = r * (ratio[j] * (rough + (1.0 - rough) * left) - known * known)
        distance = rate[j] + foretold[j] - prediction
        total += prior[j] * (variance[j] + distance * distance)
    axis['prediction'] = prediction
    axis['prediction_variance'] = total
    # The geometric mean is not blown up by the small chance of a high level.
    axis['spread'] = math.sqrt(r * math.exp(mean_logarithm))


@compiled
def _correct(axis: Any, sample: float, steps: float, ladder: Any) -> None:
    """Correct each level, equations (10) and (11), and weigh the levels by their likelihood.

    `steps` is the number of samples since the last one that was believed: the innovation has built
    up over all of them, and gains for one step would overshoot in slope and bend.
    """
    probability, prior, variance = axis['probability'], axis['prior'], axis['variance']
    rate, slope, bend = axis['rate'], axis['slope'], axis['bend']
    predicted_rate, predicted_slope = axis['predicted_rate'], axis['predicted_slope']
    predicted_bend, foretold = axis['predicted_bend'], axis['predicted_noise']
    gain_rate, gain_slope = ladder['gain_rate'], ladder['gain_slope']
    gain_bend = ladder['gain_bend']
    least = np.inf
    for j in range(LEVELS):
        innovation = sample - predicted_rate[j]
        rate[j] = predicted_rate[j] + gain_rate[j] * innovation
        slope[j] = predicted_slope[j] + gain_slope[j] * innovation / steps
        bend[j] = predicted_bend[j] + gain_bend[j] * innovation / (steps * steps)
        innovation -= foretold[j]
        probability[j] = innovation * innovation / variance[j]
        least = min(least, probability[j])
    total = 0.0
    for j in range(LEVELS):
        likelihood = math.exp(0.5 * (least - probability[j])) / math.sqrt(variance[j])
        probability[j] = prior[j] * likelihood
        total += probability[j]
    for j in range(LEVELS):
        probability[j] = max(probability[j] / total, LEAST_PROBABILITY)


@compiled
def _level_of(size: float, variance: float, ladder: Any) -> int:
    """Return the lowest level to which a jump of this size (rad/s) is nothing special."""
    ratio = ladder['innovation_ratio']
    level = LEVELS - 1
    while level > 0 and ratio[level - 1] * variance > size * size:
        level -= 1
    return level
