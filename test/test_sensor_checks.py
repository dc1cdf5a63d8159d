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

"""What hangs is told from what stands still, on one axis and on all, and teaches nothing."""

import numpy as np
import pytest

from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.sensor_checks import AxisFault
from gyro_drift_filter.messages.diagnostics import Level
from gyro_drift_filter.messages.health import Health
from gyro_drift_filter.messages.message_filter import MessageFilter
from support.sensor import at_rest, by_hand, fast_turn

RATE = 100.0
COARSE = np.radians(1.0)


def moved(random, seconds=60.0):
    """Return rates and accelerations (n, 3): rest at both ends, motion in the middle third."""
    rates, accelerations = at_rest(random, seconds, (0.01, -0.02, 0.005))
    third = len(rates) // 3
    motion, shake = by_hand(random, third / RATE)
    rates[third : 2 * third] += motion
    accelerations[third : 2 * third] += shake
    return rates, accelerations


def run(filter_, rates, accelerations, first=0):
    stamps = 10**18 + 10_000_000 * np.arange(first, first + len(rates))
    return filter_.run(stamps, rates, accelerations)


def stamped(rates, accelerations):
    return 10**18 + 10_000_000 * np.arange(len(rates)), rates, accelerations


def faults(filter_):
    return filter_.state['checks']['fault'].tolist()


@pytest.mark.parametrize('axis', range(3))
def test_an_axis_that_freezes_in_motion_is_told_and_teaches_nothing(axis, random):
    rates, accelerations = moved(random)
    rates[3000:, axis] = rates[3000, axis]
    filter_ = Filter()
    results = run(filter_, rates[:3200], accelerations[:3200])
    expected = [AxisFault.FROZEN if i == axis else AxisFault.NONE for i in range(3)]
    assert faults(filter_) == expected
    known = results['bias'][3100]
    results = run(filter_, rates[3200:], accelerations[3200:], 3200)
    np.testing.assert_array_equal(results['bias'][-1], known)
    assert not results['at_rest'].any()


def test_a_gyroscope_that_freezes_at_rest_is_told(random):
    """The accelerometer lives, and this sensor has noise, so that it can't be so still."""
    rates, accelerations = at_rest(random, 60.0)
    rates[3000:] = rates[3000]
    filter_ = Filter()
    run(filter_, rates, accelerations)
    assert filter_.state['checks']['stuck']
    assert filter_.state['checks']['times_stuck'] == 1
    fresh, more = at_rest(random, 5.0)
    run(filter_, fresh, more, 6000)
    assert not filter_.state['checks']['stuck']
    assert faults(filter_) == [AxisFault.NONE] * 3


def test_a_gyroscope_that_freezes_in_motion_is_told(random):
    rates, accelerations = by_hand(random, 20.0)
    rates[1000:] = rates[1000]
    filter_ = Filter()
    run(filter_, rates, accelerations)
    assert filter_.state['checks']['stuck']


def test_dead_axes_are_told_and_the_others_work(random):
    rates, accelerations = moved(random)
    rates[:, 1] = 0.0
    filter_ = Filter()
    results = run(filter_, rates, accelerations)
    assert faults(filter_) == [AxisFault.NONE, AxisFault.DEAD, AxisFault.NONE]
    assert not filter_.state['checks']['stuck']
    assert results['at_rest'][1900]
    assert abs(results['bias'][-1][0] - 0.01) < 1e-3
    assert abs(results['bias'][-1][2] - 0.005) < 1e-3


def test_a_coarse_gyroscope_that_stands_still_is_sound(random):
    """Its rates do not change for minutes, and it learns its bias."""
    rates, accelerations = moved(random, 120.0)
    rates = np.round((rates + 2.2 * COARSE) / COARSE) * COARSE
    filter_ = Filter()
    results = run(filter_, rates, accelerations)
    assert filter_.state['checks']['times_stuck'] == 0
    assert faults(filter_) == [AxisFault.NONE] * 3
    assert results['at_rest'][-1]


