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

"""Where a recording is motionless: simulated faults with known truth, and real recordings."""

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.identification import identify
from gyro_drift_filter.identify.quiet import SampleSpan, find_quiet
from gyro_drift_filter.identify.timing import Timing, learn_timing
from gyro_drift_filter.simulation.experiments import autoregressive
from support.messages import START

PERIOD = 0.01
NOISE = 0.005


def stamps_of(n, period=PERIOD):
    return START + np.round(np.arange(n) * period * 1e9).astype(np.int64)


def at_rest(random, seconds, noise=NOISE):
    n = round(seconds / PERIOD)
    rates = [0.01, -0.02, 0.005] + noise * random.standard_normal((n, 3))
    accelerations = [0.0, 0.0, 9.8] + 0.02 * random.standard_normal((n, 3))
    return stamps_of(n), rates, accelerations


def share(spans, n):
    return sum(map(len, spans)) / n


def share_of(spans, rates):
    return share(spans, len(rates))


def test_a_motionless_recording_is_one_span(random):
    stamps, rates, accelerations = at_rest(random, 600)
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    assert len(spans) == 1
    assert share(spans, len(rates)) > 0.97


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('phi', [0.2134, 0.9])
def test_correlated_noise_is_no_motion(phi, seed):
    random = np.random.default_rng(seed)
    stamps, rates, accelerations = at_rest(random, 200, 0.0)
    rates = rates + autoregressive(random, len(rates), phi, NOISE)
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    assert share(spans, len(rates)) > 0.9


def low_passed(random, seconds, rate, share, noise=0.006):
    """Return noise (n, 3) behind two first-order lags, as a sensor's own filter makes it."""
    out = noise * random.standard_normal((round(seconds * rate) + 1000, 3))
    for _ in range(2):
        out = lfilter([share], [1.0, share - 1.0], out, axis=0)
    return out[1000:]


PHONE = np.radians([2.0, -1.2, 0.7])  # bias


def phone(random, seconds, acceleration_noise=0.02):
    """Return a phone that lies still: 10 Hz, noise correlated over seconds."""
    rates = PHONE + low_passed(random, seconds, 10.0, 0.15)
    accelerations = acceleration_noise * random.standard_normal(rates.shape)
    return stamps_of(len(rates), 0.1), rates, np.array([0.3, -0.2, 9.8]) + accelerations


@pytest.mark.parametrize(('rate', 'share'), [(100, 0.45), (100, 0.1), (50, 0.15), (10, 0.45)])
def test_a_low_pass_in_the_sensor_is_no_motion(rate, share, random):
    rates = PHONE + low_passed(random, 300, rate, share)
    stamps = stamps_of(len(rates), 1.0 / rate)
    for acceleration_noise in (0.02, 0.0):
        accelerations = [0.3, -0.2, 9.8] + acceleration_noise * random.standard_normal(rates.shape)
        spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
        assert share_of(spans, rates) > 0.85


@pytest.mark.parametrize('noise', [0.02, 0.0])
def test_a_phone_that_lies_still_rests(noise, random):
    """By gravity, and without an accelerometer by angles that walk and do not come back."""
    stamps, rates, accelerations = phone(random, 600, noise)
    quiet = find_quiet(learn_timing(stamps), rates, accelerations if noise else 0 * accelerations)
    assert share_of(quiet.spans, rates) > 0.85


def test_a_phone_is_motionless_between_turns(random):
    stamps, rates, accelerations = phone(random, 600)
    moving = np.zeros(len(rates), bool)
    for k in range(1000, 6000, 1500):
        rates[k : k + 30, 0] += 0.7 * np.sin(np.linspace(0, np.pi, 30))
        moving[k : k + 30] = True
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    assert share_of(spans, rates) > 0.6
    assert not any(moving[span.first : span.stop].any() for span in spans)


