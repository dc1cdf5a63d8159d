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

"""`gyro_drift calibrate` as a person meets it, and files of other programs."""

import json

import numpy as np
import pytest
import yaml
from matplotlib import image
from scipy.spatial.transform import Rotation

from gyro_drift_filter.calibrate.errors import CalibrationError
from gyro_drift_filter.calibrate.exchange import Noise, from_imu_tk, from_kalibr, to_kalibr
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC, imu_message
from gyro_drift_filter.simulation.turns import lay_down, random_faults, sides
from support.bags import write

MATRIX = np.array([[1.02, 0.01, -0.03], [0.004, 0.99, 0.02], [-0.02, 0.03, 1.015]])


def bag(path, turns):
    rows = zip(turns.stamps.tolist(), turns.rates, turns.accelerations, strict=True)
    return write(path, {(TOPIC, IMU_TYPE): [(t, imu_message(t, w, a)) for t, w, a in rows]})


def calibrate(tmp_path, *arguments):
    return main(['calibrate', *map(str, arguments), '-o', str(tmp_path / 'found.yaml')])


def test_a_bag_gives_a_parameter_file_that_replay_takes(tmp_path, capsys, random):
    faults = random_faults(random)
    source = bag(tmp_path / 'in', lay_down(random, sides(random), faults, rate=50.0))
    files = {name: tmp_path / name for name in ('found.json', 'figures', 'kalibr.yaml')}
    arguments = ['--json', files['found.json'], '--plot', files['figures']]
    assert calibrate(tmp_path, source, *arguments, '--kalibr', files['kalibr.yaml']) == 0
    printed = capsys.readouterr()
    assert 'rests: 12 on 12 sides, ' in printed.out
    assert 'what the turns leave open         before  after' in printed.out
    assert 'warning' not in printed.err
    found = np.reshape(read_parameters(tmp_path / 'found.yaml').calibration_matrix, (3, 3))
    np.testing.assert_allclose(found, faults.matrix, atol=2e-3)
    results = json.loads(files['found.json'].read_text())
    np.testing.assert_allclose(results['matrix'], found, atol=1e-9)
    assert len(results['after']['angles']) == len(results['legs']) == 11
    for path in sorted(files['figures'].iterdir()):
        assert path.name in ('closures.png', 'turns.png')
        assert image.imread(path)[..., :3].std() > 0.05
    kalibr = yaml.safe_load(files['kalibr.yaml'].read_text())['imu0']
    assert kalibr['gyroscope_noise_density'] == pytest.approx(np.radians(0.005), rel=0.7)
    assert kalibr['update_rate'] == pytest.approx(50.0, rel=1e-3)
    replayed = ['replay', str(source), '-o', str(tmp_path / 'out'), '--quiet']
    assert main([*replayed, '--params', str(tmp_path / 'found.yaml')]) == 0


def test_what_is_not_known_is_a_warning(tmp_path, capsys, random):
    poses = [Rotation.identity(), Rotation.from_rotvec([1.6, 0, 0]), Rotation.identity()]
    source = bag(tmp_path / 'in', lay_down(random, poses, random_faults(random), rate=50.0))
    assert calibrate(tmp_path, source) == 0
    told = capsys.readouterr().err
    assert 'warning: turn it about y, too: x against y is known to' in told
    assert '# Not known well: turn it about y, too' in (tmp_path / 'found.yaml').read_text()


def test_errors_are_one_line(tmp_path, capsys, random):
    turns = lay_down(random, sides(random)[:1], random_faults(random), rate=50.0)
    source = bag(tmp_path / 'in', turns)
    for arguments, message in (
        ([source], 'gyro_drift calibrate: the sensor was not turned: there is one rest only.'),
        ([source, '--reference', '/body'], 'no topic /body in the bag; with an orientation: '),
        ([source, '--start', '99'], 'with an angular velocity from 99'),
        ([tmp_path / 'none'], 'none'),
    ):
        assert calibrate(tmp_path, *arguments) == 1
        told = capsys.readouterr().err
        assert message in told
        assert told.count('\n') == 1
        assert not (tmp_path / 'found.yaml').exists()


