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

"""Counts that a sensor cuts towards zero are found and undone; others are left alone."""

from typing import Any

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from benchmark.scenarios import motion, stamps
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.quantisation import CERTAIN_VOTES
from gyro_drift_filter.rotations import (
    from_vectors,
    inverse,
    multiply,
    running_products,
    to_vectors,
)

RATE = 200.0
COUNT = np.radians(0.061)
BIAS = COUNT * np.array([2.9, -1.7, 0.8])


def dead_band(counts):
    return np.where(np.abs(counts) < 3.0, 0.0, np.trunc(counts))


WAYS: dict[str, Any] = {
    'trunc': np.trunc,
    'round': np.round,
    'floor': np.floor,
    'dead band': dead_band,
}


def recording(seconds, seed, way, noise=1.3):
    """Return stamps, rates in whole counts and accelerations, and the true rates."""
    random = np.random.default_rng(seed)
    trial = motion(seconds, RATE, random)
    n = len(trial.truth)
    rates = trial.truth + BIAS + noise * COUNT * random.standard_normal((n, 3))
    counts = WAYS[way](rates / COUNT) if way in WAYS else rates / COUNT
    return stamps(n, RATE), counts * COUNT, trial.acceleration, trial.truth


def turned(rates, truth):
    """Return the angle in deg between where the rates and where the true ones lead."""
    ends = [running_products(from_vectors(values / RATE))[-1] for values in (rates, truth)]
    return np.degrees(np.linalg.norm(to_vectors(multiply(inverse(ends[0]), ends[1]))))


def quantisation(filter_):
    return filter_.state['quantisation']


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(3))
def test_counts_that_are_cut_are_found_and_undone(seed):
    given = recording(480.0, seed, 'trunc')
    filter_ = Filter(Parameters())
    results = filter_.run(*given[:3])
    assert quantisation(filter_)['truncated']
    np.testing.assert_allclose(quantisation(filter_)['count'], COUNT, rtol=1e-6)
    # At rest the mean of cut values is off by up to half a count, which is gone.
    np.testing.assert_allclose(results['bias'][-1], BIAS, atol=0.2 * COUNT)


def at_rest(counts, seed=1):
    """Return stamps, rates and accelerations of a rest with such counts."""
    n = len(counts)
    force = 0.02 * np.random.default_rng(seed).standard_normal((n, 3))
    return stamps(n, RATE), counts * COUNT, np.array([0.0, 0.0, 9.81]) + force


def slow_noise(n, random, cutoff):
    """Return noise of deviation one behind a low-pass, `cutoff` in parts of the rate; 0.5 for none.

    It is of the second order.
    """
    white = random.standard_normal((n + 1000, 3))
    if cutoff < 0.5:
        white = lfilter(*butter(2, 2.0 * cutoff), white, axis=0)
    return white[1000:] / white[1000:].std(axis=0)


@pytest.mark.parametrize('cutoff', [0.5, 0.2])
@pytest.mark.parametrize('noise', [1.3, 3.0])
def test_counts_that_are_cut_are_found_in_the_first_rest(random, noise, cutoff):
    n = int(10 * RATE)
    values = BIAS / COUNT + noise * slow_noise(n, random, cutoff)
    filter_ = Filter()
    results = filter_.run(*at_rest(np.trunc(values)))
    assert quantisation(filter_)['truncated']
    # The bias is that of rates with half a count more, and as close as it says.
    away = np.abs(results['bias'][-1] - BIAS)
    assert (away < 0.1 * COUNT + 3.0 * filter_.bias_deviation).all()
    assert (filter_.bias_deviation < 0.25 * COUNT).all()
    assert results['at_rest'][int(3 * RATE) :].all()


@pytest.mark.slow
@pytest.mark.parametrize('way', ['round', 'floor', 'dead band', 'small dead band', 'none'])
@pytest.mark.parametrize('cutoff', [0.5, 0.05])
@pytest.mark.parametrize('noise', [0.5, 1.3, 5.0])
def test_no_rest_of_another_sensor_shows_a_cut(random, way, cutoff, noise):
    n = int(200 * RATE)
    filter_ = Filter()
    values = np.array([0.1, -0.7, 1.5]) + noise * slow_noise(n, random, cutoff)
    ways = WAYS | {
        'none': np.array,
        'small dead band': lambda x: np.where(np.abs(x) < 1.0, 0.0, np.round(x)),
    }
    filter_.run(*at_rest(ways[way](values)))
    assert not quantisation(filter_)['truncated']