@pytest.mark.parametrize(('angle', 'shown'), [(0.004, True), (0.02, False)])
def test_a_slow_sway_is_motion(angle, shown, random):
    """As slow as that noise; without an accelerometer it is told where it comes back visibly."""
    stamps, rates, accelerations = phone(random, 600, 0.005)
    drive = random.standard_normal((len(rates) + 1000, 3))
    angles = lfilter(*butter(3, [0.05, 0.12], 'bandpass', fs=10.0), drive, axis=0)[1000:]
    angles *= angle / angles.std()
    rates += np.gradient(angles, 0.1, axis=0)
    accelerations += np.cross([0.3, -0.2, 9.8], angles)
    accelerations = accelerations if shown else 0 * accelerations
    assert find_quiet(learn_timing(stamps), rates, accelerations).spans == ()


def test_slow_noise_on_one_axis_alone_is_motion(random):
    """About the vertical, where gravity tells nothing: a sensor's filter is on every axis."""
    stamps, rates, accelerations = at_rest(random, 300)
    rates[:, 2] = low_passed(random, 300, 100.0, 0.02, 0.1)[:, 2]
    assert find_quiet(learn_timing(stamps), rates, accelerations).spans == ()


@pytest.mark.slow
def test_counts_that_are_coarser_than_the_noise_hide_no_rest(random):
    """The mean of an axis that never changes is off by rounding, which is no smooth motion."""
    stamps, rates, accelerations = at_rest(random, 60)
    count = np.radians(4000.0 / 32768.0)
    counts = [3.52, -5.0, 0.25] + 0.12 * random.standard_normal(rates.shape)
    rates = count * np.round(counts)
    assert len(np.unique(rates[:, 1])) == 1
    assert share_of(find_quiet(learn_timing(stamps), rates, accelerations).spans, rates) > 0.97
    with pytest.raises(IdentificationError, match='axis z is too coarse'):
        identify(stamps, rates, accelerations)


def test_slow_noise_in_a_short_recording_is_an_open_question(random):
    stamps, rates, accelerations = phone(random, 40)
    with pytest.raises(IdentificationError, match=r'no rest can be told: .* lie still for ten min'):
        identify(stamps, rates, accelerations)


@pytest.mark.slow
def test_a_phone_is_identified(random):
    stamps, rates, accelerations = phone(random, 600)
    result = identify(stamps, rates, accelerations, orders=((1, 0), (2, 0)))
    for axis, bias in zip(result.axes, PHONE, strict=True):
        assert abs(axis.preprocessed.bias - bias) < 4 * axis.preprocessed.bias_deviation
        assert axis.deviation == pytest.approx(0.006 * 0.202, rel=0.2)


def test_warm_up_and_wander_are_no_motion(random):
    stamps, rates, accelerations = at_rest(random, 600)
    time = np.arange(len(rates)) * PERIOD
    rates[:, 0] += 0.02 * np.exp(-time / 120)
    rates[:, 1] += 0.003 * np.sin(2 * np.pi * time / 300)
    assert share(find_quiet(learn_timing(stamps), rates, accelerations).spans, len(rates)) > 0.97


def test_motion_is_left_out(random):
    stamps, rates, accelerations = at_rest(random, 120)
    time = np.arange(len(rates)) * PERIOD
    moving = (time > 50) & (time < 70)
    rates[moving, 0] += 0.1 * np.sin(2 * np.pi * 0.5 * time[moving])
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    assert len(spans) == 2
    assert spans[0].stop <= 5000 < 7000 <= spans[1].first
    assert share(spans, len(rates)) > 0.78


def test_a_knock_is_left_out(random):
    stamps, rates, accelerations = at_rest(random, 60)
    ring = 8 * NOISE * np.exp(-np.arange(20) / 6) * np.cos(np.arange(20))
    rates[3000:3020, 1] += 3 * ring
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    assert not any(span.first < 3020 and span.stop > 3000 for span in spans)
    assert share(spans, len(rates)) > 0.9


def test_a_knock_that_only_the_accelerometer_feels_is_left_out(random):
    stamps, rates, accelerations = at_rest(random, 60)
    accelerations[3000:3010, 2] += 1.0
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    assert not any(span.first < 3010 and span.stop > 3000 for span in spans)