NOISE = Noise(1e-4, 1e-6, 2e-3, 200.0)


@pytest.mark.parametrize('accelerometer', [None, np.triu(MATRIX)])
def test_kalibr_reads_what_is_written_for_it(accelerometer):
    text = to_kalibr(NOISE, '/imu', MATRIX, accelerometer)
    imu = yaml.safe_load(text)['imu0']
    measured, turned = (np.array(imu['gyroscopes'][name]) for name in ('M', 'C_gyro_i'))
    assert (np.triu(measured, 1) == 0.0).all()
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turned) == pytest.approx(1.0)
    np.testing.assert_array_equal(imu['Tw'], measured)
    np.testing.assert_array_equal(imu['R_IMUtoGYRO'], turned)
    acceleration = np.array(imu['accelerometers']['M'])
    assert (np.triu(acceleration, 1) == 0.0).all()
    # Both in the same axes, whatever these are: what gravity and a turn about it measure.
    found = from_kalibr(yaml.safe_load(text)).matrix
    of = np.eye(3) if accelerometer is None else accelerometer
    axes = np.linalg.inv(acceleration) @ np.linalg.inv(of)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-8)
    np.testing.assert_allclose(found, axes @ MATRIX, atol=1e-8)
    assert imu['gyroscope_noise_density'] == 1e-4
    assert 'accelerometer_random_walk: not known' in text


def test_a_file_of_kalibr_becomes_a_parameter_file(tmp_path):
    path = tmp_path / 'results-imu.yaml'
    path.write_text(to_kalibr(NOISE, '/imu', MATRIX))
    assert calibrate(tmp_path, path) == 0
    found = read_parameters(tmp_path / 'found.yaml').calibration_matrix
    np.testing.assert_allclose(np.reshape(found, (3, 3)), MATRIX, atol=1e-8)


def test_a_file_of_imu_tk_becomes_a_parameter_file(tmp_path, capsys):
    path, skew, scale = (
        tmp_path / 'gyro.calib',
        np.eye(3) + 0.01 * np.eye(3, k=1),
        [1.31, 1.3, 1.29],
    )
    parts = (skew, np.diag(scale), np.reshape([0.01, -0.02, 0.03], (3, 1)))
    path.write_text('\n\n'.join('\n'.join(' '.join(map(str, r)) for r in p) for p in parts))
    assert calibrate(tmp_path, path) == 0
    found = read_parameters(tmp_path / 'found.yaml')
    np.testing.assert_allclose(np.reshape(found.calibration_matrix, (3, 3)), skew * scale)
    assert found.bias_initial == (0.01, -0.02, 0.03)
    # Of raw counts: no calibration of a gyroscope that gives rad/s.
    path.write_text(path.read_text().replace('1.3', '0.0002'))
    (tmp_path / 'found.yaml').unlink()
    assert calibrate(tmp_path, path) == 1
    assert 'scales axis' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('read', 'content', 'message'),
    [
        (from_imu_tk, '1 2 3', '21 numbers, misalignment, scale and bias, not 3'),
        (from_imu_tk, 'gyro', 'something else than numbers'),
        (from_kalibr, {'imu0': {'rostopic': '/imu'}}, "no gyroscopes' M in the file"),
        (from_kalibr, None, "no gyroscopes' M in the file"),
        (from_kalibr, {'imu0': {'gyroscopes': {'M': [1, 2]}}}, 'M in the file is no matrix'),
        (from_kalibr, {'imu0': {'gyroscopes': {'M': [[0] * 3] * 3}}}, 'can not be inverted'),
    ],
)
def test_what_is_no_calibration_is_told(read, content, message):
    with pytest.raises(CalibrationError, match=message):
        read(content)
