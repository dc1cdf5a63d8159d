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

"""Drivers and sensors as they are: what they do to rates and stamps does no harm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from benchmark.drivers import WORLDS, lag, misses, score
from benchmark.scenarios import stamps
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.methods.reasons import Reason
from gyro_drift_filter.rotations import (
    from_vectors,
    inverse,
    multiply,
    running_products,
    to_vectors,
)
from support.paths import MOTION, recorded
from support.sensor import DEGREE, fast_turn, motion_below


@pytest.mark.slow
@pytest.mark.parametrize('world', list(WORLDS))
def test_every_world_of_drivers_holds_its_bars(world):
    assert misses(world, score(world, seed=7)) == []


def upright(random, n, deviation=0.02):
    return np.array([0.0, 0.0, 9.81]) + deviation * random.standard_normal((n, 3))


@pytest.mark.parametrize(
    ('rate', 'share'), [(100.0, 0.45), (100.0, 0.2), (10.0, 0.15), (10.0, 1.0)]
)
def test_the_rest_of_a_sensor_with_its_own_low_pass_is_found(rate, share, random):
    bias = np.radians([1.0, -2.0, 3.0])
    n = int(120 * rate)
    z = bias + lag(0.006 * random.standard_normal((n, 3)), share)
    results = Filter(Parameters()).run(stamps(n, rate), z, upright(random, n))
    assert results['at_rest'][n // 2 :].mean() > 0.6
    assert np.abs(results['bias'][-1] - bias).max() < np.radians(0.15)


@pytest.mark.parametrize(
    ('rate', 'hertz', 'steps'),
    [(100.0, 5.0, 2.0), (200.0, 10.0, 1.0), (400.0, 20.0, 2.0), (1000.0, 20.0, 6.0)],
)
def test_slow_noise_that_repeats_its_values_is_smoothed(rate, hertz, steps, random):
    """The steps of the sensor are coarse for noise that a low-pass has slowed down.

    A value that came again and again was bridged as one of a bus that hangs, or taken for the rate.
    """
    n = round(40.0 * rate)
    low_pass = signal.butter(2, hertz, fs=rate, output='sos')
    noise = signal.sosfilt(low_pass, random.standard_normal((n, 3)), axis=0)
    z = 0.01 + 0.0004 / steps * np.round(noise / noise.std() * steps)
    results = Filter().run(stamps(n, rate), z, upright(random, n))[n // 2 :]
    assert results['at_rest'].all()
    assert np.isin(results['reason'], [Reason.REPEATED, Reason.CONSTANT]).mean() < 1e-3
    assert results['angular_velocity'].std() < 0.3 * z[n // 2 :].std()


@pytest.mark.parametrize(
    ('rate', 'hertz', 'most'),
    [(400.0, 40.0, 1.02), (1000.0, 100.0, 1.02), (1000.0, 40.0, 1.06), (2000.0, 100.0, 1.12)],
)
def test_noise_behind_a_low_pass_is_not_enlarged_in_motion(rate, hertz, most, random):
    """As smooth as motion it can't be told from it; predicted as motion it overshoots."""
    n = round(40.0 * rate)
    low_pass = signal.butter(2, hertz, fs=rate, output='sos')
    noise = signal.sosfilt(low_pass, 0.02 * random.standard_normal((n, 3)), axis=0)
    moves = np.arange(n) >= 10.0 * rate
    hand = (
        motion_below(4.0, random, n, rate) * np.clip(np.arange(n) / rate - 10.0, 0.0, 1.0)[:, None]
    )
    truth = 2.0 * hand / hand.std()
    results = Filter().run(stamps(n, rate), truth + noise, upright(random, n))
    error = (results['angular_velocity'] + results['bias'] - truth)[moves]
    assert np.sqrt(np.mean(error**2)) < most * noise[moves].std()


@pytest.mark.parametrize('share', [0.002, 0.01])
def test_a_read_that_fails_is_held_whatever_value_the_driver_takes_for_it(share, random):
    """A driver that does not look at the error takes its code, -1, for a count on all six axes."""
    rate, n = 100.0, 6000
    moves = np.clip(np.arange(n) / rate - 10.0, 0.0, 1.0)[:, None]
    hand = motion_below(2.0, random, n, rate) * moves
    truth = 2.0 * hand / hand.std()
    count, force_count = np.radians(1.0 / 131.0), 9.81 / 16384.0
    rates = np.round((truth + 1e-3 * random.standard_normal((n, 3))) / count) * count
    accelerations = np.round(upright(random, n) / force_count) * force_count
    failed = np.zeros(n, bool)
    for first in np.flatnonzero(random.random(n) < share):
        failed[max(first, 300) : first + random.integers(1, 4)] = True
    rates[failed], accelerations[failed] = -count, -force_count
    results = Filter().run(stamps(n, rate), rates, accelerations)
    far = failed[:, None] & (np.abs(truth - rates) > np.radians(10.0))
    assert (results['outlier'][far] > 0.0).mean() > 0.97
    error = (results['angular_velocity'] + results['bias'] - truth)[1500:]
    assert np.sqrt(np.mean(error[~failed[1500:]] ** 2)) < 1.1e-3
    assert np.sqrt(np.mean(error[failed[1500:]] ** 2)) < 0.06


