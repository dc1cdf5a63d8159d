"""Time: gaps, bursts, and stamps that go wrong."""

from typing import Any

import numpy as np
import pytest

from gyro_drift_filter.bags.imu_arrays import read_imu_arrays
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.sample import SampleStatus
from support.paths import RECORDINGS

MS = 1_000_000
START = 10**18
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
    assert filter_.state['counts']['repeats'] == 1
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


def bursts(n, size, period=10 * MS):
    """Samples taken evenly, handed over `size` at a time in steps of 0.2 periods."""
    block = np.arange(n) // size
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


def test_the_real_bursty_driver_has_no_gap():
    path = RECORDINGS / 'static_mpu6050_bursty'
    if not path.exists():
        pytest.skip('the real recording static_mpu6050_bursty is not beside this clone')
    filter_ = Filter()
    feed(filter_, read_imu_arrays(path).stamps)
    assert clock(filter_) == QUIET
    assert filter_.state['clock']['period'] == pytest.approx(0.01007, rel=0.08)
