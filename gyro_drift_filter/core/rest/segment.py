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

"""The sums over a value, a block and a segment, and the means and variances that follow."""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.rest.records import (
    HALF,
    SIGNALS,
    Halves,
    MeanSums,
    Rest,
    RestLengths,
    Signal,
)

# Of a signal in its unit squared: a coarse sensor shows none at rest.
LEAST_VARIANCE = 1e-10


@kernel
def start_value(rest: Rest) -> None:
    """Start the next value."""
    rest['samples'] = rest['averaged'] = 0
    for i in range(SIGNALS):
        rest['signals'][i]['value'] = 0.0


@kernel
def add_value(rest: Rest) -> None:
    """Take the mean of the samples as a value of the block."""
    rest['count'] += 1
    share = 1.0 / rest['averaged']
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        value = signal['value'] * share
        if rest['count'] == 1:
            signal['origin'] = value
        deviation = value - signal['origin']
        signal['sum'] += deviation
        signal['squares'] += deviation * deviation


@kernel
def start_block(rest: Rest) -> None:
    """Start the next block."""
    rest['index'] = rest['count'] = 0
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        signal['sum'] = signal['squares'] = 0.0


@kernel
def is_block_filled(rest: Rest, lengths: RestLengths) -> bool:
    """Return whether half of the values of a full block were measured, or one less if it is odd."""
    return bool(rest['count'] >= lengths['block'] // 2)


@kernel
def block_mean(rest: Rest, index: int) -> float:
    """Return the mean of signal `index` over the block."""
    signal = rest['signals'][index]
    return float(signal['origin'] + signal['sum'] / (1.0 * rest['count']))


@kernel
def block_moments(rest: Rest, index: int) -> tuple[float, float]:
    """Return mean and variance of signal `index` over the block."""
    signal, count = rest['signals'][index], 1.0 * rest['count']
    variance = (signal['squares'] - signal['sum'] / count * signal['sum']) / (count - 1.0)
    return block_mean(rest, index), max(variance, signal['least_variance'], LEAST_VARIANCE)


@kernel
def let_block_wait(rest: Rest) -> None:
    """Keep the block that is complete until the next one has been judged."""
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        mean, variance = block_moments(rest, i)
        signal['waiting_mean'] = mean
        signal['waiting_variance'] = variance


@kernel
def start_segment(rest: Rest) -> None:
    """Start a segment without any block."""
    rest['blocks'] = 0
    rest['halves'] = Halves.WHOLE
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        signal['variances'] = signal['largest_variance'] = 0.0


@kernel
def add_mean(sums: MeanSums, mean: float, blocks: int) -> None:
    """Add the mean of the block that comes behind so many."""
    if blocks == 0:
        sums['first'] = sums['last'] = mean
        sums['means'] = sums['mean_squares'] = sums['steps'] = 0.0
    step, deviation = mean - sums['last'], mean - sums['first']
    sums['steps'] += step * step
    sums['means'] += deviation
    sums['mean_squares'] += deviation * deviation
    sums['last'] = mean


@kernel
def add_waiting_block(rest: Rest) -> None:
    """Take the waiting block into the segment."""
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        mean, variance = signal['waiting_mean'], signal['waiting_variance']
        add_mean(signal['segment'], mean, rest['blocks'])
        if rest['blocks'] == HALF:  # here, as the step to this block belongs to neither half
            signal['late_first'] = mean
            signal['early_steps'] = signal['segment']['steps']
        signal['variances'] += variance
        signal['largest_variance'] = max(signal['largest_variance'], variance)
    rest['blocks'] += 1
    if rest['blocks'] == HALF:
        _note_half(rest)


@kernel
def _note_half(rest: Rest) -> None:
    """Keep the sums of the segment, which has its first half."""
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        signal['early_means'] = signal['segment']['means']
        signal['early_mean_squares'] = signal['segment']['mean_squares']
        signal['early_variances'] = signal['variances']
        signal['early_largest_variance'] = signal['largest_variance']
        signal['largest_variance'] = 0.0


@kernel
def drop_early_half(rest: Rest) -> None:
    """Make the later half of the segment the first one of the next."""
    rest['blocks'] -= HALF
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        sums = signal['segment']
        means = sums['means'] - signal['early_means']
        shift = signal['late_first'] - sums['first']
        sums['first'] = signal['late_first']
        sums['means'] = means - rest['blocks'] * shift
        sums['mean_squares'] -= signal['early_mean_squares']
        sums['mean_squares'] -= (2.0 * means - rest['blocks'] * shift) * shift
        sums['steps'] -= signal['early_steps']
        signal['variances'] -= signal['early_variances']
    _note_half(rest)


@kernel
def segment_mean(rest: Rest, index: int) -> float:
    """Return the mean of signal `index` over the segment."""
    return mean_of(rest['signals'][index]['segment'], rest['blocks'])


@kernel
def value_variance(rest: Rest, signal: Signal) -> float:
    """Return the variance of the values in the segment about the means of their blocks."""
    return float(signal['variances'] / rest['blocks'])


@kernel
def mean_of(sums: MeanSums, blocks: int) -> float:
    """Return the mean of the means of so many blocks."""
    return float(sums['first'] + sums['means'] / blocks)


@kernel
def mean_square_step(sums: MeanSums, blocks: int) -> float:
    """Return the mean square of the step from the mean of one block to that of the next."""
    return float(sums['steps'] / (blocks - 1.0))


@kernel
def scatter_of_means(sums: MeanSums, blocks: int) -> float:
    """Return the variance of the means of so many blocks."""
    total = sums['means']
    return float(max(sums['mean_squares'] - total * total / blocks, 0.0) / (blocks - 1.0))


@kernel
def segment_scatter(rest: Rest, index: int) -> float:
    """Return the variance of the mean of signal `index`, by the scatter of the segment's blocks."""
    return scatter_of_means(rest['signals'][index]['segment'], rest['blocks']) / rest['blocks']


@kernel
def forget_segment_before(rest: Rest) -> None:
    """Forget the segment before: the next one is of another rest."""
    for i in range(SIGNALS):
        rest['signals'][i]['before_blocks'] = 0


@kernel
def shift_rates(rest: Rest, axis: int, shift: float, growth: float) -> None:
    """Put the rates of an axis so far, up to a full block, elsewhere by `shift` in rad/s.

    Their variance is `growth` times what it was.
    """
    signal = rest['signals'][axis]
    signal['segment']['first'] += shift
    signal['segment']['last'] += shift
    signal['late_first'] += shift
    signal['waiting_mean'] += shift
    signal['before'] += shift
    signal['variance'] *= growth
    signal['scatter'] *= growth