@pytest.mark.parametrize('hertz', [15.0, 18.0, 23.0, 28.0, 37.0, 45.0])
def test_a_vibration_is_not_enlarged_in_motion(hertz, random):
    """A mode that would follow motion of a motor's frequency overshoots with it."""
    rate, n = 100.0, 6000
    time = np.arange(n) / rate
    vibration = np.sin(2.0 * np.pi * hertz * time)[:, None] * np.array([0.03, -0.02, 0.015])
    noise = vibration + 0.004 * random.standard_normal((n, 3))
    moves = time >= 20.0
    hand = motion_below(4.0, random, n, rate) * np.clip(time - 20.0, 0.0, 1.0)[:, None]
    truth = hand / hand.std()
    results = Filter().run(stamps(n, rate), truth + noise, upright(random, n))
    error = (results['angular_velocity'] + results['bias'] - truth)[moves]
    assert np.sqrt(np.mean(error**2)) < 1.01 * np.sqrt(np.mean(noise[moves] ** 2))


@pytest.mark.parametrize('seed', range(4))
def test_the_rest_of_a_sensor_with_less_noise_than_a_count_is_found(seed):
    """A driver that rounds to hundredths: now and then a rate is the next one, and then back."""
    random = np.random.default_rng(seed)
    bias = np.array([0.005, 0.004, -0.006])
    z = np.round(bias + 0.0007 * random.standard_normal((1500, 3)), 2)
    results = Filter(Parameters()).run(stamps(1500, 100.0), z, upright(random, 1500))
    assert np.flatnonzero(results['at_rest'])[0] < 400
    assert results['at_rest'][400:].mean() > 0.9


@pytest.mark.parametrize('frequency', [8.0, 10.0, 12.0, 37.3])
def test_a_strong_vibration_from_power_on_hides_no_rest(frequency, random):
    """Of an engine that idles. Blocks of an eighth of a second alias it, 12 Hz most of all."""
    n = 3000
    bias = np.radians([1.0, -2.0, 4.0])
    wave = np.sin(2 * np.pi * frequency * np.arange(n) / 100.0)[:, None]
    z = bias + 0.006 * random.standard_normal((n, 3)) + 0.04 * wave * [1.0, -0.7, 0.5]
    accelerations = upright(random, n) + 4.0 * wave * [0.2, 0.5, 0.3]
    results = Filter(Parameters()).run(stamps(n, 100.0), z, accelerations)
    assert np.flatnonzero(results['at_rest'])[0] < 400
    assert np.abs(results['bias'][-1] - bias).max() < np.radians(0.1)


def test_a_slow_turn_from_the_start_is_no_rest(random):
    """It swings about zero within each few seconds, as noise that is correlated does."""
    time = np.arange(6000) / 100
    z = 0.005 * random.standard_normal((6000, 3))
    z[:, 2] += np.radians(2.0) * np.sin(2 * np.pi * 0.2 * time)
    results = Filter(Parameters()).run(stamps(6000, 100.0), z, upright(random, 6000))
    assert np.abs(results['bias']).max() < np.radians(0.3)


@pytest.mark.slow
def test_a_slow_turn_from_the_start_is_rarely_a_rest_wherever_it_begins(random):
    time, found = np.arange(6000) / 100, 0
    for phase in np.linspace(0.0, 2 * np.pi, 30):
        z = 0.005 * random.standard_normal((6000, 3))
        z[:, 2] += np.radians(2.0) * np.sin(2 * np.pi * 0.2 * time + phase)
        results = Filter(Parameters()).run(stamps(6000, 100.0), z, upright(random, 6000))
        found += int(results['at_rest'].any())
    assert found <= 3


def test_noise_is_learned_at_rest_alone(random):
    """Motion up to the Nyquist frequency has third differences like noise."""
    n = 4000
    z = 0.005 * random.standard_normal((n, 3))
    z[2000:] += random.standard_normal((2000, 3))
    results = Filter(Parameters()).run(stamps(n, 50.0), z, upright(random, n))
    learned = np.sqrt(results['measurement_noise'])
    assert np.abs(learned[1900] / 0.005 - 1).max() < 0.15
    assert (learned[2000:] < 0.0065).all()


