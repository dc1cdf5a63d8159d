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

"""Drivers that poll faster than the sensor measures: repeats are told from samples, and counted."""

import numpy as np
import pytest

from benchmark.scenarios import stamps
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.simulation.bag import imu_messages
from support.sensor import fast_turn

RATE = 100.0  # Hz, of the sensor
N = 3000  # its samples


def measured(random):
    """Return the rates (n, 3) and accelerations of 8 s of rest, fast motion, and rest again."""
    truth = np.concatenate([np.zeros((800, 3)), fast_turn(1400, RATE), np.zeros((800, 3))])
    rates = truth + [0.02, -0.01, 0.03] + 0.005 * random.standard_normal(truth.shape)
    accelerations = [0.0, 0.0, 9.81] + 0.02 * random.standard_normal(truth.shape)
    return rates, accelerations


def polled(values, ratio):
    """Return what a driver sends that reads each of (n, 3) values `ratio` times on the mean."""
    return values[(np.arange(int(len(values) * ratio)) / ratio).astype(int)]


def run(rates, accelerations, rate, filter_=None):
    filter_ = Filter(Parameters()) if filter_ is None else filter_
    return filter_, filter_.run(stamps(len(rates), rate), rates, accelerations)


@pytest.mark.parametrize('accelerometer', ['polled', 'faster', 'none'])
@pytest.mark.parametrize('ratio', [3.0, 3.24, 10.0])
def test_a_sensor_that_is_polled_faster_is_filtered_as_by_itself(ratio, accelerometer, random):
    rates, accelerations = measured(random)
    if accelerometer == 'none':
        accelerations = np.full(rates.shape, np.nan)
    _, alone = run(rates, accelerations, RATE)
    given = polled(accelerations, ratio)
    if accelerometer == 'faster':
        given = given + 0.02 * random.standard_normal(given.shape)
    filter_, results = run(polled(rates, ratio), given, ratio * RATE)
    latest = (np.arange(len(results)) / ratio).astype(int)
    # The first rest ends when it does, so that the biases are not the same to the last bit.
    error = np.abs(results['angular_velocity'] - alone['angular_velocity'][latest])
    assert error[int(300 * ratio) :].max() < 0.03
    assert np.sqrt((error[int(300 * ratio) :] ** 2).mean()) < 0.003
    assert np.abs(results['bias'][-1] - alone['bias'][-1]).max() < 5e-4
    state = filter_.state
    assert state['clock']['mean_period'] == pytest.approx(1.0 / RATE, rel=0.002)
    assert 1.0 / state['polling']['samples_per_message'] == pytest.approx(ratio, rel=0.05)
    share = state['polling']['not_measured'] / len(results)
    assert share == pytest.approx(1.0 - 1.0 / ratio, abs=0.02)


@pytest.mark.parametrize('method', ['kalman', 'sage_husa', 'adaptive'])
def test_the_start_of_a_sensor_that_is_polled_faster_is_quiet(method, random):
    """Before the pace is known, and after it."""
    rates, accelerations = measured(random)
    filter_ = Filter(Parameters(method=method))
    rates = rates[:400]
    _, results = run(polled(rates, 10), polled(accelerations[:400], 10), 10 * RATE, filter_)
    assert np.abs(results['angular_velocity']).max() < 2.0 * np.abs(rates).max()


