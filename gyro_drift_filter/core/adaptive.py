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
        ('expected', np.float64, _LEVEL_ARRAY),  # the sample: with what is foretold of its noise
        # of the innovation of each level: variance, half its inverse, and the square root of that
        ('variance', np.float64, _LEVEL_ARRAY),
        ('half_precision', np.float64, _LEVEL_ARRAY),
        ('density', np.float64, _LEVEL_ARRAY),
        ('of_noise', np.float64, (3,)),  # variance, roughness and correlation that they belong to
        ('level_spread', np.float64, _LEVEL_ARRAY),  # variance about the mean of all levels
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
def believe_all_levels(axis: Any) -> None:
    """Leave it to the next sample which level holds, after `start_adaptive` at a rate."""
    probability = axis['probability']
    for j in range(LEVELS):
        probability[j] = 1.0 / LEVELS


@compiled
def rescale_adaptive(axis: Any, periods: float) -> None:
    """Carry slope and bend, which are per sample, over to another period, `periods` old ones."""
    slope, bend = axis['slope'], axis['bend']
    for j in range(LEVELS):
        slope[j] *= periods
        bend[j] *= periods * periods
    axis['of_noise'][0] = 0.0


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
    probability, rate, spread = axis['probability'], axis['rate'], axis['level_spread']
    gain, ratio = ladder['gain_rate'], ladder['innovation_ratio']
    noise = axis['noise']['variance']
    # The error of an extrapolation grows about as the number of samples.
    growth = 1.0 * axis['doubt']['held'] * axis['doubt']['held']
    mean = _weighted(probability, rate)
    for j in range(LEVELS):
        distance = rate[j] - mean
        own = gain[j] if growth == 0.0 else (ratio[j] - 1.0) * growth
        spread[j] = own * noise + distance * distance
    variance = _weighted(probability, spread)
    return mean, variance, _weighted(probability, ladder['process_ratio']) * noise


# The loops below are cut so that compilers turn them into vector instructions: what can be done on
# each level apart from what goes from level to level, and sums by `_sum` and `_weighted`.


@compiled
def _sum(values: Any) -> float:
    """Return the sum over the levels: four sums side by side, as each waits for its last term."""
    a = b = c = d = 0.0
    for j in range(0, LEVELS - 3, 4):
        a += values[j]
        b += values[j + 1]
        c += values[j + 2]
        d += values[j + 3]
    for j in range(LEVELS - LEVELS % 4, LEVELS):
        a += values[j]
    return (a + b) + (c + d)


@compiled
def _weighted(weights: Any, values: Any) -> float:
    """Return the sum of weighted values over the levels, as `_sum` does."""
    a = b = c = d = 0.0
    for j in range(0, LEVELS - 3, 4):
        a += weights[j] * values[j]
        b += weights[j + 1] * values[j + 1]
        c += weights[j + 2] * values[j + 2]
        d += weights[j + 3] * values[j + 3]
    for j in range(LEVELS - LEVELS % 4, LEVELS):
        a += weights[j] * values[j]
    return (a + b) + (c + d)


@compiled
def _mix(axis: Any, ladder: Any) -> None:
    """Move probability, and the states with it, along the chain: interacting models.

    Each level passes on a share upwards and a share downwards, which end with falling probability
    on one of the levels beyond. One pass each way does it, as the shares are geometric. What
    arrives on a level is averaged into its state. Leaves the mixed states in predicted_*, and the
    prior.
    """
    probability, prior = axis['probability'], axis['prior']
    rate, slope, bend = axis['rate'], axis['slope'], axis['bend']
    mixed_rate, mixed_slope = axis['predicted_rate'], axis['predicted_slope']
    mixed_bend = axis['predicted_bend']
    climb, fall = ladder['climb'], ladder['fall']
    climb_on, climb_first = ladder['climb_on'], ladder['climb_first']
    keep_slope, keep_bend = ladder['keep_slope'], ladder['keep_bend']
    for j in range(LEVELS):
        stay = probability[j] * (1.0 - climb[j] - fall[j])
        prior[j] = stay
        mixed_rate[j] = stay * rate[j]
        mixed_slope[j] = stay * slope[j]
        mixed_bend[j] = stay * bend[j]
    up = up_rate = up_slope = up_bend = 0.0
    down = down_rate = down_slope = down_bend = 0.0
    for i in range(1, LEVELS):
        # Both ways at once, as each waits for its last step: from i - 1 up and from k + 1 down.
        on = climb_on[i]
        leave = probability[i - 1] * climb[i - 1] * climb_first[i - 1]
        up = up * on + leave
        up_rate = up_rate * on + leave * rate[i - 1]
        up_slope = up_slope * on + leave * slope[i - 1]
        up_bend = up_bend * on + leave * bend[i - 1]
        prior[i] += up
        mixed_rate[i] += up_rate
        mixed_slope[i] += up_slope
        mixed_bend[i] += up_bend
        k = LEVELS - 1 - i
        leave = probability[k + 1] * fall[k + 1] * (1.0 - FALLS)
        down = down * FALLS + leave
        down_rate = down_rate * FALLS + leave * rate[k + 1]
        down_slope = (down_slope * FALLS + leave * slope[k + 1]) * keep_slope[k + 1]
        down_bend = (down_bend * FALLS + leave * bend[k + 1]) * keep_bend[k + 1]
        prior[k] += down
        mixed_rate[k] += down_rate
        mixed_slope[k] += down_slope
        mixed_bend[k] += down_bend
    whole = 1.0 / _sum(prior)
    for j in range(LEVELS):
        share = 1.0 / prior[j]
        mixed_rate[j] *= share
        mixed_slope[j] *= share
        mixed_bend[j] *= share
        prior[j] *= whole