@pytest.mark.parametrize(('deviations', 'share'), [(8, 0.6), (12, 0.95), (20, 0.99)])
@pytest.mark.parametrize('noise', [0.006, 0.002])  # of an ADIS16405 and an MPU-6050
def test_small_spikes_at_rest_are_flagged_by_the_noise(noise, deviations, share, random):
    n = 30_000
    z = noise * random.standard_normal((n, 3))
    spikes = np.zeros((n, 3), bool)
    for axis in range(3):
        spikes[random.choice(np.arange(1000, n - 2), n // 500, replace=False), axis] = True
    signs = random.choice([-1.0, 1.0], (n, 3))
    results = Filter(Parameters()).run(
        stamps(n, 100.0), z + noise * deviations * signs * spikes, upright(random, n, 0.04)
    )
    flags = results['outlier'] > 0
    assert flags[spikes].mean() >= share
    assert (flags & ~spikes).any(axis=1).mean() < 3e-4
    left = np.abs(results['angular_velocity'])[spikes & flags]
    assert left.max() < noise


def test_repeated_rates_in_motion_are_bridged_and_not_flagged(random):
    truth = np.concatenate([np.zeros((800, 3)), fast_turn(2000, 100.0)])
    z = truth + 0.005 * random.standard_normal(truth.shape)
    for k in range(1000, 2700, 50):
        z[k : k + 3] = z[k - 1]
    results = Filter(Parameters()).run(stamps(len(z), 100.0), z, upright(random, len(z)))
    assert not results['outlier'][850:].any()  # the turn begins all at once
    error = np.sqrt(np.mean((results['angular_velocity'] - truth)[900:] ** 2))
    assert error < 0.5 * np.sqrt(np.mean((z - truth)[900:] ** 2))


def test_a_sensor_without_noise_is_not_bridged():
    """A simulated one, at rest and in a steady turn: each equal sample is a measurement."""
    z = np.concatenate([np.zeros((500, 3)), np.full((500, 3), 1.0), np.zeros((500, 3))])
    results = Filter(Parameters()).run(stamps(1500, 100.0), z, np.zeros_like(z))
    settled = np.r_[100:500, 800:1000, 1300:1500]
    assert np.abs(results['angular_velocity'] - z)[settled].max() < 0.01


def errors_of_missing(rates, firsts, samples, random):
    """Return how far off the filter is where rates are no numbers, and the last one: rms, rad/s."""
    count, given, held = len(rates), rates.copy(), rates.copy()
    for first in firsts:
        given[first : first + samples] = np.nan
        held[first : first + samples] = rates[first - 1]
    missing = np.isnan(given[:, 0])
    filter_ = Filter(Parameters(bias_enabled=False))
    results = filter_.run(stamps(count, 100.0), given, upright(random, count))
    return (
        np.sqrt(np.mean((of - rates)[missing] ** 2)) for of in (results['angular_velocity'], held)
    )


@pytest.mark.parametrize('band', [(8.0, 40.0), (15.0, 30.0)])
@pytest.mark.parametrize('samples', [2, 5, 10])
def test_rates_that_are_missing_in_a_vibration_are_not_extrapolated(band, samples, random):
    """It turns back within some samples: they were up to 4 times as far off as held ones."""
    count = 12_000
    section = signal.butter(2, band, 'band', fs=100.0, output='sos')
    rates = 3.0 * DEGREE * signal.sosfilt(section, random.standard_normal((count, 3)), axis=0)
    rates += fast_turn(count, 100.0) * 0.02 + 1e-3 * random.standard_normal((count, 3))
    off, held = errors_of_missing(rates, range(4000, count - 100, 250), samples, random)
    assert off < 1.2 * held


def test_rates_that_are_missing_in_smooth_motion_are_extrapolated(random):
    count = 6000
    rates = fast_turn(count, 100.0) + 1e-3 * random.standard_normal((count, 3))
    off, held = errors_of_missing(rates, range(1000, count - 100, 250), 5, random)
    assert off < 0.3 * held


def test_what_follows_a_gap_in_fast_motion_is_no_outlier(random):
    truth = np.concatenate([np.zeros((800, 3)), 2.0 * fast_turn(2000, 100.0)])
    z = truth + 0.005 * random.standard_normal(truth.shape)
    kept = np.ones(len(z), bool)
    for k in range(1000, 2700, 170):
        kept[k : k + 21] = False
    times = stamps(len(z), 100.0)
    results = Filter(Parameters()).run(times[kept], z[kept], upright(random, len(z))[kept])
    assert not results['outlier'][850:].any()
    assert np.abs(results['angular_velocity'] - z[kept])[900:].max() < 0.1


@pytest.mark.parametrize('seed', range(4))
def test_the_second_sample_behind_a_gap_is_no_outlier(seed):
    """Two are missing just before the peak of a twist, which the first one behind them hides."""
    random, n = np.random.default_rng(seed), 9000
    seconds = np.arange(n) / 100.0
    truth = 0.4 * np.sin(2 * np.pi * 0.3 * seconds[:, None] + np.arange(3))
    truth[:800] = 0.0
    kept = np.ones(n, bool)
    for k in range(1500, n - 50, 60):
        width, peak = random.uniform(0.02, 0.05), seconds[k] + random.uniform(-5e-3, 5e-3)
        size = random.choice([-1, 1]) * random.uniform(3.0, 8.0)
        truth[:, 0] += size * np.exp(-(((seconds - peak) / width) ** 2))
        kept[k - 3 : k - 1] = False
    z = truth + 0.005 * random.standard_normal((n, 3))
    times = stamps(n, 100.0)
    results = Filter(Parameters()).run(times[kept], z[kept], upright(random, n)[kept])
    assert not results['outlier'][1000:].any()


@pytest.mark.parametrize('how', ['lost', 'NaN', 'two lost'])
def test_a_spike_at_rest_behind_a_missing_sample_is_held(how, random):
    """A body that stood still has hardly got anywhere while nothing was measured."""
    n, gap, spike = 1000, 800, 801
    z, kept = 0.004 * random.standard_normal((n, 3)), np.ones(n, bool)
    if how == 'NaN':
        z[gap] = np.nan
    else:
        kept[gap - (how == 'two lost') : spike] = False
    z[spike, 0] += 3.0
    results = Filter().run(stamps(n, 100.0)[kept], z[kept], upright(random, n)[kept])
    at = np.flatnonzero(kept) == spike
    assert results['outlier'][at].tolist() == [[1.0, 0.0, 0.0]]
    assert np.abs(results['angular_velocity'][600:]).max() < 0.01


@pytest.mark.parametrize('gap', [1, 3, 10, 30])
def test_a_motion_that_begins_in_a_gap_at_rest_is_followed(gap, random):
    """At most two samples are held, and what they turned is given back."""
    n, begin, rate = 1200, 1000, 100.0
    seconds = np.arange(n) / rate - begin / rate
    truth = np.zeros((n, 3))
    truth[:, 0] = np.where(seconds > 0.0, 5.0 * np.sin(2 * np.pi * 2.0 * seconds), 0.0)
    z = truth + 0.004 * random.standard_normal((n, 3))
    for first in range(begin - gap + 1, begin + 2):
        kept = np.ones(n, bool)
        kept[first : first + gap] = False
        results = Filter().run(stamps(n, rate)[kept], z[kept], upright(random, n)[kept])
        assert results['outlier'][first:, 0].sum() <= 2
        error = (results['angular_velocity'] - truth[kept])[first - 1 :, 0].sum() / rate
        assert abs(error) < np.radians(0.25)


@pytest.mark.parametrize(
    ('lost', 'periods', 'most', 'ratio'),
    [
        (0.0, 0.3, 0.0, 1.05),
        (0.02, 0.3, 0.0, 1.05),
        (0.05, 0.3, 0.0, 1.05),
        (0.1, 0.3, 0.0, 1.05),
        (0.2, 0.3, 0.0, 1.1),
        (0.05, 0.6, 0.004, 1.05),
        (0.05, 1.0, 0.004, 1.05),
    ],
)
@pytest.mark.parametrize('hertz', [4.0, 6.0])
def test_losses_that_delays_hide_are_few_outliers_in_fast_motion(
    hertz, lost, periods, most, ratio, random
):
    """Stamps of arrival, late by a part of the period: the clock counts many losses later."""
    n = 12_000
    hand = motion_below(hertz, random, n, 100.0)
    truth = 6.0 * hand / hand.std()
    z = truth + 0.005 * random.standard_normal((n, 3))
    late = (1e7 * periods * random.exponential(size=n)).astype(np.int64)
    times = np.maximum.accumulate(stamps(n, 100.0) + late)
    kept = random.random(n) >= lost
    results = Filter(Parameters()).run(times[kept], z[kept], upright(random, n)[kept])
    assert results['outlier'][1500:].any(axis=1).mean() <= most
    error = (results['angular_velocity'] + results['bias'] - truth[kept])[1500:]
    assert np.sqrt(np.mean(error**2)) < ratio * 0.005


@pytest.mark.parametrize('seed', range(3))
def test_losses_between_irregular_stamps_teach_no_noise_of_motion(seed):
    """Stamps off by near a period, four samples lost, and the first rest after a minute."""
    random = np.random.default_rng(seed)
    n, rate, moving = 8000, 100.0, 6000
    seconds = np.arange(n) / rate
    turn = np.sin(2.0 * np.pi * np.array([0.4, 0.5, 0.6]) * seconds[:, None])
    z = 0.005 * random.standard_normal((n, 3))
    z[:moving] += turn[:moving]
    force = upright(random, n)
    force[:moving] += np.sin(2.0 * np.pi * 0.7 * seconds[:moving, None])
    times = stamps(n, rate) + np.round(1e7 * random.uniform(-0.8, 0.8, n)).astype(np.int64)
    kept = np.delete(np.arange(n), [900, 1500, 2000, 3000])
    results = Filter().run(np.sort(times)[kept], z[kept], force[kept])
    resting = results['at_rest'] > 0.0
    assert resting.mean() > 0.15
    assert np.sqrt(results['measurement_noise'][resting]).max() < 2.0 * 0.005


@pytest.mark.parametrize(('least', 'most', 'share'), [(0.5, 3.0, 0.8), (8.0, 30.0, 0.97)])
@pytest.mark.parametrize('lost', [0.0, 0.02])
def test_spikes_are_found_where_delays_may_hide_losses(lost, least, most, share, random):
    """Where the rate changes by 0.12 rad/s from sample to sample."""
    n = 12_000
    hand = motion_below(2.0, random, n, 100.0)
    z = 2.0 * hand / hand.std() + 0.005 * random.standard_normal((n, 3))
    hit = random.random(n) < 0.005
    signs = random.choice([-1.0, 1.0], (hit.sum(), 3))
    z[hit] += signs * random.uniform(least, most, (hit.sum(), 3))
    late = (3e6 * random.exponential(size=n)).astype(np.int64)
    times, kept = np.maximum.accumulate(stamps(n, 100.0) + late), random.random(n) >= lost
    flagged = Filter().run(times[kept], z[kept], upright(random, n)[kept])['outlier'] > 0
    assert flagged[1500:][hit[kept][1500:]].mean() > share
    assert flagged[1500:][~hit[kept][1500:]].mean() < 0.001


def left_by_gaps(n, random):
    """Return which of n samples are left by ten gaps of 20 samples."""
    kept = np.ones(n, bool)
    for first in random.choice(np.arange(1500, n - 100), 10, replace=False):
        kept[first : first + 20] = False
    return kept


def read_from_a_fifo(size):
    """Return what a driver does that stamps so many samples when it reads them all."""

    def do(times, random):
        n = len(times)
        last = np.minimum(np.arange(n) // size * size + size - 1, n - 1)
        order = np.flatnonzero(left_by_gaps(n, random))
        return times[last][order], order

    return do


def block_until_the_buffer_is_full(times, random):
    """A driver that is blocked for 0.3 s gets the oldest eight samples then; the rest is lost."""
    kept, late = np.ones(len(times), bool), times.copy()
    for first in random.choice(np.arange(1500, len(times) - 100), 10, replace=False):
        kept[first + 8 : first + 30] = False
        late[first : first + 30] = times[first + 30]
    order = np.flatnonzero(kept)
    return np.maximum.accumulate(late)[order], order


def overtake_late_messages(times, random):
    """One message in 50 comes after the next one, and all are stamped late."""
    late = np.maximum.accumulate(times + (3e6 * random.exponential(size=len(times))).astype(int))
    order = np.arange(len(times))
    for i in np.flatnonzero(random.random(len(times) - 1) < 0.02):
        order[[i, i + 1]] = order[[i + 1, i]]
    return late[order], order


def lose_the_first_samples_after_long_delays(times, random):
    """All messages are late now and then, by up to some 0.3 s, and few gaps are lost."""
    held_up = random.exponential(8e7, len(times)) * (random.random(len(times)) < 0.01)
    order = np.flatnonzero(left_by_gaps(len(times), random))
    return np.maximum.accumulate(times + held_up.astype(int))[order], order


@pytest.mark.parametrize('rate', [100.0, 400.0])
def test_spikes_are_found_in_the_samples_of_a_fifo(rate, random):
    """The first one of each burst is no worse than the others: its step is as long as usual."""
    n = 12_000
    hand = motion_below(2.0, random, n, rate)
    z = 2.0 * hand / hand.std() + 0.005 * random.standard_normal((n, 3))
    hit = random.random(n) < 0.005
    z[hit] += random.choice([-1.0, 1.0], (hit.sum(), 3)) * random.uniform(2.0, 5.0, (hit.sum(), 3))
    times = stamps(n, rate)[np.minimum(np.arange(n) // 10 * 10 + 9, n - 1)]
    results = Filter().run(times, z, upright(random, n))[2000:]
    flagged, hit = results['outlier'].max(axis=1) > 0.0, hit[2000:]
    first = np.arange(2000, n) % 10 == 0
    for of in (first, ~first):
        assert flagged[of & hit].mean() > 0.9


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize(
    'driver',
    [
        read_from_a_fifo(4),
        read_from_a_fifo(10),
        block_until_the_buffer_is_full,
        overtake_late_messages,
        lose_the_first_samples_after_long_delays,
    ],
    ids=['FIFO of 4', 'FIFO of 10', 'full buffer', 'overtaken', 'long delays'],
)
@pytest.mark.parametrize('rate', [100.0, 200.0])
def test_losses_that_delays_of_any_kind_hide_cost_nothing_in_fast_motion(rate, driver, seed):
    random = np.random.default_rng(seed)
    n = 12_000
    hand = motion_below(4.0, random, n, rate)
    truth = 6.0 * hand / hand.std()
    noise = 0.005 * random.standard_normal((n, 3))
    times, order = driver(stamps(n, rate), random)
    results = Filter().run(times, (truth + noise)[order], upright(random, n)[order])
    error = (results['angular_velocity'] + results['bias'] - truth[order])[1000:]
    assert np.sqrt(np.mean(error**2)) < 1.05 * noise.std()


def test_the_end_of_the_range_is_passed_and_left_without_doubt(random):
    truth = np.concatenate([np.zeros((800, 3)), fast_turn(2000, 100.0)])
    z = truth + 0.005 * random.standard_normal(truth.shape)
    limit = 4.0
    clipped = np.clip(z, -limit, limit)
    results = Filter(Parameters()).run(stamps(len(z), 100.0), clipped, upright(random, len(z)))
    error = np.abs(results['angular_velocity'] - clipped)
    assert np.quantile(error[900:], 0.99) < 0.05
    assert results['outlier'].mean() < 0.002


def test_the_end_of_the_range_teaches_no_noise(random):
    """Nor is a rate that stays there taken for the true one, however often it comes."""
    n, rate = 1000, 100.0
    seconds = np.maximum(np.arange(n) / rate - 5.0, 0.0)[:, None]
    turn = np.sin(2 * np.pi * seconds * [1.0, 1.3, 0.7]) * [9.0, 4.0, 3.0]
    z = np.clip(turn + 0.004 * random.standard_normal((n, 3)), -5.0, 5.0)
    filter_, at_limit, constant = Filter(), 0, 0
    noise = filter_.state['methods']['adaptive'][0]['noise']
    own = filter_.record[0]['workspace']['methods']['adaptive']['axes'][0]
    for stamp, sample, force in zip(stamps(n, rate), z, upright(random, n), strict=True):
        count = int(noise['block']['count'])
        filter_.step(stamp, sample, force)
        if own['at_limit']:
            at_limit += 1
            constant += own['reason'] == Reason.CONSTANT
            assert noise['block']['count'] in (count, 0)
    assert at_limit > 100
    assert constant == 0


@pytest.mark.parametrize('share', [0.003, 0.01, 0.03])
def test_the_end_of_the_range_is_met_where_a_driver_has_calibrated_the_rates(share, random):
    """So that the rate does not stay the same: it moves with those of the other axes."""
    truth = np.concatenate([np.zeros((800, 3)), fast_turn(3000, 100.0)])
    z = np.clip(truth + 0.005 * random.standard_normal(truth.shape), -4.0, 4.0)
    given = z @ (np.eye(3) + share * random.choice([-1.0, 1.0], (3, 3)))
    filter_ = Filter()
    results = filter_.run(stamps(len(z), 100.0), given, upright(random, len(z)))
    error = np.abs(results['angular_velocity'] - given)
    # Once it is known.
    assert np.quantile(error[1800:], 0.99) < 0.05
    assert results['outlier'][1800:].mean() < 0.002
    assert filter_.state['checks']['range_end']['clipped_calibrated'][[0, 2]].all()


@pytest.mark.parametrize('every', [2, 4, 8])
def test_what_a_driver_interpolates_meets_no_end_of_a_range(every, random):
    """Between two measurements there is no noise, and the change changes at each of them."""
    hand = motion_below(12.0, random, 8000, 200.0)
    truth = 5.0 * hand / hand.std() * np.clip(np.arange(8000) / 200.0 - 6.0, 0.0, 1.0)[:, None]
    z = truth + 0.005 * random.standard_normal(truth.shape)
    at = np.arange(8000)
    given = np.column_stack([np.interp(at, at[::every], column[::every]) for column in z.T])
    filter_ = Filter()
    filter_.run(stamps(8000, 200.0), given, upright(random, 8000))
    assert not filter_.state['checks']['range_end']['clipped_calibrated'].any()
    assert filter_.state['checks']['range_end']['clipped'].sum() == 0


def test_an_end_of_the_range_that_is_exceeded_was_none(random):
    """It was met where a rate stopped by chance."""
    truth = np.concatenate([np.zeros((800, 3)), fast_turn(3000, 100.0)])
    z = truth + 0.005 * random.standard_normal(truth.shape)
    clipped = np.clip(z, -3.0, 3.0)
    given = np.where((np.arange(len(z)) < 2000)[:, None], clipped, z)
    given = given @ (np.eye(3) + 0.01 * random.choice([-1.0, 1.0], (3, 3)))
    filter_, times = Filter(), stamps(len(z), 100.0)
    filter_.run(times[:2000], given[:2000], upright(random, 2000))
    assert filter_.state['checks']['range_end']['clipped_calibrated'].any()
    filter_.run(times[2000:], given[2000:], upright(random, len(z) - 2000))
    assert not filter_.state['checks']['range_end']['clipped_calibrated'].any()


def test_a_table_that_stops_to_accelerate_is_not_at_the_end_of_its_range(random):
    """Its rate stays as suddenly, but noise stays, too."""
    time = np.arange(6000) / 100.0
    rates = 0.005 * random.standard_normal((6000, 3))
    rates[:, 2] += np.clip(20.0 * (np.abs(time % 10.0 - 5.0) - 2.5), 0.0, 2.0) * (time > 10.0)
    filter_ = Filter()
    filter_.run(stamps(6000, 100.0), rates, upright(random, 6000))
    assert filter_.state['bias']['rest']['known']
    assert filter_.state['checks']['range_end']['clipped'].sum() == 0


@pytest.mark.parametrize('limit', np.radians([75.0, 100.0, 125.0, 250.0]))
def test_a_hand_that_is_faster_than_the_range_is_followed_as_soon_as_it_is_within(limit, random):
    """Gyroscopes have ranges from 75 deg/s on."""
    hand = motion_below(4.0, random, 6000, 100.0)
    truth = np.concatenate([np.zeros((800, 3)), 4.0 * hand / hand.std()])
    z = truth + 0.005 * random.standard_normal(truth.shape)
    given = np.clip(z, -limit, limit)
    results = Filter(Parameters()).run(stamps(len(z), 100.0), given, upright(random, len(z)))
    measured = (np.abs(truth) < 0.96 * limit).all(axis=1) & (np.arange(len(z)) > 1000)
    error = (results['angular_velocity'] - truth)[measured]
    assert np.sqrt(np.mean(error**2)) < 0.0055


def test_all_axes_at_the_end_of_the_range_are_no_repeat(random):
    """Their rates stay the same to the last bit, as those of a sensor that was polled twice."""
    time = np.arange(3000) / 100.0
    truth = np.sin(2 * np.pi * 0.7 * time)[:, None] * [9.0, -10.0, 11.0]
    truth[:800] = 0.0
    given = np.clip(truth + 0.001 * random.standard_normal(truth.shape), -3.5, 3.5)
    results = Filter(Parameters()).run(stamps(3000, 100.0), given, upright(random, 3000))
    assert np.abs(results['angular_velocity'] - given)[900:].max() < 0.3


def test_a_driver_that_hangs_in_motion_does_not_let_the_rate_run_away(random):
    """It repeats its last rates for half a second, in the midst of a push."""
    time = np.arange(2000) / 100.0
    truth = np.sin(2 * np.pi * 1.0 * time)[:, None] * [3.0, -4.0, 2.0]
    truth[:800] = 0.0
    given = truth + 0.005 * random.standard_normal(truth.shape)
    given[1400:1450] = given[1399]
    out = Filter(Parameters()).run(stamps(2000, 100.0), given, upright(random, 2000))
    assert np.abs(out['angular_velocity'] - given)[1410:1450].max() < 0.5
    assert np.abs(out['angular_velocity'][1700:] - truth[1700:]).max() < 0.1


@pytest.mark.parametrize(('rate', 'largest'), [(50.0, 0.1), (100.0, 0.3), (200.0, 0.3)])
def test_losses_in_the_first_second_of_fast_motion_are_no_outliers(rate, largest):
    """What a gap is shows only after some samples: nobody knows yet by how much stamps vary."""
    n = round(4 * rate)
    truth, times = fast_turn(n, rate), stamps(n, rate)
    for seed in range(20):
        random = np.random.default_rng(seed)
        kept = random.random(n) > 0.1
        z = truth + 0.005 * random.standard_normal(truth.shape)
        results = Filter(Parameters()).run(times[kept], z[kept], upright(random, n)[kept])
        assert not results['outlier'].any(), seed
        assert np.abs(results['angular_velocity'] - truth[kept]).max() < largest, seed


@pytest.mark.parametrize('whole', [True, False])
@pytest.mark.parametrize('seconds', [0.1, 0.3, 0.5, 1.0, 1.5, 3.0])
def test_the_samples_after_a_bus_has_hung_are_no_outliers(seconds, whole, random):
    """However fast the body turned meanwhile; and what came meanwhile is no noise of none."""
    truth = np.concatenate([np.zeros((800, 3)), fast_turn(3000, 100.0), np.zeros((800, 3))])
    given = truth + 0.006 * random.standard_normal(truth.shape)
    accelerations = upright(random, len(given))
    hung, n = np.zeros(len(given), bool), round(100 * seconds)
    for k in (350, 1400, 2030, 2710, 3333):
        given[k : k + n] = given[k - 1]
        if whole:
            accelerations[k : k + n] = accelerations[k - 1]
        hung[k : k + n] = True
    results = Filter(Parameters()).run(stamps(len(given), 100.0), given, accelerations)
    error = np.abs(results['angular_velocity'] - truth)
    moving = ~hung & (np.arange(len(given)) > 850)
    assert not results['outlier'][moving].any()
    assert error[moving].max() < 0.1
    assert error[3900:4500].mean() < 0.35 * np.abs(given - truth)[3900:4500].mean()
    assert np.sqrt(results['measurement_noise'][4500:]).min() > 0.004


# The same examples each time: the limit is measured, not proven.
@pytest.mark.slow
@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10_000),
    speed=st.floats(0.2, 2.0),
    repeated=st.floats(0.0, 0.25),
    lost=st.floats(0.0, 0.05),
)
def test_the_heading_is_conserved(seed, speed, repeated, lost):
    """Whatever is repeated or lost: two seconds after it the integral is that of the motion."""
    random = np.random.default_rng(seed)
    moving = speed * fast_turn(1500, 100.0)
    truth = np.concatenate([np.zeros((600, 3)), moving, np.zeros((300, 3))])
    z = truth + 0.003 * random.standard_normal(truth.shape)
    for k in np.flatnonzero(random.random(len(z)) < repeated):
        if 650 < k < 2050:
            z[k] = z[k - 1]
    kept = random.random(len(z)) >= lost
    kept[:600] = kept[-300:] = True
    times = stamps(len(z), 100.0)[kept]
    results = Filter(Parameters()).run(times, z[kept], upright(random, len(z))[kept])
    steps = np.diff(times, prepend=times[0])[:, None] * 1e-9

    def off_by(rates):
        ends = [running_products(from_vectors(r * steps))[-1] for r in (rates, truth[kept])]
        return np.linalg.norm(to_vectors(multiply(inverse(ends[0]), ends[1])))

    off, given_off = off_by(results['angular_velocity']), off_by(z[kept])
    assert off < given_off + np.radians(5.0)


@pytest.mark.parametrize('rate', [5, 10, 50, 100])
@pytest.mark.parametrize('size', [2.0, 12.0, 30.0])
def test_a_fast_turn_at_a_low_rate_loses_no_heading(size, rate):
    """Its first samples are held back, and each stands for a long time."""
    random = np.random.default_rng(0)
    truth = np.zeros((60 * rate, 3))
    truth[40 * rate : 43 * rate, 2] = size
    z = truth + 0.002 * random.standard_normal(truth.shape)
    results = Filter().run(stamps(len(z), rate), z, upright(random, len(z)))
    lost = (results['angular_velocity'] - truth).sum(axis=0)[2] / rate
    assert abs(lost) < np.radians(5.0)


@pytest.mark.parametrize('stands', range(400, 416))
def test_what_is_held_before_a_loss_is_motion_if_the_next_sample_lies_beyond_it(stands, random):
    """A hand begins to turn, in samples at 10 Hz, of which the third one is held and the next lost.

    Once the sensor no longer stands, a body may have come where the next sample is.
    """
    begun = np.radians([[-0.5, 0.4, -3.5], [-16.0, -11.0, -36.0], [-30.0, -109.0, -27.0]])
    turn = np.radians([[186.0, -197.0, -167.0], [261.0, -90.0, -233.0], [233.0, 26.0, -161.0]])
    still = np.zeros((stands, 3)), np.zeros((60, 3))
    rates = np.concatenate([still[0], begun, turn, still[1]])
    rates += 1.4e-4 * random.standard_normal(rates.shape)
    times = np.delete(stamps(len(rates) + 1, 10.0), stands + 3)
    results = Filter().run(times, rates, np.full(rates.shape, np.nan))
    filtered = results['angular_velocity'] + results['bias']
    ends = [running_products(from_vectors(0.1 * r))[-1] for r in (filtered, rates)]
    assert np.linalg.norm(to_vectors(multiply(inverse(ends[0]), ends[1]))) < np.radians(2.0)


@pytest.mark.parametrize(('rate', 'size'), [(25, 34.0), (50, 25.0), (50, 34.0)])
def test_what_a_large_step_turns_while_it_is_held_is_given_back(rate, size):
    """It does not end here, as what is lost where a turn begins comes back where it ends."""
    random = np.random.default_rng(0)
    truth = np.zeros((50 * rate, 3))
    truth[40 * rate :, 2] = size
    z = truth + 0.002 * random.standard_normal(truth.shape)
    results = Filter().run(stamps(len(z), rate), z, upright(random, len(z)))
    lost = (results['angular_velocity'] - truth).sum(axis=0)[2] / rate
    assert abs(lost) < np.radians(1.0)


@pytest.mark.parametrize('seed', [2, 4])
def test_outliers_in_motion_are_not_given_back(seed):
    """Not even where the sample after them is held back as well, and counts as motion then.

    Simulated motion does not begin suddenly enough to show it, a hand does.
    """
    data = np.load(recorded(MOTION / '14_undisturbed_slow_translation_with_breaks_B.npz'))
    truth, accelerations = data['rate'][:12_000].astype(float), data['acc'][:12_000].astype(float)
    random = np.random.default_rng(seed)
    z, outlier = truth + 6e-4 * random.standard_normal(truth.shape), np.zeros(truth.shape, bool)
    for axis in range(3):
        for first in random.choice(np.arange(500, len(z) - 10, 10), 60, replace=False):
            last = first + random.choice([1, 1, 1, 3])
            z[first:last, axis] += random.choice([-1, 1]) * random.uniform(2, 35)
            outlier[first:last, axis] = True
    parameters = Parameters(bias_enabled=False)
    out = Filter(parameters).run(stamps(len(z), 100.0), z, accelerations)['angular_velocity']
    error = np.where(outlier, 0.0, out - truth)
    assert np.sqrt(np.mean(error**2)) < 2e-3


def test_a_small_step_is_not_confirmed_by_an_outlier(random):
    """The first sample of a sudden motion is held back, and the next one is a spike."""
    n = 4000
    truth = np.zeros((n, 3))
    starts = np.arange(1000, n - 100, 250)
    for first in starts:
        truth[first : first + 20, 2] = 2.0 * np.sin(2 * np.pi * np.arange(20) / 20)
    z = truth + 6e-4 * random.standard_normal((n, 3))
    z[starts + 2, 2] += 13.0
    results = Filter(Parameters()).run(stamps(n, 100.0), z, upright(random, n))
    assert np.abs(results['angular_velocity'] - truth).max() < 4.0


@pytest.mark.slow
def test_chance_does_not_lower_the_noise_in_motion(random):
    """For an hour of motion, in which it can't be measured."""
    n = 360_000
    time = np.arange(n) / 100
    z = 0.006 * random.standard_normal((n, 3))
    z[2000:] += np.sin(2 * np.pi * 0.7 * time[2000:, None] + np.arange(3))
    results = Filter(Parameters()).run(stamps(n, 100.0), z, upright(random, n))
    learned = np.sqrt(results['measurement_noise'][[1900, -1]])
    assert (learned[1] > 0.85 * learned[0]).all()