def test_a_motor_that_stops_is_no_fault(random):
    """What was noise with the motor on is gone from gyroscope and accelerometer at once."""
    rates, accelerations = at_rest(random, 120.0)
    loud = np.where(np.arange(len(rates)) < 6000, 1.0, 0.02)[:, None]
    rates = np.round(2.0 * loud * rates / COARSE) * COARSE
    accelerations = accelerations + loud * 0.5 * random.standard_normal(accelerations.shape)
    filter_ = Filter()
    results = run(filter_, rates, accelerations)
    assert filter_.state['checks']['times_stuck'] == 0
    assert faults(filter_) == [AxisFault.NONE] * 3
    assert results['at_rest'][-1]


def test_gravity_that_stands_without_a_rest_is_noted(random):
    """Rates that jump every second are no rest, whatever gravity says."""
    rates, accelerations = at_rest(random, 200.0)
    rates += np.repeat(0.1 * random.standard_normal((200, 3)), 100, axis=0)
    filter_ = Filter()
    run(filter_, rates, accelerations)
    assert filter_.state['bias']['rest']['standing_seconds'] > 150.0
    filter_ = Filter()
    run(filter_, rates, 0.0 * accelerations)
    assert filter_.state['bias']['rest']['standing_seconds'] == 0.0
    filter_ = Filter()
    run(filter_, *at_rest(random, 100.0))
    assert filter_.state['bias']['rest']['standing_seconds'] < 5.0


def lies_and_is_moved(random, seconds):
    """Return a sensor that lies for ten seconds and is then moved by hand, with gravity."""
    rates, accelerations = at_rest(random, 10.0, (0.01, -0.02, 0.005))
    motion, shake = by_hand(random, seconds)
    moving, gravity = at_rest(random, seconds, (0.01, -0.02, 0.005))
    return np.vstack([rates, moving + motion]), np.vstack([accelerations, gravity + shake])


@pytest.mark.parametrize('first', [0, 1500])
def test_an_accelerometer_that_hangs_tells_nothing_of_the_bias_in_motion(first, random):
    """The body turns, and gravity with it: what does not change by a bit is no acceleration."""
    rates, accelerations = lies_and_is_moved(random, 120.0)
    accelerations[first:] = accelerations[first]
    filter_ = Filter()
    results = run(filter_, rates, accelerations)
    assert filter_.state['checks']['accelerometer_hangs']
    hung = max(first, 1000) + 200
    assert np.ptp(results['bias'][hung:], axis=0).max() < 1e-6
    fresh, more = at_rest(random, 5.0)
    run(filter_, fresh, more, len(rates))
    assert not filter_.state['checks']['accelerometer_hangs']


def test_an_accelerometer_that_hangs_shows_no_bias_to_who_never_rests(random):
    rates, accelerations = by_hand(random, 120.0)
    rates[:, :2] += 0.01
    accelerations[:] = 0.0, 0.0, 9.81
    results = run(Filter(), rates, accelerations)
    np.testing.assert_allclose(results['bias'], 0.0, atol=1e-6)


def test_an_accelerometer_without_noise_does_not_hang(random):
    """A simulated robot stands, turns about the vertical, and stands; a tray tilts by 3 degrees."""
    rates, accelerations = at_rest(random, 60.0, (0.01, -0.02, 0.005))
    accelerations[:] = 0.0, 0.0, 9.81
    rates[1000:5000, 2] += 0.5
    tilt = np.radians(3.0) * np.sin(2 * np.pi * np.arange(1000) / 200.0)
    rates[5000:, 0] += np.gradient(tilt, 0.01)
    filter_ = Filter()
    for first in range(0, 6000, 100):
        run(filter_, rates[first : first + 100], accelerations[first : first + 100], first)
        assert not filter_.state['checks']['accelerometer_hangs']


def test_a_coarse_accelerometer_on_a_table_that_turns_does_not_hang(random):
    """Its axes are not quite those of the gyroscope, which adds up over whole turns to nothing."""
    rates, accelerations = at_rest(random, 60.0, (0.01, -0.02, 0.005))
    accelerations[:] = 0.0, 0.0, 9.81
    rates[1000:] += (
        2 * np.pi * np.array([0.02, 0.0, 1.0]) * np.minimum(np.arange(5000) / 200, 1)[:, None]
    )
    filter_ = Filter()
    run(filter_, rates, accelerations)
    assert not filter_.state['checks']['accelerometer_hangs']


