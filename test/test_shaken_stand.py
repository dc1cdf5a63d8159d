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

"""The bias of a robot that says that it stands, and is shaken meanwhile."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gyro_drift_filter.accelerate import zeroed
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.bias.shaken_stand import (
    PARTS,
    SHAKEN_STAND,
    SKIPPED_PARTS,
    forget_stand,
    note_stand,
    stand_mean,
    variance_of_stand_mean,
)
from gyro_drift_filter.core.rest.records import REST, SEGMENT_BLOCKS
from gyro_drift_filter.messages.health import Health
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.simulation.bag import imu_message
from support.messages import START
from support.sensor import DEGREE, at_rest, by_hand

BIAS = np.array([0.5, -0.4, 1.0]) * DEGREE


def rocking(random, seconds):
    """Return rates and accelerations (n, 3) of a body that rocks at 1 Hz, as on soft tires."""
    rates, accelerations = at_rest(random, seconds)
    wave = np.sin(2 * np.pi * np.arange(len(rates)) / 100 + random.uniform(0.0, 6.0))[:, None]
    return rates + 0.02 * wave * [1.0, 0.6, 0.3], accelerations + 0.1 * wave * [0.6, 1.0, 0.0]


def driving(random, seconds):
    rates, accelerations = at_rest(random, seconds)
    turn, push = by_hand(random, seconds)
    return rates + turn, accelerations + push


def run_with_hints(filter_, rates, accelerations, moves, start=START):
    """Run, with a hint each half second: `moves` (n,), or None where the robot says nothing."""
    stamps = start + np.arange(len(rates)) * 10**7
    results = []
    for k in range(0, len(rates), 50):
        part = slice(k, k + 50)
        if moves is not None:
            filter_.hint(bool(moves[k]))
        results.append(filter_.run(stamps[part], rates[part], accelerations[part]))
    return np.concatenate(results)


def drives_and_stands(random, stand, moves_first):
    """Return rates, accelerations and whether it moves (n, 3): six drives of 20 s and stands."""
    parts = [(at_rest(random, 10), False)] if not moves_first else []
    for _ in range(6):
        parts += [(driving(random, 20), True), (rocking(random, stand), False)]
    rates, accelerations = (np.concatenate([part[0][i] for part in parts]) for i in (0, 1))
    return rates, accelerations, np.concatenate([np.full(len(p[0]), moves) for p, moves in parts])


@pytest.mark.slow
@pytest.mark.parametrize('moves_first', [False, True])
@pytest.mark.parametrize('stand', [13, 30])
def test_the_bias_is_that_of_stands_that_the_robot_tells_of(stand, moves_first, random):
    """It moves by 1 deg/s as it warms up. Nothing is still but the first stand, if at all."""
    rates, accelerations, moves = drives_and_stands(random, stand, moves_first)
    warmth = 1.0 - np.exp(-np.arange(len(rates)) / 100 / 120)
    truth = BIAS + np.outer(warmth, (0.2, -0.3, 1.0)) * DEGREE
    filter_: Any = Filter()
    results = run_with_hints(filter_, rates + truth, accelerations, moves)
    last = np.flatnonzero(moves[:-1] & ~moves[1:])[1:] + 100 * stand
    ends = last[last < len(rates)] - 1
    assert len(ends) >= 4
    assert np.abs(results['bias'] - truth)[ends].max() < 0.15 * DEGREE
    state = filter_.state['bias']
    deviation = np.sqrt(state['variance'] + state['process_noise'])
    assert (np.abs(results['bias'] - truth)[-1] < 4.0 * deviation).all()
    without_hints = run_with_hints(Filter(), rates + truth, accelerations, None)
    assert np.abs(without_hints['bias'] - truth)[ends[-1], 2] > 0.6 * DEGREE


@pytest.mark.slow
@pytest.mark.parametrize('delay', [0, 20])
def test_stops_between_drives_that_the_robot_tells_of_may_be_short(delay, random):
    """Of two seconds. What it says comes `delay` samples late; its samples show no drive then."""
    parts = [(at_rest(random, 10), False)]
    for _ in range(15):
        parts += [(driving(random, 20), True), (at_rest(random, 2), False)]
    rates, accelerations = (np.concatenate([part[0][i] for part in parts]) for i in (0, 1))
    moves = np.concatenate([np.full(len(part[0][0]), part[1]) for part in parts])
    truth = np.outer(1.0 - np.exp(-np.arange(len(rates)) / 100 / 240), (0.2, -0.3, 1.0)) * DEGREE
    filter_, errors = Filter(), []
    for k in range(0, len(rates), 4):
        filter_.hint(bool(moves[max(k - delay, 0)]))
        part = slice(k, k + 4)
        stamps = START + np.arange(k, k + 4) * 10**7
        results = filter_.run(stamps, (rates + truth)[part], accelerations[part])
        errors.append(results['bias'] - truth[part])
    lost = np.concatenate(errors).sum(axis=0) / 100
    assert np.abs(lost).max() < 60.0 * DEGREE  # 150 to 170 where such stops do not count


@pytest.mark.slow
@pytest.mark.parametrize('delay', range(36, 50))
def test_a_short_stop_ends_wherever_in_a_block_the_robot_says_so(delay, random):
    """`delay` samples behind its end; a block at 100 Hz has twelve or thirteen."""
    parts = [(at_rest(random, 10), False), (driving(random, 10), True)]
    parts += [(at_rest(random, 2), False), (driving(random, 5), True)]
    rates, accelerations = (np.concatenate([part[0][i] for part in parts]) for i in (0, 1))
    moves = np.concatenate([np.full(len(part[0][0]), part[1]) for part in parts])
    filter_: Any = Filter()
    before = 0
    for k in range(len(rates)):
        if k == 2000:
            before = filter_.state['bias']['segments'].item()
        filter_.hint(bool(moves[max(k - delay, 0)]))
        filter_.step(START + k * 10**7, rates[k], accelerations[k])
    assert filter_.state['bias']['segments'] == before + 1


def test_a_first_stand_in_which_it_is_shaken_shows_the_bias(random):
    filter_: Any = Filter()
    rates, accelerations = rocking(random, 13)
    run_with_hints(filter_, rates + BIAS, accelerations, np.zeros(len(rates), bool))
    np.testing.assert_allclose(filter_.state['bias']['bias'], BIAS, atol=0.1 * DEGREE)
    assert filter_.state['bias']['known']
    # The first rest corrects it, by no more than both are off.
    rates, accelerations = at_rest(random, 5, BIAS)
    run_with_hints(filter_, rates, accelerations, None, START + 13 * 10**9)
    np.testing.assert_allclose(filter_.state['bias']['bias'], BIAS, atol=0.05 * DEGREE)


def test_a_mean_beyond_the_largest_bias_is_told_until_the_stand_ends(random):
    """As that of a driver in deg/s is, or of a sensor that has broken."""
    filter_ = MessageFilter(Parameters())
    rates, accelerations = rocking(random, 14)
    for k, (rate, force) in enumerate(zip(rates + 20.0 * DEGREE, accelerations, strict=True)):
        filter_.filter.hint(moves=False)
        filter_.take(imu_message(START + k * 10**7, rate, force))
    report = filter_.report()
    assert not report.telemetry.bias_known
    assert report.telemetry.segments_beyond_max == 1
    _, judged = Health().judge(report, 14.0)
    assert 'beyond bias.max' in judged.message
    filter_.filter.hint(moves=True)
    filter_.take(imu_message(START + 14 * 10**9, rates[0], accelerations[0]))
    assert not filter_.report().telemetry.rest_beyond_max


def test_what_the_robot_does_before_it_stands_is_left_out(random):
    """Its commands end while it still rolls on for two seconds."""
    filter_: Any = Filter()
    rates, accelerations = rocking(random, 13)
    rates[:200, 2] += 0.3
    run_with_hints(filter_, rates + BIAS, accelerations, np.zeros(len(rates), bool))
    np.testing.assert_allclose(filter_.state['bias']['bias'], BIAS, atol=0.1 * DEGREE)


@pytest.mark.parametrize(
    'interrupt',
    [
        lambda filter_: filter_.reset(),
        lambda filter_: filter_.set_bias(BIAS, (1e-3, 1e-3, 1e-3)),
        lambda filter_: filter_.hint(moves=True),
        lambda filter_: None,  # a gap
    ],
)
def test_a_stand_that_is_interrupted_begins_anew(interrupt, random):
    """Not a mean of what was before and of what comes behind."""
    filter_: Any = Filter()
    run_with_hints(filter_, *at_rest(random, 10, BIAS), None)
    rates, accelerations = rocking(random, 8)
    stands = np.zeros(len(rates), bool)
    run_with_hints(filter_, rates + BIAS, accelerations, stands, START + 10 * 10**9)
    assert filter_.state['bias']['shaken_stand']['parts'] == 2
    interrupt(filter_)
    learned = filter_.state['bias']['segments'].item()
    rates, accelerations = rocking(random, 5)
    later = START + 3600 * 10**9
    run_with_hints(filter_, rates + BIAS, accelerations, stands[:500], later)
    assert filter_.state['bias']['shaken_stand']['parts'] == 1
    assert filter_.state['bias']['segments'] == learned


def test_a_bias_that_is_known_well_is_not_made_worse_by_what_shakes_a_gyroscope(random):
    """Which is off then by as much as on the drones of EuRoC that idle."""
    filter_: Any = Filter()
    run_with_hints(filter_, *at_rest(random, 120, BIAS), None)
    rates, accelerations = rocking(random, 14)
    stands = np.zeros(len(rates), bool)
    run_with_hints(filter_, rates + BIAS + 0.8e-3, accelerations, stands, START + 120 * 10**9)
    assert np.abs(filter_.state['bias']['bias'] - BIAS).max() < 0.4e-3


def test_no_mean_of_a_stand_is_lost_where_it_is_nearly_steady(random):
    """So little that the bias would be a provisional one without the hint."""
    filter_: Any = Filter()
    rates, accelerations = at_rest(random, 44)
    wave = np.sin(2 * np.pi * np.arange(len(rates)) / 100)[:, None]
    rates += 0.014 * wave * [1.0, 0.6, 0.3]
    accelerations += 0.1 * wave * [0.6, 1.0, 0.0]
    run_with_hints(filter_, rates + BIAS, accelerations, np.zeros(len(rates), bool))
    assert filter_.state['bias']['segments'] == 4


def test_a_robot_that_is_carried_away_while_its_wheels_stand_does_not_stand(random):
    """It is lifted and turned, slowly enough for a bias; a bias of so much would be learned."""
    filter_: Any = Filter()
    run_with_hints(filter_, *at_rest(random, 10, BIAS), None)
    before = filter_.state['bias']['bias'].copy()
    rates, accelerations = rocking(random, 40)
    turn = 3.0 * DEGREE * np.array([0.6, 0.0, 0.8])
    seconds = np.arange(len(rates)) / 100
    gravity = Rotation.from_rotvec(-np.outer(seconds, turn)).apply([0.0, 0.0, 9.81])
    accelerations += gravity - [0.0, 0.0, 9.81]
    stands = np.zeros(len(rates), bool)
    run_with_hints(filter_, rates + BIAS + turn, accelerations, stands, START + 10 * 10**9)
    np.testing.assert_allclose(filter_.state['bias']['bias'], before, atol=0.1 * DEGREE)


def test_a_rate_that_no_bias_has_is_counted_and_left(random):
    filter_: Any = Filter()
    run_with_hints(filter_, *at_rest(random, 10, BIAS), None)
    before = filter_.state['bias']['bias'].copy()
    rates, accelerations = rocking(random, 13)
    rates[:, 2] += 15.0 * DEGREE
    run_with_hints(filter_, rates, accelerations, np.zeros(len(rates), bool), START + 10 * 10**9)
    assert filter_.state['bias']['segments_beyond_max'] == 1
    np.testing.assert_allclose(filter_.state['bias']['bias'][2], before[2], atol=0.02 * DEGREE)


@pytest.mark.slow
@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), st.integers(0, 2**32))
def test_the_mean_is_that_of_its_blocks_and_as_certain_as_they_scatter(rate, seed):
    """Beside numpy, for two means one after the other."""
    random = np.random.default_rng(seed)
    stand, rest = zeroed(SHAKEN_STAND)[0], zeroed(REST)[0]
    forget_stand(stand)
    parts = SKIPPED_PARTS + 2 * PARTS
    blocks = np.array(rate) + 0.1 * random.standard_normal((parts, SEGMENT_BLOCKS, 3))
    found = []
    for block in blocks.reshape(-1, 3):
        rest['count'] = 2
        for axis in range(3):
            rest['signals'][axis]['sum'] = 2.0 * block[axis]
            rest['signals'][3 + axis]['sum'] = 2.0 * random.uniform(9.7, 9.9)
        found.append(note_stand(stand, rest))
        if found[-1]:
            k = len(found) // SEGMENT_BLOCKS
            means = blocks[k - PARTS : k].mean(axis=1)
            expected = (PARTS - 1) / (PARTS - 3) * means.var(axis=0, ddof=1) / PARTS
            for axis in range(3):
                assert stand_mean(stand, axis) == pytest.approx(means[:, axis].mean(), abs=1e-12)
                variance = variance_of_stand_mean(stand, axis)
                assert variance == pytest.approx(expected[axis], rel=1e-9)
    complete = [(SKIPPED_PARTS + k * PARTS) * SEGMENT_BLOCKS for k in (1, 2)]
    assert [k + 1 for k in np.flatnonzero(found)] == complete
