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

"""`gyro_drift tune`: an objective that can't be cheated, a search that finds, defaults kept."""

import io
import itertools
import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from gyro_drift_filter.bags.imu_arrays import read_imu_arrays
from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.cli.progress import Progress
from gyro_drift_filter.core import Filter, GyroDriftFilterError, Parameters
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import (
    TOPIC,
    imu_messages,
    read_truth,
    write_simulation,
)
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate
from gyro_drift_filter.tune import tuning
from gyro_drift_filter.tune.objective import Material, Objective
from gyro_drift_filter.tune.ranges import RANGES, at_places
from gyro_drift_filter.tune.search import TimeIsUpError
from gyro_drift_filter.tune.tuning import LEAST_GAIN, _Run, tune
from support.bags import write
from support.handling import HandlingSettings, simulate_handling
from support.paths import RECORDINGS, recorded

TURNING = SimulationSettings(seed=3, static_seconds=6.0, dynamic_seconds=6.0)


def material(simulation, truth=False):
    return Material(
        simulation.stamps,
        simulation.angular_velocity,
        simulation.linear_acceleration,
        simulation.truth if truth else None,
    )


def kalman(process_noise, measurement_noise=2.5e-5):
    return Parameters(
        method='kalman',
        epsilon=100.0,
        model_process_noise=(process_noise,) * 3,
        model_measurement_noise=(measurement_noise,) * 3,
    )


def handled(seconds=40.0):
    return simulate_handling(
        HandlingSettings(rest_seconds=seconds / 10.0, motion_seconds=seconds / 10.0, turning=0.5)
    )


def test_smoothing_motion_away_costs():
    """What looks best by the deviation at rest predicts motion worst."""
    simulation = handled()
    objective = Objective(material(simulation))
    smooth, right = kalman(1e-10), kalman(1e-4)
    still = slice(100, 400)

    def deviation(parameters):
        run = Filter(parameters).run(
            simulation.stamps, simulation.angular_velocity, simulation.linear_acceleration
        )
        return run['angular_velocity'][still].std(axis=0)

    assert (deviation(smooth) < deviation(right)).all()
    assert objective.costs(smooth).mean() > objective.costs(right).mean() + 1.0


@pytest.mark.parametrize('times', [0.1, 10.0])
def test_a_wrong_variance_costs(times):
    """Neither sureness nor modesty pays: the same gain, the same innovations, another variance."""
    simulation = simulate(SimulationSettings(static_seconds=30.0, dynamic_seconds=0.0))
    objective = Objective(material(simulation))
    right, wrong = kalman(1e-8, 3e-5), kalman(1e-8 * times, 3e-5 * times)
    assert (objective.costs(wrong) > objective.costs(right) + 0.1).all()


def test_a_spike_costs_no_more_than_a_spike():
    """However large: else the search would be for what spikes are left."""
    simulation = simulate(SimulationSettings(static_seconds=20.0, dynamic_seconds=0.0))
    costs = []
    for size in (1.0, 30.0):
        rates = simulation.angular_velocity.copy()
        rates[105::211] += size
        costs.append(
            Objective(Material(simulation.stamps, rates, simulation.linear_acceleration)).costs(
                Parameters()
            )
        )
    assert costs[1] == pytest.approx(costs[0], abs=0.01)


def test_lag_costs_what_noise_of_its_size_would():
    simulation = handled()
    objective = Objective(material(simulation))
    results = Filter().run(
        simulation.stamps, simulation.angular_velocity, simulation.linear_acceleration
    )
    part = slice(400, 800)  # a motion
    known = np.ones(400, bool)
    costs = []
    for samples in (0, 2, 4):
        late = results[part].copy()
        late['angular_velocity'] = simulation.angular_velocity[400 - samples : 800 - samples]
        costs.append(objective._lag(late, part, known))
    assert costs[0] < 0.01
    slopes = np.gradient(simulation.truth[part], axis=0)
    slopes[np.abs(slopes) < 5.0 * objective.noise] = 0.0
    for samples, cost in zip((2, 4), costs[1:], strict=True):
        expected = 0.5 * np.log1p((samples * slopes / objective.noise) ** 2).mean()
        assert cost == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
def test_near_the_best_of_a_fine_grid(monkeypatch):
    """Within 5 % of the smallest error on a grid, in a tenth of its evaluations."""
    ranges = RANGES['kalman'][:3]
    monkeypatch.setitem(RANGES, 'kalman', ranges)
    recording = material(simulate(TURNING), truth=True)
    found = tune(recording, Parameters(method='kalman'), budget=100)
    objective = Objective(recording)
    before = found.before
    grid = list(itertools.product(*3 * [np.linspace(0.0, 1.0, 12)]))
    errors = [
        objective.costs(at_places(ranges, place, before, objective.noise)).mean() for place in grid
    ]
    assert found.evaluations <= 0.1 * len(grid)
    reached = objective.costs(found.chosen).mean()
    assert np.sqrt(reached) <= 1.05 * np.sqrt(min(errors))
    assert np.sqrt(reached) < 0.7 * np.sqrt(objective.costs(before).mean())