def test_a_slow_turn_that_gravity_shows_is_left_out(random):
    """0.03 deg/s is a tenth of the noise of a sample and below what the rate's steps show."""
    stamps, rates, accelerations = at_rest(random, 180)
    turn = np.radians(0.03)
    turned = turn * np.clip(np.arange(len(rates)) - 6000, 0, 6000) * PERIOD
    rates[6000:12000, 0] += turn
    accelerations[:, 1] += 9.8 * np.sin(turned)
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    inside = sum(max(0, min(s.stop, 12000) - max(s.first, 6000)) for s in spans)
    assert inside < 600
    assert share(spans, len(rates)) > 0.5


@pytest.mark.parametrize(
    ('step', 'gravity', 'turns_not'),
    [
        ((0.3, 0.0, 0.0), 'stands', True),
        ((0.3, 0.0, 0.0), 'is not measured', False),
        ((0.0, 0.0, 0.3), 'stands', False),
        # About the vertical to what the axes of gyroscope and accelerometer are aligned.
        ((0.05, 0.0, 2.0), 'stands', False),
    ],
)
def test_a_bias_that_moves_is_told_from_a_turn_where_gravity_can(step, gravity, turns_not, random):
    """It was left out without a word. A turn about the vertical would not tilt gravity either."""
    stamps, rates, accelerations = at_rest(random, 200)
    moving = slice(8000, 9000)
    rates[moving] += random.standard_normal((1000, 3))
    rates[9000:] += np.radians(step)
    if gravity == 'is not measured':
        accelerations *= 0.0
    quiet = find_quiet(learn_timing(stamps), rates, accelerations)
    assert len(quiet.spans) == 1
    assert quiet.spans[0].first >= 9000
    (other,) = quiet.other_rates
    assert other.span.stop <= 8000
    assert len(other.span) > 7500
    np.testing.assert_allclose(other.step, -np.radians(step), atol=np.radians(0.03))
    assert other.turns_not == turns_not


@pytest.mark.slow
def test_of_a_bias_that_moves_the_deviation_tells(random):
    """The longest rest says what the bias was there, and not what it will be."""
    stamps, rates, accelerations = at_rest(random, 300)
    for k in (8000, 20000):
        rates[k : k + 1000] += random.standard_normal((1000, 3))
        rates[k + 1000 :, 0] += np.radians(0.5)
    found = identify(stamps, rates, accelerations)
    x, y, _ = (np.degrees(axis.preprocessed.bias_deviation) for axis in found.axes)
    assert 0.3 < x < 0.5
    assert y < 0.02
    (told,) = [text for text in found.warnings if 'left out' in text]
    assert told.startswith('2 spans without motion, ')
    assert 'deg/s: gravity stood, so the bias has moved; bias.initial is that of' in told


@pytest.mark.parametrize('shown', [True, False])
def test_a_constant_turn_between_rests_is_left_out(random, shown):
    """About the vertical, where only the rate tells; with and without an accelerometer."""
    stamps, rates, accelerations = at_rest(random, 180)
    rates[6000:9000, 2] += 0.02
    accelerations = accelerations if shown else np.zeros_like(accelerations)
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    assert len(spans) == 2
    assert spans[0].stop <= 6000 < 9000 <= spans[1].first


