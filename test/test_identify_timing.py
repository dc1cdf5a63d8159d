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

"""What the stamps say."""

import numpy as np
import pytest

from benchmark import drivers
from gyro_drift_filter.fleet.noise import identify_noise
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.series import columns
from gyro_drift_filter.identify.timing import learn_timing, learn_timings

PERIOD_NS = 10_000_000


def even(n):
    return 10**18 + PERIOD_NS * np.arange(n)


def test_even_stamps():
    timing = learn_timing(even(1000))
    assert timing.period == pytest.approx(0.01)
    assert len(timing.breaks) == 0
    assert timing.uneven == 0.0


@pytest.mark.parametrize('size', [3, 45])
def test_bursts_are_seen_and_cut_nothing(size):
    stamps = even(6000)
    stamps = stamps[np.minimum(np.arange(6000) // size * size + size - 1, 5999)]
    timing = learn_timing(stamps)
    assert timing.period == pytest.approx(0.01, rel=0.02)
    assert len(timing.breaks) == 0
    assert timing.uneven > 0.9


def test_gaps_and_jumps_back_cut_and_leave_the_period_alone():
    stamps = even(6000)
    stamps[1000:] += 700_000_000
    stamps[3000:] -= 20_000_000_000
    timing = learn_timing(stamps)
    assert timing.breaks.tolist() == [1000, 3000]
    assert timing.period == pytest.approx(0.01, rel=1e-3)
    assert timing.uneven == 0.0


def test_time_goes_on_where_stamps_jump_back():
    """Rests behind a clock that was set were at -6959 s, and those of loops at the same time."""
    stamps = even(6000)
    stamps[1000:] += 700_000_000
    stamps[3000:] -= 20_000_000_000
    timing = learn_timing(stamps)
    times = [timing.seconds_at(stamps, k) for k in (0, 999, 1000, 2999, 3000, 5999)]
    assert times == pytest.approx([0.0, 9.99, 10.7, 30.69, 30.7, 60.69])


@pytest.mark.parametrize('before', [10**10, 9 * 10**17])
def test_time_goes_on_where_stamps_jump_and_log_times_do_not(before):
    """Rests behind a clock that was set at boot, 1970 to today, were at 1790000231 s."""
    log_times = even(6000)
    log_times[1000:] += 700_000_000
    stamps = log_times.copy()
    stamps[:3000] += before - stamps[0]
    timing = learn_timing(stamps, log_times)
    assert timing.breaks.tolist() == [1000, 3000]
    times = [timing.seconds_at(stamps, k) for k in (0, 999, 1000, 2999, 3000, 5999)]
    assert times == pytest.approx([0.0, 9.99, 10.7, 30.69, 30.7, 60.69], abs=1e-5)


@pytest.mark.parametrize('begin', [0, 315_964_800, 946_684_800], ids=['1970', 'GPS', '2000'])
def test_time_goes_on_where_a_recorder_has_the_clock_that_is_set_at_boot(begin):
    stamps = even(6000) + 7 * 10**17  # in 2023
    stamps[:3000] -= stamps[0] - begin * 10**9
    timing = learn_timing(stamps, stamps + 1_000_000)
    times = [timing.seconds_at(stamps, k) for k in (0, 2999, 3000, 5999)]
    assert times == pytest.approx([0.0, 29.99, 30.0, 59.99], abs=1e-5)


@pytest.mark.parametrize('late', [2_000_000_000, 10**18], ids=['late', 'without a stamp'])
def test_time_goes_on_behind_a_message_that_is_late(late):
    """It seemed to be set back, and what came next to be missing, so all later times were wrong."""
    log_times = even(6000)
    stamps = log_times.copy()
    stamps[3000] -= late
    timing = learn_timing(stamps, log_times)
    times = [timing.seconds_at(stamps, k) for k in (2999, 3000, 3001, 5999)]
    assert times == pytest.approx([29.99, 30.0, 30.01, 59.99], abs=1e-5)


@pytest.mark.slow
def test_the_trend_of_a_bias_is_that_of_the_time_that_goes_on(random):
    stamps = even(30_000)
    rates = 1e-3 * random.standard_normal((30_000, 3)) + 2e-5 * np.arange(30_000)[:, None] / 100
    forces = np.array([0.0, 0.0, 9.8]) + 0.02 * random.standard_normal((30_000, 3))
    looped = even(10_000)[np.arange(30_000) % 10_000]
    found = [identify_noise(s, columns(rates), columns(forces)) for s in (stamps, looped)]
    for axes in zip(*found, strict=True):
        plain, again = (axis.trend for axis in axes)
        assert plain == pytest.approx(2e-5, rel=0.05)
        assert again == pytest.approx(plain, rel=0.05)


def delivered(rates, random, jitter=0.0):
    """Return stamps of a sensor that has each of some rates in Hz for 30 s."""
    steps = np.concatenate([[0.0], *(np.full(30 * rate, 1.0 / rate) for rate in rates)])
    seconds = np.cumsum(steps) + jitter * steps * random.normal(size=len(steps))
    return 10**18 + np.sort((1e9 * seconds).astype(np.int64))


@pytest.mark.parametrize('jitter', [0.0, 0.1])
@pytest.mark.parametrize('rates', [(100, 50), (100, 25, 100), (50, 60, 50), (25, 200)])
def test_each_rate_of_a_sensor_has_its_timing(rates, jitter, random):
    stamps = delivered(rates, random, jitter)
    timings = learn_timings(stamps)
    found = sorted(1.0 / timing.period for timing in timings)
    np.testing.assert_allclose(found, sorted(set(rates)), rtol=0.01)
    borders = [stretch.first for stretch in timings[0].stretches]
    expected = np.cumsum([0, *(30 * rate for rate in rates[:-1])])
    np.testing.assert_allclose(borders, expected, atol=0 if jitter == 0.0 else 5)
    assert all(timing.uneven < 0.01 and not len(timing.breaks) for timing in timings)
    said = f'the sensor changed its rate from {rates[0]} to {rates[1]} Hz at 30.0 s'
    assert jitter or timings[0].rate_changes(stamps).startswith(said)


def test_where_the_rate_changes_across_a_pause_and_a_setting_of_the_clock(random):
    stamps = delivered((100, 50), random)
    stamps[3001:] += 20_000_000_000
    # Which the log does not know: there the time goes on by one period.
    stamps[4000:] -= 7_000_000_000
    slow = learn_timings(stamps)[-1]
    assert [stretch.first for stretch in slow.stretches] == [0, 3000]
    assert slow.breaks.tolist() == [3001, 4000]
    assert slow.seconds_of(stamps, 3001, 4501) == pytest.approx(29.98)


def unchanged(kind, rate, random):
    """Return stamps over two minutes, the second of which is not as even as the first."""
    n = 120 * rate
    stamps = 10**18 + np.arange(n) * (10**9 // rate)
    late, half = np.arange(n) >= n // 2, n // 2
    name, _, amount = kind.partition(' ')
    if name == 'jitter':
        return np.sort(
            stamps + (late * random.normal(size=n) * float(amount) * 1e9 / rate).astype(int)
        )
    if name == 'losses':
        return stamps[~late | (random.random(n) > float(amount))]
    if name == 'bursts':
        last = np.arange(n) // int(amount) * int(amount) + int(amount) - 1
        return stamps[np.where(late, np.minimum(last, n - 1), np.arange(n))]
    if name == 'coarse':
        return np.where(late, stamps // int(amount) * int(amount), stamps)
    for k in random.integers(half, n, 20):
        stamps[k:] += int(2e9 * random.exponential())
    return stamps


@pytest.mark.parametrize('rate', [10, 50, 200])
@pytest.mark.parametrize(
    'kind',
    [
        *('jitter 0.1', 'jitter 0.5', 'jitter 1'),
        *('losses 0.05', 'losses 0.1', 'losses 0.2', 'losses 0.5', 'losses 0.8'),
        *('bursts 2', 'bursts 5', 'coarse 4000000', 'gaps'),
    ],
)
def test_what_makes_stamps_uneven_is_no_other_rate(kind, rate, random):
    assert len(learn_timings(unchanged(kind, rate, random))) == 1


@pytest.mark.slow
@pytest.mark.parametrize('world', sorted(drivers.WORLDS))
def test_no_driver_changes_its_rate(world, random):
    assert len(learn_timings(drivers.WORLDS[world](1.0, random).stamps)) == 1


def test_a_slow_sensor_has_no_gaps():
    timing = learn_timing(10**18 + 10**9 * np.arange(100))
    assert timing.period == pytest.approx(1.0)
    assert len(timing.breaks) == 0


@pytest.mark.parametrize('stamps', [np.zeros(0, np.int64), even(1), np.full(100, 10**18)])
def test_stamps_that_do_not_advance_are_an_error(stamps):
    with pytest.raises(IdentificationError, match='do not advance'):
        learn_timing(stamps)


def test_of_one_message_no_driver_is_blamed():
    with pytest.raises(IdentificationError, match='one message only: record for longer') as error:
        learn_timing(even(1))
    assert 'driver' not in str(error.value)


def test_stamps_that_go_back_are_told():
    """A sample rate, which was asked for, does not help where there are stamps."""
    with pytest.raises(IdentificationError, match='go back: record again with a driver') as error:
        learn_timing(even(1000)[::-1].copy())
    assert '--sample-rate' not in str(error.value)


def test_a_real_bursty_recording(real):
    timing = learn_timing(real('static_mpu6050_bursty')[0])
    assert 1.0 / timing.period == pytest.approx(99.3, abs=0.5)
    assert len(timing.breaks) == 0
    assert timing.uneven > 0.3