@pytest.mark.slow
def test_good_defaults_are_kept():
    found = tune(material(handled()), Parameters(), budget=24)
    assert found.chosen == found.before == Parameters()
    assert not found.gain.is_worth_it
    assert {one.name for one in found.sensitivities} == {r.name for r in RANGES['adaptive']}
    for one in found.sensitivities:
        assert isinstance(one.chosen, (int, float))
        assert one.low is not None
        assert one.high is not None
        assert one.low <= one.chosen <= one.high


@pytest.mark.slow
@pytest.mark.parametrize('truth', [False, True])
def test_spikes_smaller_than_the_default_expects(truth, random):
    """On a body that can't turn so fast: found without truth as well as with it."""
    simulation = handled(60.0)
    for axis in range(3):
        where = random.choice(len(simulation.stamps) - 10, 60, replace=False) + 5
        simulation.angular_velocity[where, axis] += random.uniform(0.2, 0.6, 60)
    found = tune(material(simulation, truth=truth), Parameters(), budget=24)
    assert found.chosen.outlier_acceleration < 20.0
    assert found.gain.mean > 0.2
    assert found.sensitivities[0].name == 'outlier.acceleration'
    error = Objective(material(simulation, truth=True)).costs
    assert error(found.chosen).mean() < 0.1 * error(Parameters()).mean()


@pytest.mark.slow
def test_no_time_to_refine_leaves_the_best_that_is_known(monkeypatch):
    def nothing(*_):
        raise TimeIsUpError

    monkeypatch.setattr(tuning, 'downhill', nothing)
    found = tune(material(simulate(TURNING)), Parameters(method='kalman'), budget=40)
    assert found.gain.is_worth_it
    assert found.chosen != found.before


@pytest.mark.slow
def test_the_same_seed_finds_the_same():
    recording = material(simulate(TURNING))
    first, again = (tune(recording, Parameters(method='kalman'), budget=16) for _ in range(2))
    assert first.best == again.best
    assert first.gain == again.gain


@pytest.mark.parametrize('method', RANGES)
def test_time_limit_leaves_the_defaults(method):
    found = tune(material(handled()), Parameters(method=method), seconds=1e-6)
    assert found.out_of_time
    assert found.chosen == Parameters(method=method)
    assert found.evaluations == 1
    assert found.sensitivities[0].loss is None


@pytest.mark.parametrize(
    ('count', 'seconds', 'text'),
    [
        (999, 20.0, '999 samples in 20.0 s are too few'),
        (5000, 9.0, 'in 9.0 s are too few'),
        (5000, 9.99, 'in 9.9 s are too few'),
        (5000, -9.0, r'the stamps go back, by 9\.0 s from the first to the last: record again'),
    ],
)
def test_too_little_to_hold_back(count, seconds, text, random):
    stamps = np.linspace(1e18, 1e18 + seconds * 1e9, count).astype(np.int64)
    rates = random.standard_normal((count, 3))
    with pytest.raises(GyroDriftFilterError, match=text):
        Objective(Material(stamps, rates, rates))


def test_the_least_that_is_named_is_enough(random):
    """1000 samples at 100 Hz were refused, as from the first to the last it is 9.99 s."""
    rates = random.standard_normal((1000, 3))
    Objective(Material(10**18 + 10**7 * np.arange(1000), rates, rates))


@pytest.mark.parametrize(
    ('silent', 'text'),
    [((1,), 'no rate about y is a number'), ((0, 1, 2), 'no rate is a number of at most 1000000')],
)
def test_what_can_not_be_filtered_is_no_reason_to_keep_the_settings(silent, text, random):
    rates = random.standard_normal((2000, 3))
    rates[:, silent] = np.nan
    with pytest.raises(GyroDriftFilterError, match=text):
        Objective(Material(10**18 + 10**7 * np.arange(2000), rates, rates))


def test_dead_axes(random):
    stamps = 10**18 + 10**7 * np.arange(2000)
    rates = np.zeros((2000, 3))
    with pytest.raises(GyroDriftFilterError, match='the rates never change'):
        Objective(Material(stamps, rates, rates))
    rates[:, 1] = random.standard_normal(2000)
    for method in RANGES:
        objective = Objective(Material(stamps, rates, rates))
        before = Parameters(method=method)
        places = [range_.place(before, objective.noise) for range_ in RANGES[method]]
        parameters = at_places(RANGES[method], places, before, objective.noise)
        assert np.isfinite(objective.costs(parameters)).all()