def test_isolated_outliers_are_tolerated(random):
    stamps, rates, accelerations = at_rest(random, 200)
    for axis in range(3):
        where = random.choice(len(rates), len(rates) // 200, replace=False)
        rates[where, axis] += random.choice([-1.0, 1.0], len(where))
    assert share(find_quiet(learn_timing(stamps), rates, accelerations).spans, len(rates)) > 0.85


def test_samples_that_are_not_finite_are_left_out_and_counted(random):
    stamps, rates, accelerations = at_rest(random, 100)
    where = random.choice(len(rates), 300, replace=False)
    rates[where, 0] = np.nan
    rates[4000:4400] = np.inf
    quiet = find_quiet(learn_timing(stamps), rates, accelerations)
    assert quiet.missing == (~np.isfinite(rates).all(axis=1)).sum()
    assert not any(span.first < 4350 and span.stop > 4050 for span in quiet.spans)
    assert share(quiet.spans, len(rates)) > 0.9


@pytest.mark.parametrize('nothing', [0.0, np.nan])
def test_without_an_accelerometer(nothing, random):
    stamps, rates, accelerations = at_rest(random, 100)
    quiet = find_quiet(learn_timing(stamps), rates, np.full_like(accelerations, nothing))
    assert not quiet.accelerometer
    assert share(quiet.spans, len(rates)) > 0.97


def test_a_gap_ends_a_span_and_a_burst_does_not(random):
    stamps, rates, accelerations = at_rest(random, 60)
    stamps[2000:] += 700_000_000
    for first in range(4000, 5000, 50):
        stamps[first : first + 50] = stamps[first + 49]
    quiet = find_quiet(learn_timing(stamps), rates, accelerations)
    assert list(quiet.spans) == [SampleSpan(0, 2000), SampleSpan(2000, 6000)]


@pytest.mark.parametrize('shown', [True, False])
def test_a_recording_in_motion_has_no_span(shown, random):
    stamps, rates, accelerations = at_rest(random, 60)
    time = np.arange(len(rates)) * PERIOD
    rates += 0.3 * np.sin(2 * np.pi * np.outer(time, [0.5, 0.7, 1.1]))
    accelerations += 2.0 * np.sin(2 * np.pi * 0.4 * time)[:, None]
    accelerations = accelerations if shown else np.zeros_like(accelerations)
    quiet = find_quiet(learn_timing(stamps), rates, accelerations)
    assert quiet.spans == ()
    assert quiet.longest is None or len(quiet.longest) < 500


def test_the_longest_stretch_is_told_where_none_is_long_enough(random):
    stamps, rates, accelerations = at_rest(random, 60)
    time = np.arange(len(rates)) * PERIOD
    moving = (time < 20) | (time > 26)
    rates[moving] += 0.3 * np.sin(2 * np.pi * np.outer(time[moving], [0.5, 0.7, 1.1]))
    quiet = find_quiet(learn_timing(stamps), rates, accelerations)
    assert quiet.spans == ()
    assert 2000 <= quiet.longest.first < quiet.longest.stop <= 2600
    with pytest.raises(IdentificationError, match=r'lasts 5 s: the longest is \d\.\d s, from 2\d'):
        identify(stamps, rates, accelerations)


@pytest.mark.parametrize('n', [0, 1, 5, 16, 99])
def test_few_samples_are_no_fault(n):
    timing = Timing(PERIOD, np.zeros(0, np.int64), np.zeros(0), 0.0)
    quiet = find_quiet(timing, np.zeros((n, 3)), np.zeros((n, 3)))
    assert quiet.spans == ()


def test_a_dead_axis_leaves_the_judgement_to_the_others(random):
    stamps, rates, accelerations = at_rest(random, 60)
    rates[:, 0] = 0.0
    rates[:, 1] = np.where(np.abs(rates[:, 1] + 0.02) < 2 * NOISE, 0.0, rates[:, 1] + 0.02)
    assert share(find_quiet(learn_timing(stamps), rates, accelerations).spans, len(rates)) > 0.9


@pytest.mark.parametrize('name', ['static_adis16405', 'static_mpu6050_bursty'])
def test_real_rest_is_essentially_one_span(name, real):
    stamps, rates, accelerations = real(name)
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    assert len(spans) == 1
    assert share(spans, len(rates)) > 0.99


@pytest.mark.parametrize(
    ('name', 'least'),
    [
        ('xio_fusion', 0.15),
        ('broad_24_tapping', 0.35),
        ('broad_09_fast_rotation_with_breaks', 0.3),
    ],
)
def test_of_real_motion_only_the_rests_are_used(name, least, real):
    stamps, rates, accelerations = real(name)
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    assert share(spans, len(rates)) > least
    for span in spans:
        within = rates[span.first : span.stop]
        assert (within.std(axis=0) < 0.003).all()
        assert (np.abs(within.mean(axis=0)) < 0.01).all()


def test_of_real_motion_alone_nothing_is_used(real):
    stamps, rates, accelerations = real('broad_24_tapping')
    moving = slice(len(rates) // 4, 3 * len(rates) // 4)
    timing = learn_timing(stamps[moving])
    assert find_quiet(timing, rates[moving], accelerations[moving]).spans == ()