@pytest.mark.parametrize('axes', [[0, 1, 2], [0]])
@pytest.mark.parametrize('value', [0.0, 0.01])
@pytest.mark.parametrize('moves', [False, True])
def test_what_a_device_sends_before_it_is_ready_is_no_rest(axes, value, moves, random):
    """The driver gives the same rates for some seconds, and the accelerometer is alive."""
    bias = np.array([0.02, -0.01, 0.03])
    rates, accelerations = at_rest(random, 60.0, bias)
    if moves:
        turn, push = by_hand(random, 20.0)
        rates[800:2800] += turn
        accelerations[800:2800] += push
    rates[:500, axes] = value
    filter_ = Filter()
    results = filter_.run(10**18 + 10_000_000 * np.arange(6000), rates, accelerations)
    assert np.abs(results['bias'][-1] - bias).max() < 1e-3
    assert results['at_rest'][3500:].mean() > 0.9
    still = slice(4000, 6000)
    noise = (results['angular_velocity'][still]).std(axis=0)
    assert (noise < 0.4 * rates[still].std(axis=0)).all()
    # Until the first rest of a living sensor the bias is no better known than at power-on.
    if axes == [0, 1, 2]:
        first = results[600]
        assert (np.sqrt(first['angular_velocity_variance']) > 0.02).all()


def test_a_bias_of_the_last_run_is_no_less_sure_for_the_first_samples(random):
    filter_ = Filter()
    filter_.set_bias((0.01, -0.02, 0.03), (1e-3, 1e-3, 1e-3))
    run(filter_, *at_rest(random, 1.0, (0.01, -0.02, 0.03)))
    assert (filter_.bias_deviation < 1.1e-3).all()


def test_an_axis_that_stays_at_the_end_of_its_range_is_not_said_to_hang(random):
    """A platform that spins faster than the gyroscope measures, for half a minute."""
    rates, accelerations = at_rest(random, 60.0)
    rates[:, 2] += np.interp(np.arange(6000), [1000, 1400, 5000, 5400], [0.0, 60.0, 60.0, 0.0])
    filter_ = MessageFilter(Parameters())
    filter_.filter.run(*stamped(np.clip(rates, -35.0, 35.0)[:3000], accelerations[:3000]))
    status = Health().judge(filter_.report()._replace(received=3000), 30.0)[0]
    assert status.level == Level.ERROR
    assert 'axis z' in status.message
    assert 'is at the end of the measuring range' in status.message


@pytest.mark.parametrize('wrong', [np.nan, np.inf, -np.inf])
def test_a_rate_behind_one_that_is_no_number_is_not_the_end_of_the_range(wrong, random):
    """Nobody knows whether it stays."""
    rates = np.concatenate([np.zeros((400, 3)), fast_turn(400, 100.0)])
    rates += 0.005 * random.standard_normal(rates.shape)
    rates[500::50, 0] = wrong
    filter_, ends = Filter(), []
    for k, rate in enumerate(rates):
        run(filter_, rate[None], np.array([[0.0, 0.0, 9.81]]), k)
        ends.append(filter_.state['checks']['range_end']['at_limit'].any())
    assert not any(ends)
    assert not filter_.state['checks']['range_end']['largest'].any()


def faster_and_faster(random):
    """Return 60 s of turns to and fro whose rates (n, 3) grow to 8 rad/s."""
    time = np.arange(6000) / RATE
    turns = np.sin(2 * np.pi * time[:, None] * [0.7, 0.9, 1.1])
    return 8.0 * np.clip(time / 50.0 - 0.2, 0.0, 1.0)[:, None] * turns + 0.005 * (
        random.standard_normal((6000, 3))
    )


def limits_met(filter_, rates, random):
    """Return (n, 3) True where a rate is said to be at the end of the range."""
    met = np.zeros(rates.shape, bool)
    forces = at_rest(random, len(rates) / RATE)[1]
    for k, (rate, force) in enumerate(zip(rates, forces, strict=True)):
        run(filter_, rate[None], force[None], k)
        met[k] = filter_.state['checks']['range_end']['at_limit']
    return met


