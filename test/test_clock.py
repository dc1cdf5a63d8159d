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

"""Time: gaps, bursts, and stamps that go wrong."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.scenarios import bursty_stamps
from gyro_drift_filter.bags.imu_arrays import read_imu_arrays
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.clock.periodogram import keep_stamp, period_of_stamps
from gyro_drift_filter.core.records import FILTER
from gyro_drift_filter.core.sample import SampleStatus
from support.messages import START, even_stamps
from support.paths import RECORDINGS, recorded
from support.sensor import GRAVITY, NOISE, at_rest, by_hand, fast_turn

MS = 1_000_000
ZERO = (0.0, 0.0, 0.0)


def feed(filter_, stamps, seed=1):
    noise = 0.005 * np.random.default_rng(seed).standard_normal((len(stamps), 3))
    return filter_.run(np.asarray(stamps, np.int64), noise, np.zeros_like(noise))


def regular(n, period=10 * MS, start=START):
    return start + period * np.arange(n)


def clock(filter_):
    return {name: filter_.state['clock'][name].item() for name in ('gaps', 'missing_samples')} | {
        name: int(filter_.state['clock'][name])
        for name in ('restarts', 'zero_stamps', 'same_stamps', 'backward_stamps')
    }


QUIET = dict.fromkeys(
    ('gaps', 'missing_samples', 'restarts', 'zero_stamps', 'same_stamps', 'backward_stamps'), 0
)


@pytest.mark.parametrize('rate', [50, 100, 285.7, 1000, 4000])
def test_learns_the_period_from_the_stamps(rate):
    filter_ = Filter()
    jitter = np.random.default_rng(0).uniform(-0.05, 0.05, 3000)
    feed(filter_, START + ((np.arange(3000) + jitter) * 1e9 / rate).astype(np.int64))
    assert filter_.state['clock']['period'] * rate == pytest.approx(1.0, rel=0.02)
    assert clock(filter_) == QUIET


def test_takes_the_given_rate_exactly():
    filter_ = Filter(Parameters(sample_rate=100.0))
    feed(filter_, regular(1000, 10 * MS + 40_000))
    assert filter_.state['clock']['period'] == 1 / 100.0


def test_a_given_rate_that_is_wrong_gives_way_to_the_stamps():
    filter_ = Filter(Parameters(sample_rate=100.0))
    feed(filter_, regular(4000, 5 * MS))
    assert filter_.state['clock']['period'] == pytest.approx(0.005, rel=0.02)


def test_a_rate_that_is_given_on_the_way_is_that_of_samples_without_stamps():
    zeros = np.zeros(1000, np.int64)
    filter_, expected = Filter(), Filter(Parameters(sample_rate=50.0))
    feed(filter_, zeros)
    feed(expected, zeros)
    filter_.configure(Parameters(sample_rate=50.0))
    for name in ('period', 'mean_period', 'mean_rate'):
        assert filter_.state['clock'][name] == expected.state['clock'][name], name


@pytest.mark.parametrize(
    ('sample_rate', 'period'), [(99.0, 1 / 99.0), (200.0, 0.01), (50.0, 0.01), (0.0, 0.01)]
)
def test_a_rate_that_is_given_on_the_way_gives_way_to_the_stamps(sample_rate, period):
    """As one that was given at the start does; a step of the old period is no gap of the new."""
    filter_ = Filter()
    feed(filter_, regular(1500))
    filter_.configure(Parameters(sample_rate=sample_rate))
    assert filter_.state['clock']['period'] == pytest.approx(period, rel=1e-9)
    feed(filter_, regular(1500, start=START + 1500 * 10 * MS))
    assert filter_.state['clock']['period'] == pytest.approx(period, rel=1e-9)
    assert clock(filter_) == QUIET


def test_a_gap_is_predicted_through_by_as_many_steps():
    """Seven missing samples: the covariance is that of eight predictions."""
    filter_ = Filter(Parameters(method='kalman'))
    feed(filter_, regular(500))
    paper = filter_.state['methods']['paper'][0]
    x = np.array([paper['rate'], paper['drift']])
    p = np.array(
        [
            [paper['rate_variance'], paper['covariance']],
            [paper['covariance'], paper['drift_variance']],
        ]
    )
    a, q = np.array([[1.0, 1.0], [0.0, 0.218]]), np.diag([0.0, 2.38e-5])
    for _ in range(8):
        x, p = a @ x, a @ p @ a.T + q
    result = filter_.step(START + 507 * 10 * MS, (0.1, 0.1, 0.1), ZERO)
    assert clock(filter_) == QUIET | {'gaps': 1, 'missing_samples': 7}
    assert result['innovation'][0] == pytest.approx(0.1 - x[0], rel=1e-9)
    assert result['innovation_variance'][0] == pytest.approx(p[0, 0] + 2.5e-5, rel=1e-9)


def test_a_gap_beyond_the_limit_restarts_at_the_sample():
    filter_ = Filter(Parameters(gap_limit=0.5, bias_enabled=False))
    feed(filter_, regular(500))
    result = filter_.step(START + 600 * 10 * MS, (3.0, 2.0, 1.0), ZERO)
    assert result['angular_velocity'].tolist() == pytest.approx([3.0, 2.0, 1.0], rel=1e-12)
    assert clock(filter_) == QUIET | {'gaps': 1, 'restarts': 1}
    assert filter_.state['clock']['period'] == pytest.approx(0.01)


def test_a_restart_keeps_what_was_learned_of_the_noise():
    filter_: Any = Filter(Parameters(method='sage_husa'))
    feed(filter_, regular(500))
    learned = filter_.state['methods']['paper']['measurement_noise'].copy()
    filter_.step(START + 3600 * 10**9, (3.0, 2.0, 1.0), ZERO)
    assert (filter_.state['methods']['paper']['measurement_noise'] == learned).all()
    assert (learned != 2.5e-5).all()


def test_backward_stamps():
    filter_ = Filter(Parameters(bias_enabled=False))
    feed(filter_, regular(500))
    filter_.step(START + 480 * 10 * MS, ZERO, ZERO)
    assert clock(filter_) == QUIET | {'backward_stamps': 1}
    filter_.step(START - 3600 * 10**9, (3.0, 2.0, 1.0), ZERO)
    assert clock(filter_) == QUIET | {'backward_stamps': 2, 'restarts': 1}
    rates = filter_.state['result']['angular_velocity'].tolist()
    assert rates == pytest.approx([3.0, 2.0, 1.0], rel=1e-12)


def test_a_duplicate_is_repeated_and_moves_nothing():
    filter_: Any = Filter()
    feed(filter_, regular(500))
    first = filter_.step(START + 500 * 10 * MS, (0.1, 0.2, 0.3), ZERO).copy()
    before = filter_.state['methods']['paper'].copy()
    again = filter_.step(START + 500 * 10 * MS, (0.1, 0.2, 0.3), ZERO)
    assert (first['status'], again['status']) == (SampleStatus.FILTERED, SampleStatus.REPEATED)
    assert (first['angular_velocity'] == again['angular_velocity']).all()
    assert (filter_.state['methods']['paper'] == before).all()
    assert filter_.state['counts']['duplicates'] == 1
    assert clock(filter_) == QUIET


def test_an_equal_stamp_with_new_rates_is_a_sample():
    filter_ = Filter()
    feed(filter_, regular(500))
    filter_.step(START + 499 * 10 * MS, (0.1, 0.2, 0.3), ZERO)
    assert clock(filter_) == QUIET | {'same_stamps': 1}
    assert filter_.state['result']['status'] == SampleStatus.FILTERED


def test_zero_stamps_are_filtered_sample_by_sample():
    filter_ = Filter(Parameters(method='kalman'))
    stamped = Filter(Parameters(method='kalman'))
    a = feed(filter_, np.zeros(300))
    b = feed(stamped, regular(300))
    assert (a['angular_velocity'] == b['angular_velocity']).all()
    assert clock(filter_) == QUIET | {'zero_stamps': 300}


@pytest.mark.slow
@pytest.mark.parametrize(
    'stamp_of',
    [
        lambda stamps: np.full_like(stamps, START),
        lambda stamps: stamps // 1000,
        lambda stamps: stamps // MS,
        lambda stamps: stamps // 10**9 * 10**9,
        lambda stamps: bursts(len(stamps), 40),
    ],
    ids=['one stamp', 'microseconds', 'milliseconds', 'whole seconds', 'bursts'],
)
def test_the_bias_becomes_uncertain_whether_stamps_tell_the_time_or_not(stamp_of, random):
    """Stamps that stand, or in another unit, tell none; those of bursts do, with the next one."""
    rates, accelerations = at_rest(random, 320.0)
    motion, shake = by_hand(random, 300.0)
    rates[2000:] += motion
    accelerations[2000:] += shake
    stamps = regular(len(rates))
    filters, known = (Filter(), Filter()), Filter()
    known.run(stamps[:2000], rates[:2000], accelerations[:2000])
    for filter_, times in zip(filters, (stamps, stamp_of(stamps)), strict=True):
        filter_.run(times, rates, accelerations)
    even, other = (filter_.bias_deviation for filter_ in filters)
    assert (even > 2.0 * known.bias_deviation).all()
    np.testing.assert_allclose(other, even, rtol=0.03)


def bursts(n, size):
    """Return samples taken evenly, handed over `size` at a time in steps of 0.2 periods."""
    block, period = np.arange(n) // size, 10 * MS
    return START + block * size * period + (np.arange(n) % size) * (period // 5)


def test_long_bursts_are_known_for_what_they_are_after_two_seconds():
    """Half a second of even steps looks like a regular driver, until it has waited a few times."""
    filter_ = Filter()
    stamps = bursts(6000, 49)
    feed(filter_, stamps[:300])
    gaps = int(filter_.state['clock']['gaps'])
    feed(filter_, stamps[300:])
    assert filter_.state['clock']['gaps'] == gaps
    assert filter_.state['clock']['period'] == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize('late', [0.005, 0.02])
def test_bursts_from_the_first_sample_on_do_not_move_a_sensor_at_rest(late, random):
    """Several samples with one stamp, before the period is known: they say nothing of it."""
    for _ in range(20):
        arrivals = np.arange(400) * 0.005 + random.exponential(late, 400)
        stamps = START + np.round(np.maximum.accumulate(arrivals) * 1e9).astype(np.int64)
        stamps[1] = stamps[0]
        rates = 0.006 * random.standard_normal((400, 3))
        results = Filter().run(stamps, rates, np.tile([0.0, 0.0, 9.81], (400, 1)))
        assert np.abs(results['angular_velocity']).max() < 0.05


def test_a_period_that_is_hard_to_learn_does_not_hinder_smoothing(random):
    """Long bursts at 1,000 Hz: it is learned anew every two seconds, off by up to a half."""
    n = 40_000
    noise = 0.005 * random.standard_normal((n, 3))
    gravity = np.tile([0.0, 0.0, 9.81], (n, 1))
    out = Filter().run(bursty_stamps(n, 1000.0, random), noise, gravity)['angular_velocity']
    assert (out[20_000:].std(axis=0) < 0.06 * noise.std(axis=0)).all()


@pytest.mark.parametrize('size', [2, 4, 16, 28])
def test_bursts_are_jitter_not_gaps(size):
    filter_ = Filter()
    feed(filter_, bursts(6000, size))
    assert clock(filter_) == QUIET
    assert filter_.state['clock']['period'] == pytest.approx(0.01, rel=0.1)


def test_a_rate_that_changes_is_followed():
    for before, after in ((10 * MS, 2_500_000), (2_500_000, 10 * MS)):
        filter_ = Filter()
        stamps = regular(4000, before)
        feed(filter_, stamps)
        feed(filter_, regular(12_000, after, stamps[-1] + after))
        assert filter_.state['clock']['period'] == pytest.approx(after * 1e-9, rel=0.05)
        assert filter_.state['clock']['restarts'] == 0
        gaps = int(filter_.state['clock']['gaps'])
        feed(filter_, regular(1000, after, stamps[-1] + 12_001 * after))
        assert filter_.state['clock']['gaps'] == gaps


def of_two_rates(before, after, samples, jitter, random):
    """Return a filter after 20 s at one rate in Hz, and so many samples at another one."""
    filter_ = Filter()
    stamps = jittered(20 * before, before, jitter, random)
    feed(filter_, stamps)
    feed(filter_, stamps[-1] + 10**9 // after + jittered(samples, after, jitter, random) - START)
    return filter_


@pytest.mark.parametrize(('before', 'after'), [(200, 100), (400, 50), (100, 33)])
@pytest.mark.parametrize('jitter', [0.0, 0.1])
def test_a_driver_that_lowers_its_rate_has_lost_nothing(before, after, jitter, random):
    filter_ = of_two_rates(before, after, 40, jitter, random)
    assert clock(filter_) == QUIET
    assert filter_.state['clock']['period'] == pytest.approx(1.0 / after, rel=0.02)


@pytest.mark.parametrize(('before', 'after'), [(100, 200), (50, 200), (100, 400), (33, 100)])
@pytest.mark.parametrize('jitter', [0.0, 0.1])
def test_a_driver_that_raises_its_rate_is_followed_within_25_samples(before, after, jitter, random):
    """It took 7 to 10 s, in which gravity was turned two to four times too far."""
    filter_ = of_two_rates(before, after, 25, jitter, random)
    assert clock(filter_) == QUIET
    assert filter_.state['clock']['period'] == pytest.approx(1.0 / after, rel=0.03)


@pytest.mark.parametrize('stall', [0.3, 0.6, 0.9])
@pytest.mark.parametrize('pace', [2.0, 4.0, 8.0])
@pytest.mark.parametrize('gap_limit', [1.0, 10.0])
def test_samples_that_were_held_up_are_no_faster_driver(stall, pace, gap_limit, random):
    """They come in at a pace of their own, of one length, until they have caught up."""
    times = np.arange(2000) / 100
    late = 10.0 + stall + (times - 10.0) / pace
    times = np.where(times >= 10.0, np.maximum(times, late), times)
    check_the_period_stays(times, gap_limit, random)


@pytest.mark.slow
@pytest.mark.parametrize(('share', 'seconds', 'pace'), [(0.9, 4, 3), (0.75, 1, 3), (0.75, 2, 5)])
def test_a_slow_link_that_catches_up_is_no_faster_driver(share, seconds, pace, random):
    """It is late by no long step, and some samples are taken for missing meanwhile."""
    times = np.arange(3000) / 100
    arrival = np.maximum(times, 10.0 + (times - 10.0) / share)
    caught_up = 10.0 + seconds + (times - 10.0 - share * seconds) / pace
    arrival = np.where(times > 10.0, np.maximum(times, np.minimum(arrival, caught_up)), times)
    check_the_period_stays(arrival, 1.0, random)


def check_the_period_stays(times, gap_limit, random):
    """Check that samples of 100 Hz at these times (s) keep their period, from 10 s on."""
    filter_ = Filter(Parameters(gap_limit=gap_limit))
    periods = []
    for stamp in START + np.round(times * 1e9).astype(np.int64):
        filter_.step(stamp, random.standard_normal(3), ZERO)
        periods.append(float(filter_.state['clock']['period']))
    np.testing.assert_allclose(periods[1000:], 0.01, rtol=0.02)


def test_losses_that_come_often_stay_losses(random):
    """Every second message for a while, or a third of them at random."""
    filter_ = Filter()
    stamps = regular(4000)
    kept = np.ones(4000, bool)
    kept[1000:1036:2] = False
    feed(filter_, stamps[kept])
    assert clock(filter_) == QUIET | {'gaps': 18, 'missing_samples': 18}
    filter_ = Filter()
    kept = random.random(4000) > 0.33
    kept[:1000] = True
    feed(filter_, stamps[kept])
    assert clock(filter_)['missing_samples'] == pytest.approx(np.sum(~kept), rel=0.01)
    assert filter_.state['clock']['period'] == pytest.approx(0.01, rel=1e-3)


def late(n, rate, mean, random):
    """Stamped on arrival, by an exponential delay (s) late; none overtakes another."""
    stamps = even_stamps(n, rate)
    return np.maximum.accumulate(stamps + random.exponential(mean * 1e9, n).astype(np.int64))


def jittered(n, rate, share, random):
    """Stamps that are off by up to a share of the period, early or late."""
    offsets = random.uniform(-share, share, n)
    return START + np.round((np.arange(n) + offsets) * 1e9 / rate).astype(np.int64)


def lose(stamps, share, random, holes=(), length=0):
    """Return the stamps that are left, and how many are missing before each."""
    kept = random.random(len(stamps)) > share
    for first in holes:
        kept[first : first + length] = False
    kept[0] = True
    left = np.flatnonzero(kept)
    return stamps[left], np.diff(left, prepend=-1) - 1


def missing_at(filter_, stamps):
    """Return by how much each sample raised the count of missing ones."""
    counts = []
    for k, stamp in enumerate(stamps):
        filter_.step(stamp, (1e-3 * (k % 2), 0.0, 0.0), ZERO)  # no two alike, or it is a repeat
        counts.append(int(filter_.state['clock']['missing_samples']))
    return np.diff(counts, prepend=0)


def hull_period(steps, stamps):
    """Return the slope in s of the lower convex hull at its middle: what hindsight says.

    Of the lines below all stamps it has the least sum of delays (Zhang, Liu, Xia 2002).
    """
    hull = []
    for x, y in zip(steps.tolist(), ((stamps - stamps[0]) * 1e-9).tolist(), strict=True):
        while len(hull) > 1 and (hull[-1][1] - hull[-2][1]) * (x - hull[-1][0]) >= (
            y - hull[-1][1]
        ) * (hull[-1][0] - hull[-2][0]):
            hull.pop()
        hull.append((x, y))
    (x0, y0), (x1, y1) = next(edge for edge in pairwise(hull) if edge[1][0] >= steps.mean())
    return (y1 - y0) / (x1 - x0)


@pytest.mark.parametrize('rate', [100, 200, 400, 1000])
@pytest.mark.parametrize('mean', [0.2e-3, 0.7e-3, 1.0e-3, 1.5e-3, 2.0e-3])
def test_stamps_of_arrival_are_no_gaps_and_do_not_move_the_rate(rate, mean, random):
    filter_ = Filter()
    feed(filter_, late(20 * rate, rate, mean, random))
    assert filter_.state['clock']['mean_period'] * rate == pytest.approx(1.0, abs=0.002)
    assert filter_.state['clock']['period'] * rate == pytest.approx(1.0, abs=0.011)
    assert clock(filter_)['missing_samples'] <= 2


@pytest.mark.parametrize('rate', [1, 10, 50, 100, 200, 1000, 4000])
def test_the_rate_is_known_to_a_fifth_of_a_percent(rate, random):
    """Half a percent off its name, by a clock that drifts by 100 ppm, with some jitter."""
    true = 1.005 * rate
    samples = np.arange(max(20 * rate, 400))
    seconds = samples / true * (1.0 + 1e-4 * samples / len(samples))
    seconds += random.uniform(-0.05, 0.05, len(samples)) / true
    filter_ = Filter(Parameters(gap_limit=3.0))
    feed(filter_, START + np.round(seconds * 1e9).astype(np.int64))
    assert filter_.state['clock']['mean_period'] * true == pytest.approx(1.0, abs=0.002)
    assert clock(filter_) == QUIET


@pytest.mark.slow
@pytest.mark.parametrize('rate', [100, 200, 1000])
@pytest.mark.parametrize('jitter', [0.0, 0.1, 0.4])
def test_a_lost_message_is_found_with_the_next_one(rate, jitter, random):
    """One in 50, and gaps of 0.2 s, with stamps that are early as well as late."""
    holes = (5 * rate, 9 * rate, 13 * rate)
    stamps = jittered(20 * rate, rate, jitter, random)
    stamps, missing = lose(stamps, 0.02, random, holes, rate // 5)
    found = missing_at(Filter(), stamps)
    known = np.arange(len(stamps)) > 3 * rate
    assert (found == missing)[known].mean() > (0.998 if jitter < 0.4 else 0.99)
    assert found[known].sum() == pytest.approx(missing[known].sum(), abs=3)


@pytest.mark.parametrize('mean', [0.7e-3, 1.0e-3, 1.5e-3])
def test_what_delays_hide_is_counted_later(mean, random):
    """Delays that often come near a period: the period is not learned longer by the losses."""
    stamps = late(8000, 200, mean, random)
    stamps, missing = lose(stamps, 0.0, random, range(1000, 8000, 180), 1)
    filter_ = Filter()
    feed(filter_, stamps)
    assert clock(filter_)['missing_samples'] == pytest.approx(missing.sum(), abs=3)
    assert filter_.state['clock']['mean_period'] * 200 == pytest.approx(1.0, abs=0.002)


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('mean_delay', [0.0, 0.05])
def test_losses_from_the_first_sample_on_do_not_lengthen_the_period(mean_delay, seed):
    """One in ten is missing, so that the first stamps are 11 ms apart in the mean, not 10."""
    random = np.random.default_rng(seed)
    numbers = np.flatnonzero(random.random(6000) >= 0.1)
    delays = mean_delay * random.exponential(size=len(numbers))
    filter_, after = Filter(), 1000
    found = missing_at(filter_, START + ((numbers + delays) * 10 * MS).astype(np.int64))
    assert filter_.state['clock']['mean_period'] == pytest.approx(0.01, rel=1e-3)
    np.testing.assert_array_equal(found[after:], np.diff(numbers)[after - 1 :] - 1)


def delays_of(kind, size, n, random):
    """Return delays in periods: exponential, jitter to either side, or up to a coarse clock."""
    if kind == 'exponential':
        return np.maximum.accumulate(np.arange(n) + random.exponential(size, n)) - np.arange(n)
    if kind == 'jitter':
        return random.uniform(-size, size, n)
    return np.ceil(np.arange(n) / size) * size - np.arange(n)


UNEVEN = [
    ('exponential', 0.1),
    ('exponential', 0.2),
    ('exponential', 0.3),
    ('exponential', 0.5),
    ('jitter', 0.2),
    ('jitter', 0.4),
    ('coarse', 0.4),
]


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'size'), UNEVEN)
@pytest.mark.parametrize('lost', [0.05, 0.1, 0.2])
@pytest.mark.parametrize('rate', [50, 200, 1000])
def test_losses_between_uneven_stamps_do_not_lengthen_the_period(kind, size, lost, rate, random):
    """And nearly all of them are counted, although delays hide many at first."""
    n = 60 * rate
    seconds = (np.arange(n) + delays_of(kind, size, n, random)) / rate
    stamps, missing = lose(START + np.round(1e9 * seconds).astype(np.int64), lost, random)
    filter_, known = Filter(), 20 * rate
    feed(filter_, stamps[:known])
    before = clock(filter_)['missing_samples']
    feed(filter_, stamps[known:], seed=2)
    found = clock(filter_)['missing_samples'] - before
    hard = kind == 'exponential' and size == 0.5
    assert filter_.state['clock']['mean_period'] * rate == pytest.approx(1.0, abs=0.002)
    assert found == pytest.approx(missing[known:].sum(), rel=0.25 if hard else 0.06)


@pytest.mark.parametrize('share', [0.6, 0.7, 0.8])
@pytest.mark.parametrize('lost', [0.0, 0.03, 0.1])
def test_a_bus_that_is_asked_too_often_keeps_the_sensors_period(share, lost, random):
    """Its stamps agree with the period of the bus, but hardly any samples are missing."""
    numbers = np.flatnonzero(random.random(12_000) >= lost)
    stamps = START + np.round(share * 10 * MS * np.ceil(numbers / share)).astype(np.int64)
    filter_ = Filter()
    feed(filter_, stamps)
    assert filter_.state['clock']['mean_period'] == pytest.approx(0.01, rel=0.005)
    missing = (np.diff(numbers) - 1).sum()
    assert clock(filter_)['missing_samples'] == pytest.approx(missing, rel=0.06, abs=5)


@pytest.mark.parametrize('deviation', [0.05, 0.1, 0.2])
def test_a_driver_that_sleeps_has_the_period_of_its_mean_step(deviation, random):
    """Where steps vary by themselves the stamps agree with some other period for a while."""
    steps = 1.0 - deviation + random.exponential(deviation, 12_000)
    filter_, periods = Filter(), []
    stamps = START + np.cumsum(10 * MS * steps).astype(np.int64)
    for first in range(2000, 12_000, 200):
        feed(filter_, stamps[first : first + 200], seed=first)
        periods.append(float(filter_.state['clock']['mean_period']))
    assert np.median(periods[10:]) == pytest.approx(0.01, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize('rate', [100, 1000, 4000])
@pytest.mark.parametrize('jitter', [0.0, 0.05, 0.1])
@pytest.mark.parametrize('lost', [0.0, 0.1])
def test_a_gap_does_not_change_the_period(rate, jitter, lost, random):
    """Whenever it is, and as long as the filter does not start anew behind it."""
    for seconds in (0.3, 0.6, 0.95):
        for _ in range(4):
            hole = random.integers(6 * rate, 9 * rate)
            stamps = jittered(12 * rate, rate, jitter, random)
            stamps, _missing = lose(stamps, lost, random, (hole,), int(seconds * rate))
            filter_ = Filter()
            feed(filter_, stamps)
            assert filter_.state['clock']['mean_period'] * rate == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'size'), UNEVEN)
def test_the_period_of_stamps_has_the_most_power_of_all(kind, size, random):
    """Compared with the periodogram as it is written, on a grid forty times as fine."""
    for lost in (0.02, 0.1, 0.2):
        delays = delays_of(kind, size, 700, random)
        stamps = START + np.round(10 * MS * (np.arange(700) + delays)).astype(np.int64)
        stamps, _ = lose(stamps, lost, random)
        record = np.zeros(1, FILTER)[0]
        record['state']['clock']['mean_period'] = 0.01
        for stamp in stamps:
            keep_stamp(record['state']['clock'], stamp)
        found = period_of_stamps(record['state']['clock'], record['workspace']['clock'])
        seconds = 1e-9 * (stamps[-512:] - stamps[-1])
        seconds = seconds[np.diff(seconds, prepend=-np.inf) > 0.25 * np.diff(seconds).mean()]
        frequencies = np.arange(95.0, 115.0, 0.005)
        power = np.abs(np.exp(2j * np.pi * frequencies[:, None] * seconds).mean(axis=1))
        if found > 0.0:
            assert 1.0 / found == pytest.approx(frequencies[power.argmax()], abs=0.02)
        assert found > 0.0 or (kind, size) in (('exponential', 0.5), ('jitter', 0.4)) or lost < 0.1


@pytest.mark.parametrize('lost', [0.1, 0.2])
def test_losses_that_come_often_put_no_verdict_off(lost, random):
    """While a loss is still in doubt the next one comes: what stood the test is no longer so."""
    stamps, _ = lose(late(6000, 100, 1e-3, random), lost, random)
    filter_, suspected = Filter(), []
    for first in range(0, len(stamps), 50):
        feed(filter_, stamps[first : first + 50], seed=first)
        suspected.append(int(filter_.state['clock']['suspect_missing']))
    assert max(suspected) <= 30
    assert suspected[-1] <= 10
    assert filter_.state['clock']['lost_share'] > 0.9


@pytest.mark.parametrize(
    ('rate', 'deviation'), [(400, 1e-4), (200, 2e-4), (100, 5e-4), (100, 1e-3), (1000, 5e-5)]
)
def test_a_driver_that_sleeps_between_two_readings_loses_nothing(rate, deviation, random):
    """Its steps vary by themselves, so that their errors add up to a period and more."""
    steps = random.normal(1.0 / rate, deviation, 60 * rate)
    stamps = START + np.cumsum(1e9 * steps).astype(np.int64)
    assert np.abs(stamps - START - 1e9 * np.arange(len(stamps)) / rate).max() > 1e9 / rate
    filter_ = Filter()
    feed(filter_, stamps)
    assert clock(filter_)['missing_samples'] <= 1
    assert filter_.state['clock']['mean_rate'] == pytest.approx(rate, rel=0.003)


def test_a_bus_that_is_asked_every_8_ms_is_not_one_of_125_hz_with_losses():
    """A sensor of 100 Hz: four steps of 8, 8, 8 and 16 ms, and one in a hundred is lost as well."""
    random = np.random.default_rng(0)
    numbers = np.flatnonzero(random.random(6000) >= 0.01)
    stamps = START + 8 * MS * np.ceil(numbers * 10 / 8 + 1e-6).astype(np.int64)
    filter_ = Filter()
    found = missing_at(filter_, stamps)
    assert filter_.state['clock']['mean_period'] == pytest.approx(0.01, rel=0.01)
    assert found.sum() == pytest.approx((np.diff(numbers) - 1).sum(), abs=5)


@pytest.mark.parametrize('held_up', [0.02, 0.2, 0.6])
def test_a_driver_that_hangs_and_catches_up_has_lost_nothing(held_up):
    """All that was held up comes at once: what was counted is taken back."""
    stamps = regular(3000)
    for first in (1000, 2000):
        until = stamps[first] + int(held_up * 1e9)
        stamps = np.where(np.arange(3000) < first, stamps, np.maximum(stamps, until))
    filter_ = Filter()
    feed(filter_, stamps)
    counts = clock(filter_)
    assert (counts['gaps'], counts['missing_samples']) == (0, 0)
    assert filter_.state['clock']['mean_period'] == pytest.approx(0.01, rel=1e-4)


def test_a_gap_in_large_delays_is_predicted_through(random):
    """Delays of a third of a period on the mean: 0.2 s are far beyond them."""
    stamps, missing = lose(late(6000, 200, 1.5e-3, random), 0.0, random, (3000, 4500), 40)
    found = missing_at(Filter(), stamps)
    assert found[missing > 0].tolist() == pytest.approx([40, 40], abs=2)
    assert found.sum() == pytest.approx(80, abs=2)


def test_a_small_change_of_the_period_is_reported_but_does_not_change_the_filter():
    filter_ = Filter()
    feed(filter_, regular(2000))
    before = float(filter_.state['clock']['period'])
    feed(filter_, regular(4000, 10 * MS + 50_000, START + 2000 * 10 * MS))
    assert filter_.state['clock']['period'] == before
    assert filter_.state['clock']['mean_period'] == pytest.approx(0.01005, rel=1e-4)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(
    rate=st.floats(20.0, 1000.0),
    drift=st.floats(-1e-4, 1e-4),
    jitter=st.floats(0.0, 0.4),
    exponential=st.booleans(),
    loss=st.sampled_from([0.0, 0.002, 0.02]),
    seed=st.integers(0, 2**32 - 1),
)
def test_period_and_losses_are_those_of_hindsight(rate, drift, jitter, exponential, loss, seed):
    """The lower convex hull of all stamps, with the true places of the missing samples."""
    random = np.random.default_rng(seed)
    samples = np.arange(int(max(20 * rate, 2000)))
    delays = (
        np.maximum.accumulate(samples + random.exponential(0.2 * jitter + 1e-3, len(samples)))
        if exponential
        else samples + random.uniform(-jitter, jitter, len(samples))
    )
    seconds = delays / rate * (1.0 + drift * samples / len(samples))
    stamps, missing = lose(START + np.round(seconds * 1e9).astype(np.int64), loss, random)
    filter_, known = Filter(), int(max(4 * rate, 400))
    feed(filter_, stamps[:known])
    before = clock(filter_)['missing_samples']
    feed(filter_, stamps[known:], seed=2)
    found = clock(filter_)['missing_samples'] - before
    period = hull_period(np.cumsum(missing + 1) - 1.0, stamps)
    assert filter_.state['clock']['mean_period'] == pytest.approx(period, rel=0.002)
    assert found == pytest.approx(missing[known:].sum(), rel=0.02, abs=3)


def test_the_real_bursty_driver_has_no_gap():
    path = recorded(RECORDINGS / 'static_mpu6050_bursty')
    filter_ = Filter()
    feed(filter_, read_imu_arrays(path).stamps)
    assert clock(filter_) == QUIET
    assert filter_.state['clock']['period'] == pytest.approx(0.01007, rel=0.08)


def spread_evenly(measured, random):
    """Return the stamps of a driver that spreads what it reads evenly over the time since."""
    reads = measured[0] + np.cumsum(random.uniform(14.0, 26.0, len(measured))) * MS
    batch = np.searchsorted(reads, measured)
    stamps = []
    for k in np.unique(batch):
        last = reads[k - 1] if k > 0 else measured[0]
        count = np.count_nonzero(batch == k)
        stamps.append(last + (reads[k] - last) * np.arange(1, count + 1) / count)
    return np.concatenate(stamps)


def slewed(measured, random):
    """Return the stamps of a clock that runs 500 ppm fast, and is set by 30 ms in between."""
    seconds = measured - measured[0]
    return measured + 5e-4 * seconds + 30.0 * MS * (seconds > 40_000 * MS)


def in_steps(measured, random):
    """Return stamps in steps of 10 ms."""
    return measured // (10 * MS) * (10 * MS)


def as_measured(measured, random):
    return measured


@pytest.mark.slow
@pytest.mark.parametrize('rate', [100.0, 200.0, 400.0])
@pytest.mark.parametrize('stamps_of', [spread_evenly, slewed, in_steps, as_measured])
@pytest.mark.parametrize('drift', [0.0, -0.04])
def test_stamps_as_drivers_make_them_up_cost_nothing(rate, stamps_of, drift, random):
    """Neither in fast motion nor at rest, also where the sensor's rate drifts as it warms up."""
    n = round(60.0 * rate)
    nominal = np.arange(n) / rate
    measured = START + np.round((nominal + drift * nominal**2 / 120.0) * 1e9).astype(np.int64)
    moving = (nominal > 20.0) & (nominal < 50.0)
    truth = np.where(moving[:, None], fast_turn(n, rate), 0.0)
    noise = NOISE * random.standard_normal((n, 3))
    accelerations = GRAVITY + 0.02 * random.standard_normal((n, 3))
    accelerations[moving] += by_hand(random, 40.0, rate)[1][: moving.sum()]
    filter_: Any = Filter()
    stamps = stamps_of(measured, random).astype(np.int64)
    results = filter_.run(stamps, truth + noise, accelerations)
    error = results['angular_velocity'] - truth
    fast, resting = moving & (nominal > 21.0), (nominal > 10.0) & (nominal < 19.0)
    for part, largest in ((fast, 1.02), (resting, 0.3)):
        assert np.sqrt(np.mean(error[part] ** 2)) < largest * NOISE
    assert filter_.state['clock']['missing_samples'] < 0.01 * n