def test_a_rest_that_shows_no_cut_is_looked_at_no_further(random):
    n = int(60 * RATE)
    filter_ = Filter()
    filter_.run(*at_rest(np.round(BIAS / COUNT + 1.3 * random.standard_normal((n, 3)))))
    found = quantisation(filter_)
    assert found['rest_has_told']
    assert not found['truncated']
    assert found['still']['samples'] == 0


def test_zeros_of_reads_that_fail_at_rest_are_no_cut(random):
    n = int(60 * RATE)
    counts = np.round(np.array([0.2, -0.3, 0.1]) + 1.3 * random.standard_normal((n, 3)))
    counts[random.random(n) < 0.3] = 0.0
    filter_ = Filter()
    filter_.run(*at_rest(counts))
    assert not quantisation(filter_)['truncated']


def test_what_a_rest_shows_changes_no_rates_unless_it_may(random):
    n = int(10 * RATE)
    given = at_rest(np.trunc(BIAS / COUNT + 1.3 * random.standard_normal((n, 3))))
    filter_ = Filter(Parameters(input_quantisation='none'))
    results = filter_.run(*given)
    assert quantisation(filter_)['truncated']
    np.testing.assert_allclose(results['bias'][-1], given[1].mean(axis=0), atol=0.1 * COUNT)


@pytest.mark.slow
@pytest.mark.parametrize('way', ['round', 'floor', 'dead band', 'none'])
@pytest.mark.parametrize('noise', [0.2, 1.3, 5.0])
def test_other_ways_are_told_from_it(way, noise):
    filter_ = Filter(Parameters())
    filter_.run(*recording(240.0, 7, way, noise)[:3])
    assert not quantisation(filter_)['truncated']


@pytest.mark.slow
def test_half_a_count_less_turns_the_heading():
    """With what is undone from the start the error is a part of that without."""
    given = recording(200.0, 5, 'trunc')
    errors = {}
    for mode in ('none', 'truncate'):
        rates = Filter(Parameters(input_quantisation=mode)).run(*given[:3])['angular_velocity']
        first = int(30 * RATE)  # behind the first rest, which has the bias
        errors[mode] = turned(rates[first:], given[3][first:])
    assert errors['truncate'] < 0.6 * errors['none']


@pytest.mark.slow
def test_only_auto_and_truncate_change_anything():
    given = recording(60.0, 3, 'trunc')[:3]
    runs = {
        mode: Filter(Parameters(input_quantisation=mode)).run(*given)
        for mode in ('auto', 'none', 'round', 'truncate')
    }
    np.testing.assert_array_equal(runs['none'], runs['round'])
    moved = np.abs(runs['truncate']['angular_velocity'] - runs['none']['angular_velocity'])
    assert moved.max() > 0.1 * COUNT


@pytest.mark.slow
def test_what_is_undone_is_the_middle_of_a_count():
    """Passed through as it is, in fast motion: half a count further from zero, zero itself not."""
    given = recording(120.0, 4, 'trunc')
    stamps_, rates, accelerations, _ = given
    before = rates.copy()
    filter_ = Filter(Parameters(input_quantisation='truncate', bias_enabled=False))
    innovations = filter_.run(stamps_, rates, accelerations)['innovation'][-1]
    np.testing.assert_array_equal(rates, before)  # what is the caller's is left alone
    plain = Filter(Parameters(input_quantisation='none', bias_enabled=False))
    other = plain.run(stamps_, rates, accelerations)['innovation'][-1]
    assert (innovations != other).any()
    np.testing.assert_array_equal(filter_.state['checks']['measured'], rates[-1])


@pytest.mark.slow
def test_zeros_of_a_sensor_with_nothing_to_report_are_no_evidence():
    stamps_, rates, accelerations, _ = recording(240.0, 6, 'round')
    random = np.random.default_rng(1)
    rates[random.choice(len(rates), 2000, replace=False)] = 0.0
    filter_ = Filter(Parameters())
    filter_.run(stamps_, rates, accelerations)
    assert not quantisation(filter_)['truncated']


def test_spikes_at_rest_are_no_evidence(random):
    """They come back to where the bias is, which may be zero."""
    n = 20_000
    rates = np.round(0.8 * random.standard_normal((n, 3))) * COUNT
    for axis in range(3):
        rates[random.choice(n, 400, replace=False), axis] += 0.3
    accelerations = np.array([0.0, 0.0, 9.81]) + 0.02 * random.standard_normal((n, 3))
    filter_ = Filter(Parameters())
    filter_.run(stamps(n, RATE), rates, accelerations)
    assert not quantisation(filter_)['truncated']


