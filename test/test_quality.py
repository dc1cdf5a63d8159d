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

"""Every bar of the quality benchmark as a regression test, on simulated motion with truth."""

import numpy as np
import pytest

pytest.importorskip('filterpy', reason="the benchmark's other filters are not installed")

from benchmark.candidates import package_method
from benchmark.quality import BARS, Bar, bars_at, falls_short, make_world, score

pytestmark = pytest.mark.slow


@pytest.mark.parametrize('rate', [50.0, 100.0, 400.0, 1000.0])
def test_every_bar(rate):
    world = make_world(rate, 0.005, 'autoregressive', seed=0)
    figures, bars = score(package_method('adaptive'), world), bars_at(rate)
    assert set(bars) <= set(figures)
    assert list(falls_short(figures, bars)) == []


@pytest.mark.parametrize(
    ('deviation', 'kind'), [(1e-4, 'white'), (1e-3, 'quantised'), (0.1, 'white')]
)
def test_sensors_from_good_to_poor(deviation, kind):
    """Nothing is tuned to a sensor: 1e-4 to 1e-1 rad/s, at 400 Hz."""
    figures = score(package_method('adaptive'), make_world(400.0, deviation, kind, seed=0))
    # In 0.1 rad/s of noise a turn of 0.5 deg/s is a tenth of it: what comes through of it is noisy.
    poor: dict[str, Bar] = {'slow.gain': (None, 0.6), 'motion.nis_move': (None, 1.9)}
    # In 1e-4 rad/s the lag of a slow turn stands out of the noise, and is given back at once.
    quiet: dict[str, Bar] = {'slow.rmse': (None, 0.42)}
    bars = BARS | {0.1: poor, 1e-4: quiet}.get(deviation, {})
    assert list(falls_short(figures, bars)) == []


def test_the_table_tells_the_papers_filters_from_the_default():
    """In motion the paper's filters are worse than nothing: why they are not the default."""
    world = make_world(100.0, 0.005, 'white', seed=0)
    moving = {
        method: np.median(score(package_method(method), world)['motion.move'])
        for method in ('kalman', 'sage_husa', 'adaptive')
    }
    assert moving['adaptive'] < 1.01
    assert min(moving['kalman'], moving['sage_husa']) > 10


def test_causal():
    """The same samples give the same output, whatever comes after them."""
    world = make_world(100.0, 0.005, 'white', seed=0)
    from benchmark.candidates import Recording
    from benchmark.scenarios import stamps

    trial = world.trials[0]
    rates = trial.truth + world.noise[: len(trial.truth)]
    whole, part = (
        package_method('adaptive')(
            Recording(stamps(n, 100.0), rates[:n], trial.acceleration[:n], 100.0, 0.005)
        ).rates
        for n in (len(rates), len(rates) // 2)
    )
    np.testing.assert_array_equal(whole[: len(part)], part)