@pytest.mark.parametrize('axes', [[0], [0, 1]])
def test_a_turn_in_which_an_axis_has_hung_is_not_at_the_end_of_the_range(axes, random):
    """A bus hangs for 60 ms while the body turns faster than ever; later it turns faster still."""
    rates = faster_and_faster(random)
    before = np.maximum.accumulate(np.abs(rates[:, 0]))
    fastest = (np.abs(rates[1:, 0]) > before[:-1]) & (before[:-1] > 1.5)
    hung = 1 + np.flatnonzero(fastest)[5::20]
    filter_, hangs = Filter(), np.zeros(len(rates), bool)
    for k in hung:
        rates[k + 1 : k + 6, axes] = rates[k, axes]
        hangs[k : k + 6] = True
    met = limits_met(filter_, rates, random)
    assert len(hung) > 5
    assert met[hangs].any()  # nobody can know while it hangs
    assert not met[~hangs].any()
    assert not filter_.state['checks']['range_end']['clipped'].any()  # faster rates followed


def test_a_rate_that_falls_does_not_meet_the_end_of_the_range(random):
    """Though the axis hangs on its way."""
    rates = faster_and_faster(random)
    falls = np.diff(np.abs(rates[:, 0])) < -0.02
    hung = 1 + np.flatnonzero(falls & (np.abs(rates[1:, 0]) > 2.0))[5::40]
    for k in hung:
        rates[k + 1 : k + 6, 0] = rates[k, 0]
    filter_ = Filter()
    assert len(hung) > 5
    assert not limits_met(filter_, rates, random).any()
    assert not filter_.state['checks']['range_end']['clipped'].any()


@pytest.mark.parametrize('bias', [0.0, 0.03, -0.03])
def test_each_side_has_its_own_end_of_the_range(bias, random):
    """A driver subtracts a bias, so that the ends are not alike; single outliers undo none."""
    rates = np.clip(faster_and_faster(random), -4.0, 4.0)
    clipped = np.abs(rates) == 4.0
    rates -= bias
    for k in np.flatnonzero(clipped[:-1, 0] & clipped[1:, 0])[::40]:
        rates[k, 0] *= 1.5
        clipped[k, 0] = False
    met = limits_met(Filter(), rates, random)
    assert clipped.sum() > 2000
    assert met[clipped].mean() > 0.99
    assert not met[~clipped].any()


def test_all_axes_may_meet_the_end_of_the_range_at_once(random):
    """Two do, and the third one a sample later: from then on the sensor repeats itself."""
    rates, _ = at_rest(random, 10.0)
    rates[500:] += np.interp(np.arange(500), [0, 100, 300, 400], [0, 14.0, 14.0, 0])[:, None]
    rates[:, 2] *= 0.97
    rates = np.clip(rates, -4.0, 4.0)
    clipped = np.abs(rates) == 4.0
    met = limits_met(Filter(), rates, random)
    assert clipped.all(axis=1).sum() > 200
    assert met[clipped.all(axis=1)].mean() > 0.98
    assert not met[~clipped].any()


def test_a_rate_that_a_body_has_passed_is_not_the_end_of_the_range():
    """At the top of a turn a coarse rate comes three times, and faster turns have been seen."""
    time = np.arange(3000) / 200.0
    size = np.where(time % 4.0 < 2.0, 20.0, 6.0)
    rates = np.outer(size * np.sin(2.0 * np.pi * time), [0.0, 1.0, 0.0])
    rates = np.round(rates / 0.05) * 0.05 + 1e-3 * (np.arange(3000) % 2)[:, None] * [1.0, 0.0, 1.0]
    tops = [k for k in range(600, 2990) if 5.9 < rates[k, 1] == rates[k - 1, 1] < 6.1]
    for top in tops:
        rates[top - 2 : top + 2, 1] = rates[top, 1]
        rates[top - 3, 1] = rates[top, 1] - 0.6
    filter_ = Filter()
    run(filter_, rates, np.tile([0.0, 0.0, 9.81], (len(rates), 1)))
    assert tops
    assert not filter_.state['checks']['range_end']['clipped'].any()
    assert not filter_.state['checks']['range_end']['at_limit'].any()
