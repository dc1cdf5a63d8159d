"""`gyro_drift identify` as a person meets it."""

import json

import numpy as np
import pytest

from gyro_drift_filter.bags.simulated import TOPIC, imu_message
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.core.simulation import SimulationSettings, simulate
from test.conftest import RECORDINGS
from test.test_replay import IMU_TYPE, write


def bag(path, seconds=90.0, change=None):
    data = simulate(
        SimulationSettings(static_seconds=seconds, dynamic_seconds=0, white_deviation=1e-4)
    )
    rates = data.angular_velocity if change is None else change(data.angular_velocity.copy())
    return write(
        path,
        {
            (TOPIC, IMU_TYPE): [
                (stamp, imu_message(stamp, rate, acceleration))
                for stamp, rate, acceleration in zip(
                    data.stamps.tolist(), rates, data.linear_acceleration, strict=True
                )
            ]
        },
    )


def identify(tmp_path, source, *options):
    return main(['identify', str(source), '-o', str(tmp_path / 'model.yaml'), *options])


def test_a_motionless_recording_gives_a_parameter_file(tmp_path, capsys):
    source = bag(tmp_path / 'in')
    assert identify(tmp_path, source, '--json', str(tmp_path / 'model.json')) == 0
    printed = capsys.readouterr().out
    assert 'bias (deg/s)' in printed
    assert 'ARMA(1, 0) *' in printed
    parameters = read_parameters(tmp_path / 'model.yaml')
    assert parameters.sample_rate == pytest.approx(100.0, rel=1e-3)
    np.testing.assert_allclose(parameters.model_phi, 0.218, atol=0.04)
    np.testing.assert_allclose(parameters.model_noise_deviation, 0.0041, rtol=0.05)
    results = json.loads((tmp_path / 'model.json').read_text())
    biases = [axis['preprocessed']['bias'] for axis in results['axes']]
    np.testing.assert_allclose(biases, [0.01, -0.02, 0.005], atol=3e-4)
    arguments = ['--params', str(tmp_path / 'model.yaml'), '--method', 'kalman']
    assert main(['replay', str(source), '-o', str(tmp_path / 'out'), *arguments]) == 0


def test_noise_as_the_paper_takes_it(tmp_path):
    assert identify(tmp_path, bag(tmp_path / 'in'), '--noise', 'paper') == 0
    parameters = read_parameters(tmp_path / 'model.yaml')
    np.testing.assert_allclose(parameters.model_process_noise, 0.004**2, rtol=0.1)
    np.testing.assert_allclose(parameters.model_measurement_noise, 0.0041**2, rtol=0.1)


def test_a_short_rest_draws_a_warning(tmp_path, capsys):
    assert identify(tmp_path, bag(tmp_path / 'in'), '--end', '40') == 0
    assert 's of rest: the figures are rough below 60 s' in capsys.readouterr().err


def moving(rates):
    time = np.arange(len(rates)) / 100
    return rates + np.sin(time)[:, None]


def constant(rates):
    rates[:, 1] = 0.25
    return rates


def zero(rates):
    rates[:, 2] = 0.0
    return rates


@pytest.mark.parametrize(
    ('change', 'options', 'message'),
    [
        (moving, [], '20 s of rest are needed'),
        (None, ['--end', '10'], '20 s of rest are needed'),
        (constant, [], 'axis y'),
        (zero, [], 'axis z'),
        (None, ['--start', '500'], 'no sample between --start 500'),
    ],
)
def test_what_can_not_be_identified_is_said_in_one_line(change, options, message, tmp_path, capsys):
    assert identify(tmp_path, bag(tmp_path / 'in', change=change), *options) == 1
    printed = capsys.readouterr()
    assert message in printed.err
    assert printed.err.count('\n') == 1
    assert not (tmp_path / 'model.yaml').exists()


def test_a_file_that_exists_is_left_alone(tmp_path, capsys):
    (tmp_path / 'model.yaml').write_text('mine')
    assert identify(tmp_path, bag(tmp_path / 'in', seconds=5)) == 1
    assert 'exists already' in capsys.readouterr().err
    assert (tmp_path / 'model.yaml').read_text() == 'mine'


def test_nans_and_a_gap_are_bridged(tmp_path):
    def broken(rates):
        rates[1000::500] = np.nan
        return rates

    assert identify(tmp_path, bag(tmp_path / 'in', change=broken)) == 0


def test_a_real_recording(tmp_path, capsys):
    source = RECORDINGS / 'static_adis16405'
    if not source.exists():
        pytest.skip('the real recording static_adis16405 is not beside this clone')
    assert identify(tmp_path, source, '--json', str(tmp_path / 'model.json')) == 0
    axes = json.loads((tmp_path / 'model.json').read_text())['axes']
    biases = np.degrees([axis['preprocessed']['bias'] for axis in axes])
    np.testing.assert_allclose(biases, [0.401, -0.388, -0.276], atol=0.01)
    assert 0.15 < axes[0]['phi'] < 0.19
    for axis, at_100 in zip(axes, (19, 35, 37), strict=True):
        taus, deviations = axis['allan']['taus'], np.degrees(axis['allan']['deviations']) * 3600
        assert np.interp(1.0, taus, deviations) == pytest.approx(150, abs=20)
        assert np.interp(100.0, taus, deviations) == pytest.approx(at_100, abs=4)
    assert read_parameters(tmp_path / 'model.yaml').sample_rate == pytest.approx(100.0, rel=1e-3)
