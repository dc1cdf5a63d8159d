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

"""How strongly a sensor vibrates in motion, and how far its bias may be shifted by that."""

import numpy as np
import pytest

from gyro_drift_filter.accelerate import zeroed
from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.bias.vibration import (
    PERIOD_SECONDS,
    VIBRATION,
    WINDOW_SECONDS,
    interrupt_vibration,
    note_vibration,
)
from support.messages import even_stamps

PERIOD = 0.01


def calmest(values):
    """Return what NumPy finds in values (n, 6) for each whole period, (periods, 6)."""
    squares = np.diff(values, 3, axis=0) ** 2 / (1 + 9 + 9 + 1)
    window = round(WINDOW_SECONDS / PERIOD)
    windows = round(PERIOD_SECONDS / WINDOW_SECONDS)
    periods = len(squares) // (window * windows)
    whole = squares[: periods * window * windows]
    return whole.reshape(periods, windows, window, 6).mean(axis=2).min(axis=1)


def noted(state, values, seconds=PERIOD):
    """Return what is noted of values (n, 6) at the end of each period."""
    return [
        state['calmest'].copy()
        for value in values
        if note_vibration(state, value[:3] * seconds, value[3:] * seconds, seconds)
    ]


def test_the_calmest_window_of_each_period_counts(random):
    values = random.standard_normal((2000, 6)) * random.uniform(0.1, 2.0, (2000, 1))
    state = zeroed(VIBRATION)[0]
    found = noted(state, values)
    np.testing.assert_allclose(found, calmest(values)[: len(found)], rtol=1e-9)
    assert len(found) == 9


def test_what_came_before_an_interruption_does_not_count(random):
    values = random.standard_normal((1000, 6))
    state = zeroed(VIBRATION)[0]
    noted(state, 1e-3 * random.standard_normal((151, 6)))
    interrupt_vibration(state)
    np.testing.assert_allclose(noted(state, values)[0], calmest(values)[0], rtol=1e-9)


def test_differences_across_a_lost_sample_do_not_count(random):
    """The value that it was lost from is too long, and the motion goes on behind it."""
    state = zeroed(VIBRATION)[0]
    noted(state, 0.01 * random.standard_normal((5, 6)))
    noted(state, np.ones((1, 6)), 0.015)
    noted(state, 5.0 + 0.01 * random.standard_normal((4, 6)))
    assert state['differences'] == 3
    assert state['squares'].max() < 0.01


def test_long_values_show_no_vibration(random):
    """They are too far apart to tell it from motion."""
    assert not noted(zeroed(VIBRATION)[0], random.standard_normal((2000, 6)), 0.02)


def at_rest(random, seconds):
    """Return rates and accelerations (n, 3) of a quiet sensor at rest, at 200 Hz."""
    n = round(200.0 * seconds)
    accelerations = (0.0, 0.0, 9.81) + 0.01 * random.standard_normal((n, 3))
    return 1e-3 * random.standard_normal((n, 3)), accelerations


def flight(random, shaken, pushed, shift):
    """Return a rest of 10 s and 190 s in which the body rocks and is shaken, at 200 Hz.

    Rotors shake rates by `shaken` in rad/s and accelerations by `pushed` in m/s^2, and the bias in
    motion is another one by `shift` (3,) in rad/s.
    """
    still_rates, still_accelerations = at_rest(random, 10.0)
    time = np.arange(38_000) / 200.0
    tilt = 0.2 * np.sin(0.8 * time)
    rates = 1e-3 * random.standard_normal((len(time), 3)) + shift
    rates[:, 0] += np.gradient(tilt, time)
    # Of many frequencies, as their speeds change.
    rotors = random.standard_normal((len(time), 3))
    forces = 9.81 * np.column_stack([0.0 * tilt, np.sin(tilt), np.cos(tilt)])
    forces += pushed * rotors + 0.01 * random.standard_normal(forces.shape)
    rates += shaken * rotors
    return np.vstack([still_rates, rates]), np.vstack([still_accelerations, forces])


@pytest.mark.parametrize(
    ('shaken', 'pushed', 'follows'),
    [(0.02, 1.0, True), (0.02, 0.0, False), (0.0, 1.0, False), (0.0, 0.0, False)],
    ids=['motors', 'quick hand', 'road', 'smooth'],
)
def test_only_what_shakes_rates_and_accelerations_may_shift_the_bias(
    shaken, pushed, follows, random
):
    """The noise at rest lets the bias move by 1e-4 rad/s, and motors shift it by ten times that."""
    rates, accelerations = flight(random, shaken, pushed, (1.2e-3, -1.2e-3, 0.0))
    filter_ = Filter()
    filter_.run(even_stamps(len(rates), 200.0), rates, accelerations)
    found = np.array(filter_.bias_shift.shift)
    if follows:
        np.testing.assert_allclose(found, (1.2e-3, -1.2e-3, 0.0), atol=5e-4)
    else:
        assert np.abs(found).max() < 3e-4


def test_a_shift_that_motors_explain_is_kept_at_the_next_rest(random):
    """The vibration has ended by then. So it is in the next run, which begins at rest."""
    rates, accelerations = flight(random, 0.02, 1.0, (1.2e-3, -1.2e-3, 0.0))
    still = at_rest(random, 20.0)
    filter_ = Filter()
    stamps = even_stamps(len(rates) + len(still[0]), 200.0)
    filter_.run(stamps, np.vstack([rates, still[0]]), np.vstack([accelerations, still[1]]))
    kept = filter_.bias_shift
    np.testing.assert_allclose(kept.shift, (1.2e-3, -1.2e-3, 0.0), atol=4e-4)
    later = Filter()
    later.set_bias(np.zeros(3), (1e-3,) * 3, kept)
    later.run(stamps[: len(still[0])], *still)
    np.testing.assert_allclose(later.bias_shift.shift, kept.shift, atol=1e-4)