def test_a_bias_that_was_learned_before_the_count_was_known_is_as_unsure_as_half_a_count():
    """With little noise a rest shows one count or two, and motion later what they are worth."""
    stamps, rates, accelerations, _ = recording(60.0, 0, 'trunc', noise=0.1)
    filter_ = Filter(Parameters(input_quantisation='truncate'))
    deviations, known = [], []
    for i in range(0, len(stamps), 10):
        part = slice(i, i + 10)
        filter_.run(stamps[part], rates[part], accelerations[part])
        deviations.append(filter_.bias_deviation)
        known.append(np.sum(quantisation(filter_)['votes'] >= CERTAIN_VOTES))
    newly = [k for k in np.flatnonzero(np.diff(known)) if (deviations[k] < COUNT).all()]
    assert newly
    for k in newly:
        expected = np.hypot(deviations[k], 0.5 * COUNT)
        np.testing.assert_allclose(deviations[k + 1], expected, rtol=0.05)


def test_a_truncation_that_is_taken_back_makes_the_bias_as_unsure_as_half_a_count():
    stamps, rates, accelerations, _ = recording(60.0, 0, 'trunc')
    filter_ = Filter()
    filter_.run(stamps, rates, accelerations)
    state = quantisation(filter_)
    state['truncated'], state['wide_zero'] = True, 0.1
    before = filter_.bias_deviation
    # On the way through zero, one lands beside it.
    stamp = stamps[-1]
    for counts in (40, 20, 1):
        stamp += int(1e9 / RATE)
        filter_.run(np.array([stamp]), np.full((1, 3), counts * COUNT), accelerations[-1:])
    assert not state['truncated']
    np.testing.assert_allclose(filter_.bias_deviation, np.hypot(before, 0.5 * COUNT), rtol=0.05)


def test_a_bias_that_was_learned_the_other_way_is_as_unsure_as_half_a_count():
    """Where the cut of counts is undone from now on, or no longer, by a parameter."""
    stamps, rates, accelerations, _ = recording(60.0, 0, 'trunc')
    filter_ = Filter(Parameters(input_quantisation='none'))
    filter_.run(stamps, rates, accelerations)
    before = filter_.bias_deviation
    assert (before < 0.1 * COUNT).all()
    filter_.configure(filter_.parameters.with_names({'input.quantisation': 'round'}))
    np.testing.assert_array_equal(filter_.bias_deviation, before)
    filter_.configure(filter_.parameters.with_names({'input.quantisation': 'truncate'}))
    np.testing.assert_allclose(filter_.bias_deviation, np.hypot(before, 0.5 * COUNT), rtol=0.02)


def test_the_distance_of_two_sensors_that_took_turns_is_no_count_for_good(random):
    """As of a second driver on the topic, which is found and stopped after some seconds."""
    taking_turns, n = 1600, 6000
    rates = 2e-3 * random.standard_normal((n, 3))
    rates[1:taking_turns:2] += 0.09
    accelerations = np.array([0.0, 0.0, 9.81]) + 0.02 * random.standard_normal((n, 3))
    filter_, times = Filter(), stamps(n, RATE)
    filter_.run(times[:taking_turns], rates[:taking_turns], accelerations[:taking_turns])
    assert (quantisation(filter_)['votes'] >= CERTAIN_VOTES).all()
    np.testing.assert_allclose(quantisation(filter_)['count'], 0.09, rtol=0.1)
    alone = slice(taking_turns, n)
    results = filter_.run(times[alone], rates[alone], accelerations[alone])
    assert (quantisation(filter_)['votes'] < CERTAIN_VOTES).all()
    assert np.sqrt(results['angular_velocity_variance'][-1]).max() < 1e-3


def test_finer_counts_are_found_where_the_range_is_set_while_it_runs(random):
    """The counts of a smaller range are parts of the former one."""
    n = 12_000
    rates = 0.7 * COUNT * random.standard_normal((n, 3))
    counts = np.where(np.arange(n) < 4000, COUNT, COUNT / 4.0)[:, None]
    accelerations = np.array([0.0, 0.0, 9.81]) + 0.02 * random.standard_normal((n, 3))
    filter_, times = Filter(), stamps(n, RATE)
    for part in (slice(0, 4000), slice(4000, n)):
        filter_.run(times[part], np.round(rates / counts)[part] * counts[part], accelerations[part])
        np.testing.assert_allclose(quantisation(filter_)['count'] / counts[part][0], 1.0, rtol=1e-6)