@compiled
def _predict(axis: Any, ladder: Any) -> None:
    """Predict the sample with each level, equation (7), and all together: mean and variance.

    The innovation of a level is the sample less the predicted rate and less the noise that the
    last residual foretells, correlation * residual: this makes the innovations of a slow level
    white although the sensor's noise is not.
    """
    rate, slope, bend = axis['predicted_rate'], axis['predicted_slope'], axis['predicted_bend']
    expected, variance, spread = axis['expected'], axis['variance'], axis['level_spread']
    prior, noise, lag_ratio = axis['prior'], axis['noise'], ladder['lag_ratio']
    correlation = noise['correlation'] if axis['sample_believed'] else 0.0
    of_noise = axis['of_noise']
    if (
        of_noise[0] != noise['variance']
        or of_noise[1] != noise['roughness']
        or of_noise[2] != correlation
    ):
        _spread_levels(axis, correlation, ladder)
    sample = axis['doubt']['sample']
    for j in range(LEVELS):
        foretold = correlation * (sample - rate[j])
        rate[j] += slope[j]
        expected[j] = rate[j] + foretold
        slope[j] = lag_ratio[j] * slope[j] + bend[j]
        bend[j] *= lag_ratio[j]
    prediction = _weighted(prior, expected)
    for j in range(LEVELS):
        distance = expected[j] - prediction
        spread[j] = variance[j] + distance * distance
    axis['prediction'] = prediction
    axis['prediction_variance'] = _weighted(prior, spread)
    # The geometric mean is not blown up by the small chance of a high level.
    typical = math.exp(_weighted(prior, ladder['innovation_logarithm']))
    axis['spread'] = math.sqrt(noise['variance'] * typical)


@compiled
def _spread_levels(axis: Any, correlation: float, ladder: Any) -> None:
    """Tell how far a sample may be from what each level expects of it.

    With gain K the last residual holds 1 - K of the noise, so knowing it takes
    (correlation * (1 - K)) ** 2 off the variance. A fast level sees less noise, as far as its own
    prediction follows the noise: from all of it at K = 0 to `roughness` at K = 1.
    """
    variance, noise, of_noise = axis['variance'], axis['noise'], axis['of_noise']
    half_precision, density = axis['half_precision'], axis['density']
    gain, ratio = ladder['gain_rate'], ladder['innovation_ratio']
    of_noise[0] = noise['variance']
    of_noise[1] = noise['roughness']
    of_noise[2] = correlation
    for j in range(LEVELS):
        left = 1.0 - gain[j]
        rough = noise['roughness'] + (1.0 - noise['roughness']) * left
        known = correlation * left
        variance[j] = noise['variance'] * (ratio[j] * rough - known * known)
        half_precision[j] = 0.5 / variance[j]
        density[j] = math.sqrt(half_precision[j])


@compiled
def _correct(axis: Any, sample: float, steps: float, ladder: Any) -> None:
    """Correct each level, equations (10) and (11), and weigh the levels by their likelihood.

    `steps` is the number of samples since the last one that was believed: the innovation has built
    up over all of them, and gains for one step would overshoot in slope and bend.
    """
    probability, prior = axis['probability'], axis['prior']
    rate, slope, bend = axis['rate'], axis['slope'], axis['bend']
    predicted_rate, predicted_slope = axis['predicted_rate'], axis['predicted_slope']
    predicted_bend, expected = axis['predicted_bend'], axis['expected']
    gain_rate, gain_slope = ladder['gain_rate'], ladder['gain_slope']
    gain_bend = ladder['gain_bend']
    half_precision, density = axis['half_precision'], axis['density']
    share = 1.0 / steps
    for j in range(LEVELS):
        innovation = sample - predicted_rate[j]
        rate[j] = predicted_rate[j] + gain_rate[j] * innovation
        slope[j] = predicted_slope[j] + gain_slope[j] * innovation * share
        bend[j] = predicted_bend[j] + gain_bend[j] * innovation * (share * share)
    for j in range(LEVELS):
        innovation = sample - expected[j]
        probability[j] = -(innovation * innovation * half_precision[j])
    largest = -np.inf
    for j in range(LEVELS):
        largest = max(largest, probability[j])
    for j in range(LEVELS):
        probability[j] = prior[j] * density[j] * _decay(probability[j] - largest)
    whole = 1.0 / _sum(probability)
    for j in range(LEVELS):
        probability[j] = max(probability[j] * whole, LEAST_PROBABILITY)


@compiled
def _decay(exponent: float) -> float:
    """Return exp(exponent) for one of 0 and below, with an error of 1e-13; exp(-80) for less.

    By its series for a 256th of it, and eight squares. Unlike `math.exp` it can be a vector
    instruction.
    """
    x = max(exponent, -80.0) / 256.0
    tail = 1.0 / 6.0 + x * (1.0 / 24.0 + x * (1.0 / 120.0 + x / 720.0))
    root = 1.0 + x * (1.0 + x * (0.5 + x * tail))
    root *= root
    root *= root
    root *= root
    root *= root
    root *= root
    root *= root
    root *= root
    return root * root


@compiled
def _level_of(size: float, variance: float, ladder: Any) -> int:
    """Return the lowest level to which a jump of this size (rad/s) is nothing special."""
    ratio = ladder['innovation_ratio']
    level = LEVELS - 1
    while level > 0 and ratio[level - 1] * variance > size * size:
        level -= 1
    return level