@pytest.mark.parametrize('rate', [100.0, 400.0])
def test_repeats_are_counted_and_only_they(rate, random):
    """A driver that polls a sensor of half its rate: every other sample."""
    n = 8000
    values = 0.006 * random.standard_normal((n // 2, 3))
    accelerations = 9.8 + 0.02 * random.standard_normal((n, 3))
    filter_, _ = run(np.repeat(values, 2, axis=0), accelerations, rate)
    assert 0.9 < filter_.state['polling']['not_measured'] / (n // 2) <= 1.0
    filter_, _ = run(0.006 * random.standard_normal((n, 3)), accelerations, rate)
    assert filter_.state['polling']['not_measured'] == 0


@pytest.mark.parametrize('count', [0.01, 0.02])
def test_a_coarse_gyroscope_at_rest_is_not_taken_for_one_that_is_polled(count, random):
    """Its rates stay the same for long, with next to all of its noise below a count."""
    rates, accelerations = measured(random)
    coarse = np.round(rates / count) * count
    filter_, results = run(coarse, accelerations, RATE)
    assert filter_.state['polling']['samples_per_message'] == 1.0
    assert filter_.state['clock']['mean_period'] == pytest.approx(1.0 / RATE, rel=0.002)
    assert results['at_rest'][300:800].mean() > 0.8
    assert results['at_rest'][-300:].mean() > 0.8


def coarse_beside_a_fast_accelerometer(random):
    """Return filter and results of a coarse gyroscope that is polled, in `measured`."""
    rates, accelerations = measured(random)
    coarse = np.round(rates / 0.005) * 0.005
    given = polled(accelerations, 4) + 0.02 * random.standard_normal((4 * N, 3))
    return run(polled(coarse, 4), given, 4 * RATE)


def test_a_coarse_gyroscope_that_is_polled_beside_a_fast_accelerometer_finds_its_rest(random):
    """Nobody knows at rest which of its rates were measured."""
    _, results = coarse_beside_a_fast_accelerometer(random)
    assert results['at_rest'][:3200].mean() > 0.6
    assert results['at_rest'][-1]


def test_the_rest_behind_the_motion_that_shows_the_polling_is_found_at_once(random):
    """From then on a value is a mean of fewer samples, whose noise is another one."""
    for _ in range(4):
        filter_, results = coarse_beside_a_fast_accelerometer(random)
        assert filter_.state['polling']['faster']
        assert results['at_rest'][8800 + 1400 :].all()


def test_a_bus_that_hangs_is_no_driver_that_polls(random):
    rates, accelerations = measured(random)
    for k in range(100, N - 100, 97):
        rates[k : k + 4], accelerations[k : k + 4] = rates[k], accelerations[k]
    rates[2000:2090], accelerations[2000:2090] = rates[2000], accelerations[2000]
    filter_, _ = run(rates, accelerations, RATE)
    assert filter_.state['polling']['samples_per_message'] == 1.0


def test_a_gyroscope_that_hangs_has_changed_no_less_than_never(random):
    """Beside a live accelerometer its changes are counted anew, after the longest run."""
    rates, accelerations = measured(random)
    rates, accelerations = polled(rates[:300], 10), polled(accelerations[:300], 10)
    rates[1500:1600] = rates[1500]
    accelerations[1500:1600] += 0.02 * random.standard_normal((100, 3))
    filter_ = Filter(Parameters())
    for k in range(1500, 1620):
        start = 0 if k == 1500 else k - 1
        filter_.run(stamps(k, RATE)[start:], rates[start:k], accelerations[start:k])
        stays = filter_.state['checks']['rates']
        assert stays['same'] + stays['first'] <= k, k
        assert (stays['stayed'] >= stays['same']).all()


def test_a_driver_that_no_longer_polls_is_followed(random):
    rates, accelerations = measured(random)
    filter_ = Filter(Parameters())
    fast = [polled(values[:800], 5) for values in (rates, accelerations)]
    times = stamps(4000, 5 * RATE)
    filter_.run(times, *fast)
    assert filter_.state['polling']['faster']
    slow = times[-1] + stamps(N - 800, RATE) - stamps(1, RATE)[0] + int(1e9 / RATE)
    results = filter_.run(slow, rates[800:], accelerations[800:])
    state = filter_.state
    assert not state['polling']['faster']
    assert state['clock']['mean_period'] == pytest.approx(1.0 / RATE, rel=0.002)
    bias = results['bias'][-1]
    # The motion begins suddenly.
    assert np.abs(results['angular_velocity'] + bias - rates[800:])[5:1400].max() < 0.1


def test_a_sensor_that_is_polled_is_stuck_after_a_second_not_before(random):
    rates, accelerations = measured(random)
    given = [polled(values[:800], 10) for values in (rates, accelerations)]
    held = [np.concatenate([values, np.repeat(values[-1:], 3000, axis=0)]) for values in given]
    filter_ = Filter(Parameters())
    times = stamps(11_000, 10 * RATE)
    filter_.run(times[:8900], held[0][:8900], held[1][:8900])
    assert not filter_.state['checks']['stuck']
    filter_.run(times[8900:9200], held[0][8900:9200], held[1][8900:9200])
    assert filter_.state['checks']['stuck']


@pytest.mark.parametrize('stamped', [True, False])
def test_the_rate_of_the_gyroscope_holds_where_it_is_given(stamped, random):
    rates, accelerations = measured(random)
    filter_ = Filter(Parameters(sample_rate=RATE))
    times = stamps(1000, 10 * RATE) * stamped
    for k in range(0, 1000, 50):
        some = slice(k, k + 50)
        filter_.run(times[some], polled(rates, 10)[some], polled(accelerations, 10)[some])
        if k >= 200:  # ten changes, and eight measurements behind them
            assert filter_.state['polling']['faster']
            assert filter_.state['clock']['period'] == pytest.approx(1.0 / RATE, rel=0.11)


def test_motion_that_nobody_can_predict_is_bridged_by_the_last_rate(random):
    """A body that is shaken as fast as its sensor measures, polled at nearly twice that rate."""
    shaken = 2.0 * random.standard_normal((N, 3))
    shaken[:800] = 0.005 * random.standard_normal((800, 3))
    accelerations = [0.0, 0.0, 9.81] + 0.02 * random.standard_normal((N, 3))
    given = polled(shaken, 1.8)
    _, results = run(given, polled(accelerations, 1.8), 1.8 * RATE)
    moving = slice(int(900 * 1.8), None)
    error = np.abs(results['angular_velocity'] - given)[moving]
    assert np.sqrt((error**2).mean()) < 0.5
    assert error.max() < 6.0


def test_the_rate_of_messages_is_told_beside_that_of_the_sensor(random):
    rates, accelerations = measured(random)
    filter_ = MessageFilter(Parameters())
    given = polled(rates, 5), polled(accelerations, 5)
    for _, message in imu_messages(stamps(5 * N, 5 * RATE), *given):
        filter_.take(message)
    telemetry = filter_.report().telemetry
    assert telemetry.period == pytest.approx(1.0 / RATE, rel=0.002)
    assert telemetry.samples_per_message == pytest.approx(0.2, rel=0.02)
