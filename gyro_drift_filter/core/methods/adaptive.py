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

from gyro_drift_filter.accelerate.kernels import kernel
from gyro_drift_filter.accelerate.records import in_lines
from gyro_drift_filter.core.methods.advice import Advice
from gyro_drift_filter.core.methods.mode_set import FALLS, LADDER, LANES, LEVELS, derive_ladder
from gyro_drift_filter.core.methods.noise import (
    BLOCK_SECONDS,
    FORGETTING_SECONDS,
    LEAST_BLOCK,
    NOISE,
    interrupt_block,
    learn_noise,
    restart_block,
    start_noise,
)
from gyro_drift_filter.core.methods.outliers import (
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

# A probability below this is none.
SMALLEST = 1e-300
# What was motion among held samples is made up for within this time, so that the heading holds, as
# far as it is no more than this angle: more at once no knock turns a body.
MAKE_UP_SECONDS = 0.2
LARGEST_DEBT = 0.02  # rad
LEAST_DEBT = 1e-9  # rad: as processors are slow with numbers next to zero
# Zeros on all axes are a drop-out where they are a surprise on any of them by this many standard
# deviations of the noise, or steps of its resolution. A driver with nothing to say reports zeros;
# a robot at rest may, too.
DROPOUT = 3.0

_LEVEL_ARRAY = (LANES,)

ADAPTIVE_COEFFICIENTS = in_lines(
    [
        ('ladder', LADDER),
        ('limits', OUTLIER_LIMITS),
        ('block_samples', np.int64),
        ('block_forgetting', np.float64),  # b of equation (13), from block to block of noise
    ]
)

ADAPTIVE_STATE = in_lines(
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
        # room for what is on its way along the chain, and for what arrives on each level:
        # probability, and by it rate, slope and bend
        ('climbing', np.float64, (4, LANES)),
        ('falling', np.float64, (4, LANES)),
        ('climbed', np.float64, (4, LANES)),
        ('fallen', np.float64, (4, LANES)),
        # room for terms of sums over the levels
        ('means', np.float64, _LEVEL_ARRAY),
        ('squares', np.float64, _LEVEL_ARRAY),
        ('others', np.float64, _LEVEL_ARRAY),
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
    ]
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


@kernel
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


@kernel
def _restart(axis: Any, sample: float) -> None:
    """Put all levels on a sample."""
    rate, slope, bend = axis['rate'], axis['slope'], axis['bend']
    for j in range(LEVELS):
        rate[j] = sample
        slope[j] = 0.0
        bend[j] = 0.0
    axis['doubt']['held'] = 0
    axis['doubt']['agreeing'] = 0


@kernel
def _believe_level(axis: Any, level: int) -> None:
    """Put one level on top of the others."""
    probability = axis['probability']
    for j in range(LEVELS):
        probability[j] = 1e-9
    probability[level] = 1.0


@kernel
def believe_all_levels(axis: Any) -> None:
    """Leave it to the next sample which level holds, after `start_adaptive` at a rate."""
    probability = axis['probability']
    for j in range(LEVELS):
        probability[j] = 1.0 / LEVELS


@kernel
def rescale_adaptive(axis: Any, periods: float) -> None:
    """Carry slope and bend, which are per sample, over to another period, `periods` old ones."""
    slope, bend = axis['slope'], axis['bend']
    for j in range(LEVELS):
        slope[j] *= periods
        bend[j] *= periods * periods
    axis['of_noise'][0] = 0.0


@kernel
def predict_adaptive(axis: Any, ladder: Any) -> None:
    """Predict the next sample: its mean and variance are in the state then."""
    _mix(axis, ladder)
    _predict(axis, ladder)


@kernel
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


@kernel
def miss_adaptive(axis: Any) -> None:
    """Pass over a sample that is missing or no number, after its prediction."""
    coast_adaptive(axis)
    axis['sample_believed'] = False
    note_missing(axis['doubt'], axis['spread'])
    interrupt_block(axis['noise'])


@kernel
def jolts(axis: Any, acceleration: float) -> bool:
    """Tell whether the acceleration along the axis (m/s^2) has just jumped; call once a sample."""
    return feel_jolt(axis['jolt'], acceleration)


@kernel
def surprises(axis: Any, sample: float) -> bool:
    """Tell whether a sample is far from its prediction and the last one, measured by the noise."""
    noise = axis['noise']
    surprise = min(abs(sample - axis['prediction']), abs(sample - axis['believed']))
    usual = DROPOUT * max(math.sqrt(noise['variance']), noise['resolution'])
    return bool(noise['blocks'] > 0 and surprise > max(usual, axis['spread']))


@kernel
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


@kernel
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
    if abs(axis['owed']) < LEAST_DEBT:
        axis['owed'] = 0.0
    payment = axis['owed'] * min(period / MAKE_UP_SECONDS, 1.0)
    axis['owed'] -= payment
    return float(payment / period)


@kernel
def _stay_within_reach(axis: Any, reach: float) -> None:
    """Keep an extrapolation within `reach` (rad/s) of the last sample that was believed."""
    rate, believed = axis['rate'], axis['believed']
    for j in range(LEVELS):
        rate[j] = min(max(rate[j], believed - reach), believed + reach)


@kernel
def estimate_adaptive(axis: Any, ladder: Any) -> tuple[float, float, float]:
    """Return what the levels say together: rate, its variance, and Q, in place of (17)."""
    probability, rate = axis['probability'], axis['rate']
    means, squares, others = axis['means'], axis['squares'], axis['others']
    gain, ratio = ladder['gain_rate'], ladder['innovation_ratio']
    process = ladder['process_ratio']
    noise = axis['noise']['variance']
    # The error of an extrapolation grows about as the number of samples.
    growth = 1.0 * axis['doubt']['held'] * axis['doubt']['held']
    origin = rate[LEVELS - 1]
    for j in range(LANES):
        distance = rate[j] - origin
        own = gain[j] if growth == 0.0 else (ratio[j] - 1.0) * growth
        means[j] = probability[j] * distance
        squares[j] = probability[j] * (own * noise + distance * distance)
        others[j] = probability[j] * process[j]
    mean = _sum(means)
    variance = max(_sum(squares) - mean * mean, gain[0] * noise)
    return origin + mean, variance, _sum(others) * noise


# The loops below are cut so that compilers turn them into vector instructions: what can be done on
# each level apart from what goes from level to level, and sums by `_sum`. They go over LANES where
# what is beyond LEVELS stays zero.


@kernel
def _sum(values: Any) -> float:
    """Return the sum over the levels: four sums side by side, as each waits for its last term."""
    a = b = c = d = 0.0
    for j in range(0, LANES, 4):
        a += values[j]
        b += values[j + 1]
        c += values[j + 2]
        d += values[j + 3]
    return (a + b) + (c + d)


@kernel
def _largest(values: Any) -> float:
    """Return the largest value over the levels, as `_sum` does."""
    a = b = c = d = values[0]
    for j in range(0, LEVELS - 3, 4):
        a = max(a, values[j])
        b = max(b, values[j + 1])
        c = max(c, values[j + 2])
        d = max(d, values[j + 3])
    for j in range(LEVELS - LEVELS % 4, LEVELS):
        a = max(a, values[j])
    largest: float = max(max(a, b), max(c, d))
    return largest


@kernel
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
    climbing, falling = axis['climbing'], axis['falling']
    climbed, fallen = axis['climbed'], axis['fallen']
    stay, climb, climb_on = ladder['stay'], ladder['climb_near'], ladder['climb_on']
    fall = ladder['fall_near']
    fall_slope, fall_bend = ladder['fall_slope'], ladder['fall_bend']
    slope_on, bend_on = ladder['slope_on'], ladder['bend_on']
    for j in range(LANES):
        weight = probability[j]
        mixed_rate[j] = weight * rate[j]
        mixed_slope[j] = weight * slope[j]
        mixed_bend[j] = weight * bend[j]
    for j in range(LANES):
        climbing[0, j] = probability[j] * climb[j]
        climbing[1, j] = mixed_rate[j] * climb[j]
        climbing[2, j] = mixed_slope[j] * climb[j]
        climbing[3, j] = mixed_bend[j] * climb[j]
        falling[0, j] = probability[j] * fall[j]
        falling[1, j] = mixed_rate[j] * fall[j]
        falling[2, j] = mixed_slope[j] * fall_slope[j]
        falling[3, j] = mixed_bend[j] * fall_bend[j]
    up = up_rate = up_slope = up_bend = 0.0
    down = down_rate = down_slope = down_bend = 0.0
    for i in range(1, LEVELS):
        # Both ways at once, as each waits for its last step: to i from below and to k from above.
        on = climb_on[i]
        up = up * on + climbing[0, i - 1]
        up_rate = up_rate * on + climbing[1, i - 1]
        up_slope = up_slope * on + climbing[2, i - 1]
        up_bend = up_bend * on + climbing[3, i - 1]
        climbed[0, i] = up
        climbed[1, i] = up_rate
        climbed[2, i] = up_slope
        climbed[3, i] = up_bend
        k = LEVELS - 1 - i
        down = down * FALLS + falling[0, k + 1]
        down_rate = down_rate * FALLS + falling[1, k + 1]
        down_slope = down_slope * slope_on[k] + falling[2, k + 1]
        down_bend = down_bend * bend_on[k] + falling[3, k + 1]
        fallen[0, k] = down
        fallen[1, k] = down_rate
        fallen[2, k] = down_slope
        fallen[3, k] = down_bend
    for j in range(LANES):
        prior[j] = probability[j] * stay[j] + climbed[0, j] + fallen[0, j]
        share = 1.0 / max(prior[j], SMALLEST)
        mixed_rate[j] = (mixed_rate[j] * stay[j] + climbed[1, j] + fallen[1, j]) * share
        mixed_slope[j] = (mixed_slope[j] * stay[j] + climbed[2, j] + fallen[2, j]) * share
        mixed_bend[j] = (mixed_bend[j] * stay[j] + climbed[3, j] + fallen[3, j]) * share


@kernel
def _predict(axis: Any, ladder: Any) -> None:
    """Predict the sample with each level, equation (7), and all together: mean and variance.

    The innovation of a level is the sample less the predicted rate and less the noise that the
    last residual foretells, correlation * residual: this makes the innovations of a slow level
    white although the sensor's noise is not.
    """
    rate, slope, bend = axis['predicted_rate'], axis['predicted_slope'], axis['predicted_bend']
    expected, variance = axis['expected'], axis['variance']
    means, squares, others = axis['means'], axis['squares'], axis['others']
    prior, noise = axis['prior'], axis['noise']
    lag_ratio, logarithm = ladder['lag_ratio'], ladder['innovation_logarithm']
    correlation = noise['correlation'] if axis['sample_believed'] else 0.0
    of_noise = axis['of_noise']
    if (
        of_noise[0] != noise['variance']
        or of_noise[1] != noise['roughness']
        or of_noise[2] != correlation
    ):
        _spread_levels(axis, correlation, ladder)
    sample = axis['doubt']['sample']
    # Mean and variance by one pass, from the fastest level, which is never far off.
    origin = rate[LEVELS - 1]
    for j in range(LANES):
        foretold = correlation * (sample - rate[j])
        rate[j] += slope[j]
        expected[j] = rate[j] + foretold
        slope[j] = lag_ratio[j] * slope[j] + bend[j]
        bend[j] *= lag_ratio[j]
        distance = expected[j] - origin
        means[j] = prior[j] * distance
        squares[j] = prior[j] * (variance[j] + distance * distance)
        others[j] = prior[j] * logarithm[j]
    mean = _sum(means)
    axis['prediction'] = origin + mean
    axis['prediction_variance'] = max(_sum(squares) - mean * mean, variance[0])
    # The geometric mean is not blown up by the small chance of a high level.
    axis['spread'] = math.sqrt(noise['variance'] * math.exp(_sum(others)))


@kernel
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
    for j in range(LANES):
        left = 1.0 - gain[j]
        rough = noise['roughness'] + (1.0 - noise['roughness']) * left
        known = correlation * left
        variance[j] = noise['variance'] * (ratio[j] * rough - known * known)
        half_precision[j] = 0.5 / variance[j]
        density[j] = math.sqrt(half_precision[j])


@kernel
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
    least = ladder['least_probability']
    share = 1.0 / steps
    for j in range(LANES):
        innovation = sample - predicted_rate[j]
        rate[j] = predicted_rate[j] + gain_rate[j] * innovation
        slope[j] = predicted_slope[j] + gain_slope[j] * innovation * share
        bend[j] = predicted_bend[j] + gain_bend[j] * innovation * (share * share)
        surprise = sample - expected[j]
        probability[j] = -(surprise * surprise * half_precision[j])
    largest = _largest(probability)
    for j in range(LANES):
        probability[j] = prior[j] * density[j] * _decay(probability[j] - largest)
    whole = 1.0 / _sum(probability)
    for j in range(LANES):
        probability[j] = max(probability[j] * whole, least[j])


@kernel
def _decay(exponent: float) -> float:
    """Return exp(exponent), or that of the nearest of -80 to 0, within 1e-7 of it from -10 on.

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


@kernel
def _level_of(size: float, variance: float, ladder: Any) -> int:
    """Return the lowest level to which a jump of this size (rad/s) is nothing special."""
    ratio = ladder['innovation_ratio']
    level = LEVELS - 1
    while level > 0 and ratio[level - 1] * variance > size * size:
        level -= 1
    return level


ADVICE = Advice(
    outliers='look at the raw rates; raise outlier.threshold or outlier.acceleration',
    large_innovations='is it a vibration? Leave it at rest for a second so that it learns its '
    'noise, or set model.noise_deviation',
    small_innovations='set model.noise_deviation lower, or to 0',
    learns_noise=True,
)
