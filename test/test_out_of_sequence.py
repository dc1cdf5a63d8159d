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

"""Messages that come after later ones: filtered as if they had come in order."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.records import KEPT_SAMPLES
from gyro_drift_filter.core.sample import SampleStatus
from support.messages import START
from support.sensor import DEGREE, NOISE, at_rest, by_hand, fast_turn

BIAS = np.array([0.5, -0.4, 0.3]) * DEGREE


def drive(random, seconds, rate=100.0, jitter=0.0):
    """Return stamps (n,), rates and accelerations (n, 3) of rests and fast motions by turns."""
    rates, accelerations = at_rest(random, seconds, BIAS, rate)
    time = np.arange(len(rates)) / rate
    for first in np.arange(8.0, seconds - 4.0, 12.0):
        part = (time >= first) & (time < first + 4.0)
        window = np.sin(np.pi * (time[part] - first) / 4.0)[:, None]
        rates[part] += window * fast_turn(part.sum(), rate)
        accelerations[part] += window * by_hand(random, 4.0, rate)[1][: part.sum()]
    off = random.uniform(-jitter, jitter, len(time))
    stamps = START + np.round((np.arange(len(time)) + off) * 1e9 / rate).astype(np.int64)
    return stamps, rates, accelerations


def swapped(n, share, random):
    """Return an order of n messages in which a share of the pairs is swapped."""
    order = np.arange(n)
    for k in range(2, n - 1, 2):  # there is nothing to go back to before the first one
        if random.random() < share:
            order[k], order[k + 1] = k + 1, k
    return order


def delayed(n, delays):
    """Return an order of n messages in which some come later, by as many as `delays` says."""
    order, place = [], 0
    for distance, delay in delays:
        late = place + distance
        if late + delay >= n:
            break
        order += [*range(place, late), *range(late + 1, late + delay + 1), late]
        place = late + delay + 1
    return np.array([*order, *range(place, n)])


def run_in(order, data, parameters=None):
    """Return a filter that messages came to in an order, and the results by their stamps."""
    filter_: Any = Filter(parameters)
    results = filter_.run(*(array[order] for array in data))
    in_order = np.empty_like(results)
    in_order[order] = results
    return filter_, in_order


def state_without_counts(filter_):
    """Return all of the state but for the stamps that went backward."""
    clock = filter_.state['clock']
    kept = {name: int(clock[name]) for name in ('backward_stamps', 'overtaken')}
    for name in kept:
        clock[name] = 0
    state = filter_.record['state'].tobytes()
    for name, count in kept.items():
        clock[name] = count
    return state


@pytest.mark.slow
@pytest.mark.parametrize('method', METHOD_NAMES)
@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**32),
    delays=st.lists(st.tuples(st.integers(0, 60), st.integers(1, KEPT_SAMPLES // 2)), max_size=60),
    lost=st.lists(st.integers(10, 1990), max_size=40),
    jitter=st.floats(0.0, 0.09),
    rate=st.sampled_from([50.0, 100.0, 200.0, 400.0]),
)
def test_the_state_is_that_of_messages_in_order(method, seed, delays, lost, jitter, rate):
    """To the last bit; so are all results but those of messages that came before their time.

    Where messages are lost as well, a second gap must not come before the first one is filled.
    """
    random = np.random.default_rng(seed)
    if lost:
        delays = [(distance, 1) for distance, _ in delays]
    data = [np.delete(array, lost, 0) for array in drive(random, 2000 / rate, rate, jitter)]
    n, parameters = len(data[0]), Parameters(method=method)
    order = delayed(n, [(5, 1), *delays])
    expected, in_order = run_in(np.arange(n), data, parameters)
    filter_, results = run_in(order, data, parameters)
    # A result behind an overtaken message would stand in for that of the last one.
    again = filter_.step(data[0][-1], data[1][-1], data[2][-1])
    expected.step(data[0][-1], data[1][-1], data[2][-1])
    assert again['status'] == SampleStatus.REPEATED
    assert state_without_counts(filter_) == state_without_counts(expected)
    early = np.maximum.accumulate(order) > order
    came_early = np.zeros(n, bool)
    for k in np.flatnonzero(early):
        came_early[[other for other in order[:k] if other > order[k]]] = True
    assert results[~came_early].tobytes() == in_order[~came_early].tobytes()
    assert filter_.state['clock']['overtaken'] == early.sum() > 0


@pytest.mark.slow
@pytest.mark.parametrize('rate', [50.0, 100.0, 200.0, 400.0])
@pytest.mark.parametrize('share', [0.01, 0.05, 0.2])
@pytest.mark.parametrize(('jitter', 'lost'), [(0.0, 0.0), (0.4, 0.0), (0.1, 0.02)])
def test_swapped_messages_cost_nothing(rate, share, jitter, lost, random):
    """Neither noise at rest nor motion, nor the angle, nor what is learned of rest and clock."""
    data = drive(random, 40.0, rate, jitter)
    keep = random.random(len(data[0])) >= lost
    data = [array[keep] for array in data]
    n = len(data[0])
    expected, in_order = run_in(np.arange(n), data)
    filter_, results = run_in(swapped(n, share, random), data)
    resting = in_order['at_rest'] > 0.0
    assert np.argmax(results['at_rest']) == pytest.approx(np.argmax(in_order['at_rest']), abs=2)
    truth = np.where(resting[:, None], 0.0, data[1] - BIAS)
    error, usual = (r['angular_velocity'] - truth for r in (results, in_order))
    for part in (resting, ~resting):
        assert np.sqrt(np.mean(error[part] ** 2)) < 1.1 * np.sqrt(np.mean(usual[part] ** 2))
    assert np.abs((error - usual).sum(axis=0) / rate).max() < 0.1 * DEGREE
    noise, expected_noise = (f.state['result']['measurement_noise'] for f in (filter_, expected))
    assert noise == pytest.approx(expected_noise, rel=0.05)
    assert filter_.state['clock']['mean_period'] * rate == pytest.approx(1.0, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize('rate', [100.0, 200.0, 400.0])
def test_stamps_that_scatter_do_not_order_messages(rate, random):
    """They are off by a part of a period each, and go backward; messages come in order."""
    stamps, rates, accelerations = drive(random, 60.0, rate)
    off = np.round(0.4e9 / rate * random.standard_normal(len(stamps))).astype(np.int64)
    filter_: Any = Filter()
    results = filter_.run(stamps + off, rates, accelerations)
    clock = filter_.state['clock']
    assert clock['backward_stamps'] > 0.02 * len(stamps)
    assert clock['overtaken'] < 0.1 * clock['backward_stamps']
    usual = Filter().run(stamps, rates, accelerations)
    moving = usual['at_rest'] == 0.0
    difference = (results['angular_velocity'] - usual['angular_velocity'])[moving]
    assert np.sqrt(np.mean(difference**2)) < NOISE


def test_a_clock_that_is_set_back_into_a_gap_costs_one_sample(random):
    """As if a message had been overtaken; from the next one on it is a clock like any other."""
    stamps, rates, accelerations = drive(random, 20.0)
    stamps[1000:] += 20_000_000  # two are lost,
    stamps[1001:] -= 20_000_000  # and the clock is set back behind the sample after them
    filter_: Any = Filter()
    results = filter_.run(stamps, rates, accelerations)
    usual = Filter().run(*drive(np.random.default_rng(0), 20.0))
    assert np.isfinite(results['angular_velocity']).all()
    assert filter_.state['clock']['overtaken'] == 1
    error = results['angular_velocity'][1002:] - (rates - BIAS)[1002:]
    assert np.abs(error).max() < 8.0 * np.sqrt(usual['measurement_noise'][-1].max())


@pytest.mark.parametrize('others', [KEPT_SAMPLES - 1, KEPT_SAMPLES, KEPT_SAMPLES + 2])
def test_what_comes_too_late_is_the_next_sample(others, random):
    """As many messages have come since as are kept, so that it has no place any more."""
    stamps, rates, accelerations = drive(random, 12.0)
    order = delayed(len(stamps), [(500, others)])
    filter_, _ = run_in(order, (stamps, rates, accelerations))
    assert filter_.state['clock']['backward_stamps'] == 1
    assert filter_.state['clock']['overtaken'] == (others < KEPT_SAMPLES)


@pytest.mark.parametrize(
    'command',
    [
        lambda filter_: filter_.set_bias((0.2, 0.0, 0.0), (1e-4, 1e-4, 1e-4)),
        lambda filter_: filter_.calibrate(),
        lambda filter_: filter_.configure(Parameters(bias_initial=(0.1, 0.0, 0.0))),
        lambda filter_: filter_.reset(),
        lambda filter_: filter_.hint(True),
        lambda filter_: filter_.hint(False),
        lambda filter_: [filter_.note_temperature(deg_c) for deg_c in (20.0, 50.0)],
    ],
)
def test_an_overtaken_message_takes_no_command_back(command, random):
    """Hints and temperatures hold on; behind anything else the filter does not go back."""
    stamps, rates, accelerations = (array.copy() for array in drive(random, 7.0))
    order = delayed(len(stamps), [(len(stamps) - 3, 1)])
    data = [array[order] for array in (stamps, rates, accelerations)]
    late = len(stamps) - 2
    filter_: Any = Filter()
    filter_.run(*(array[:late] for array in data))
    command(filter_)
    bias = filter_.state['bias']
    told = bias['bias'].copy(), bias['hint'].item(), filter_.state['counts']['samples'].item()
    process_noise = bias['process_noise'].item()
    filter_.step(*(array[late] for array in data))
    assert bias['bias'] == pytest.approx(told[0], rel=1e-6)
    assert bias['hint'] == told[1]
    assert bias['process_noise'] >= 0.99 * process_noise
    assert filter_.state['counts']['samples'] == told[2] + 1


@pytest.mark.parametrize('method', [name for name in METHOD_NAMES if name != 'adaptive'])
def test_another_method_takes_over_from_the_last_sample(method, random):
    """Not from the message that has just come late: it has no result, as one axis is not ready."""
    data, end = drive(random, 8.0), 700
    data[1][: end - 2, 2] = np.nan
    order = delayed(end, [(end - 3, 2)])
    assert list(order[-3:]) == [end - 2, end - 1, end - 3]
    in_order, overtaken = (Filter(Parameters(method=method)) for _ in range(2))
    for filter_, places in (in_order, np.arange(end)), (overtaken, order):
        filter_.run(*(array[places] for array in data))
        filter_.configure(Parameters(method='adaptive'))
    following = [array[end : end + 100] for array in data]
    assert overtaken.run(*following).tobytes() == in_order.run(*following).tobytes()


@pytest.mark.slow
def test_a_snapshot_knows_what_was_overtaken(random):
    """A filter that is restored between a gap and what fills it goes back as well."""
    data = drive(random, 12.0)
    order = swapped(len(data[0]), 0.2, random)
    _, expected = run_in(order, data)
    filter_: Any = Filter()
    results = []
    for k in order:
        results.append(filter_.step(*(array[k] for array in data)).tobytes())
        snapshot, filter_ = filter_.snapshot(), Filter()
        filter_.restore(snapshot)
    assert b''.join(results) == expected[order].tobytes()