@pytest.mark.parametrize('method', RANGES)
def test_ranges_hold_the_defaults_and_lead_back(method):
    noise = np.full(3, 0.005)
    before = Parameters(method=method)
    places = [range_.place(before, noise) for range_ in RANGES[method]]
    assert all(0.0 < place < 1.0 for place in places)
    there = at_places(RANGES[method], places, before, noise)
    for range_ in RANGES[method]:
        value = before.names()[range_.name]
        assert there.names()[range_.name] == pytest.approx(value, rel=1e-3), range_.name
    nothing = Parameters(method=method, outlier_acceleration=0.0)
    assert all(0.0 <= range_.place(nothing, noise) <= 1.0 for range_ in RANGES[method])
    for place in (0.0, 1.0):  # all within what parameters take
        at_places(RANGES[method], [place] * len(places), before, noise)


@pytest.fixture
def bag(tmp_path):
    write_simulation(tmp_path / 'bag', simulate(TURNING))
    return tmp_path / 'bag'


@pytest.mark.slow
def test_the_command(bag, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr('gyro_drift_filter.tune.tuning.BUDGET', 5)
    out, figures = tmp_path / 'out.yaml', tmp_path / 'out.json'
    options = ['--method', 'kalman', '--truth', '-o', str(out), '--json', str(figures)]
    assert main(['tune', str(bag), *options]) == 0
    printed = capsys.readouterr().out
    assert 'the error falls from' in printed
    assert 'model.process_noise' in printed
    result = json.loads(figures.read_text())
    assert (
        read_parameters(out).names()
        == Parameters.from_names(
            {
                name: result['chosen'][field]
                for field, name in zip(result['chosen'], Parameters().names(), strict=True)
            }
        ).names()
    )
    assert result['cost_best'] < result['cost_before']


def test_no_time_to_try_anything_is_told(bag, tmp_path, capsys):
    options = ['-o', str(tmp_path / 'out.yaml'), '--seconds', '0.001']
    assert main(['tune', str(bag), *options]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith('Nothing was tried: the time limit was up after the first run')
    assert '\n1 run of the filter\n' in printed


@pytest.mark.parametrize(
    ('rates', 'accelerations', 'text'),
    [
        (57.3, 1.0, 'the driver may publish degrees per second'),
        (1.0, 1 / 9.80665, 'linear acceleration is in g, not in m/s^2'),
        (1.0, 1.0, None),
    ],
)
def test_units_that_no_setting_makes_up_for_are_told(rates, accelerations, text, tmp_path, capsys):
    recording = simulate(TURNING)
    other = replace(
        recording,
        angular_velocity=rates * recording.angular_velocity,
        linear_acceleration=accelerations * recording.linear_acceleration,
    )
    write_simulation(tmp_path / 'bag', other)
    options = ['-o', str(tmp_path / 'out.yaml'), '--seconds', '0.001', '--quiet']
    assert main(['tune', str(tmp_path / 'bag'), *options]) == 0
    warnings = [w for w in capsys.readouterr().err.splitlines() if w.startswith('warning:')]
    assert text in warnings[0] if text else not warnings


def test_the_file_holds_what_it_started_from(bag, tmp_path):
    start, out = tmp_path / 'start.yaml', tmp_path / 'out.yaml'
    start.write_text(
        '/**: {ros__parameters: {bias.max: 0.27453292519943, sample_rate: 100, bias.memory: false}}'
    )
    options = ['--params', str(start), '--seconds', '0.001', '--quiet']
    assert main(['tune', str(bag), '-o', str(out), *options]) == 0
    assert read_parameters(out) == read_parameters(start)
    # As somebody would write it who goes on by hand.
    assert '    sample_rate: 100.0\n' in out.read_text()


def test_truth_on_a_topic(tmp_path, capsys):
    simulation = handled()
    stamps, forces = simulation.stamps, simulation.linear_acceleration
    true = imu_messages(stamps[100:], simulation.truth[100:], (0, 0, 9.8))
    raw = imu_messages(stamps, simulation.angular_velocity, forces)
    bag = write(tmp_path / 'bag', {('/true', IMU_TYPE): true, (TOPIC, IMU_TYPE): raw})
    options = ['--topic', TOPIC, '--truth', '/true', '--seconds', '0.001']
    assert main(['tune', str(bag), '-o', str(tmp_path / 'out.yaml'), *options]) == 0
    printed = capsys.readouterr()
    assert 'The time limit has cut it short' in printed.out
    # The truth of another recording that began at the same stamp would look like that, too.
    count = len(stamps)
    known = f'{count - 100} of {count} samples, from 1.000 to {(count - 1) / 100:.3f}'
    assert f'warning: the truth is known at {known} s, and only these are judged' in printed.err


@pytest.mark.parametrize(
    ('options', 'text'),
    [
        (['--truth', 'nothing.npz'], 'no truth in nothing.npz: '),
        (['--truth', '/nothing'], '/nothing'),
        (['--truth', TOPIC], f'--truth {TOPIC} is the topic that is tuned: name the one that'),
        (['--seconds', '0'], '--seconds must be greater than 0, not 0'),
        (['--seed', '-1'], '--seed must not be negative, not -1'),
        (['--end', '5'], 'are too few to tune by'),
    ],
)
def test_what_is_wrong_is_told(bag, tmp_path, capsys, options, text):
    assert main(['tune', str(bag), '-o', str(tmp_path / 'out.yaml'), *options]) == 1
    assert text in capsys.readouterr().err
    assert not (tmp_path / 'out.yaml').exists()


@pytest.mark.parametrize(
    ('make', 'text'),
    [
        (lambda path: path.touch(), 'it must be a numpy archive'),
        (lambda path: path.write_bytes(b'PK\x03\x04' + bytes(90)), 'it must be a numpy archive'),
        (lambda path: path.write_bytes(as_npy(np.zeros(3))), 'it must be a numpy archive'),
        (lambda path: np.savez(path, stamps=np.arange(2)), 'truth is not a file in the archive'),
        (lambda path: save(path, ['1', '2'], np.zeros((2, 3))), 'stamps must be whole numbers'),
        (lambda path: save(path, np.arange(2), np.zeros(2)), 'not float64 (2,)'),
        (lambda path: save(path, np.arange(2), np.zeros((2, 2))), 'not float64 (2, 2)'),
        (lambda path: save(path, np.arange(1), np.zeros((1, 3))), 'fewer than 2 samples'),
        (lambda path: save(path, np.arange(5), np.zeros((2, 3))), '5 stamps for 2 rates'),
    ],
)
def test_what_is_no_truth_is_told(tmp_path, make, text):
    path = tmp_path / 'truth.npz'
    make(path)
    with pytest.raises(BagError) as error:
        read_truth(path)
    assert str(error.value).startswith(f'no truth in {path}: ')
    assert text in str(error.value)


def as_npy(array):
    with io.BytesIO() as file:
        np.save(file, array)
        return file.getvalue()


def save(path, stamps, truth):
    np.savez(path, stamps=stamps, truth=truth)


def test_truth_of_another_time(bag, tmp_path, capsys):
    archive = tmp_path / 'truth.npz'
    np.savez(archive, stamps=np.array([1, 2]), truth=np.zeros((2, 3)))
    options = ['--truth', str(archive), '-o', str(tmp_path / 'out.yaml')]
    assert main(['tune', str(bag), *options]) == 1
    assert 'the truth is of another time than the samples' in capsys.readouterr().err


def test_progress_names_what_it_counts(capsys, monkeypatch):
    monkeypatch.setattr('gyro_drift_filter.cli.progress._LINE_SECONDS', 0.0)
    Progress(enabled=True, unit='runs of the filter')(3, 10)
    assert '30 % of 10 runs of the filter' in capsys.readouterr().err


def test_luck_is_not_worth_it():
    """One stretch that gains much outweighs nine that lose, in the mean."""
    run = _Run(Objective(material(simulate(TURNING))), None, Parameters(), math.inf)
    held_back = np.arange(20) < 10
    worse = np.zeros(20)
    lucky = run._gain(worse, np.where(np.arange(20) == 3, -10.0, 0.1), held_back)
    assert lucky.mean > LEAST_GAIN
    assert not lucky.is_worth_it
    assert run._gain(worse, np.full(20, -0.02), held_back).is_worth_it
    assert not run._gain(worse, np.full(20, -0.005), held_back).is_worth_it


def test_a_library_that_is_missing_is_named(bag, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, 'gyro_drift_filter.tune.objective', None)
    assert main(['tune', str(bag), '-o', str(tmp_path / 'out.yaml')]) == 1
    assert "install it with 'pip install scipy'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ('name', 'method', 'better'),
    [
        ('broad_24_tapping', 'adaptive', False),
        ('multiposition_xsens', 'kalman', True),
        ('xio_fusion', 'sage_husa', True),
    ],
)
def test_real_recordings(name, method, better):
    """No worse than the default on the stretches held back, and better where that is poor."""
    imu = read_imu_arrays(recorded(RECORDINGS / name))
    recording = Material(imu.stamps, imu.angular_velocity, imu.linear_acceleration)
    found = tune(recording, Parameters(method=method), budget=60)
    assert found.cost_best <= found.cost_before
    assert (found.cost_best < found.cost_before - LEAST_GAIN) == better


def test_a_method_of_which_nothing_is_tuned_is_refused(monkeypatch):
    monkeypatch.setattr('gyro_drift_filter.tune.tuning.RANGES', {})
    with pytest.raises(GyroDriftFilterError, match='no parameter of the method kalman is tuned'):
        tune(None, Parameters(method='kalman'))
