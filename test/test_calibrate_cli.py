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
import re

import numpy as np
import pytest
import yaml
from matplotlib import image
from scipy.spatial.transform import Rotation

from gyro_drift_filter.calibrate import CalibrationError
from gyro_drift_filter.calibrate.exchange import Noise, from_imu_tk, from_kalibr, lacking, to_kalibr
from gyro_drift_filter.calibrate.rests import find_rests
from gyro_drift_filter.calibrate.track import make_track
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC, imu_messages
from gyro_drift_filter.simulation.turns import lay_down, random_faults, sides
from support.bags import write, write_imus
from support.messages import STORE

MATRIX = np.array([[1.02, 0.01, -0.03], [0.004, 0.99, 0.02], [-0.02, 0.03, 1.015]])


def bag(path, turns):
    return write_imus(path, turns.stamps, turns.rates, turns.accelerations)


def orientation_message(stamp, quaternion):
    """Return a serialized QuaternionStamped; stamp in ns."""
    types = STORE.types
    time = types['builtin_interfaces/msg/Time'](*divmod(int(stamp), 10**9))
    kind = 'geometry_msgs/msg/QuaternionStamped'
    message = types[kind](
        types['std_msgs/msg/Header'](time, 'body'),
        types['geometry_msgs/msg/Quaternion'](*map(float, quaternion)),
    )
    return bytes(STORE.serialize_cdr(message, kind))


def calibrate(tmp_path, *arguments):
    return main(['calibrate', *map(str, arguments), '-o', str(tmp_path / 'found.yaml')])


@pytest.mark.slow
def test_results_for_programs_take_the_place_of_the_text(tmp_path, capsys, random):
    source = bag(tmp_path / 'in', lay_down(random, sides(random), random_faults(random), rate=50.0))
    assert calibrate(tmp_path, source, '--json', '-', '--kalibr', tmp_path / 'kalibr') == 0
    assert json.loads(capsys.readouterr().out)['legs']
    assert (tmp_path / 'kalibr').exists()


def walk_and_delay(folder, turns, stamps, logged):
    """Calibrate by a bag with orientations; return the walk of the bias and how late these are."""
    imu = [data for _, data in imu_messages(stamps, turns.rates, turns.accelerations)]
    orientations = [
        (time, orientation_message(stamp, quaternion))
        for time, stamp, quaternion in zip(logged, stamps, turns.orientations, strict=True)
    ]
    topics = {
        (TOPIC, IMU_TYPE): zip(logged, imu, strict=True),
        ('/body', 'geometry_msgs/msg/QuaternionStamped'): orientations,
    }
    source = write(folder / 'in', topics)
    arguments = ['--reference', '/body', '--json', folder / 'found.json']
    assert calibrate(folder, source, *arguments, '--kalibr', folder / 'kalibr') == 0
    kalibr = yaml.safe_load((folder / 'kalibr').read_text())
    found = json.loads((folder / 'found.json').read_text())
    return kalibr['gyroscope_random_walk'], found['reference']['late']


@pytest.fixture(scope='module')
def even(tmp_path_factory):
    """Turns, their stamps, and walk and delay by a clock that goes evenly."""
    random = np.random.default_rng(20170)
    turns = lay_down(random, sides(random), random_faults(random), rate=50.0)
    stamps = turns.stamps - turns.stamps[0] + 10**11
    folder = tmp_path_factory.mktemp('even')
    return turns, stamps, walk_and_delay(folder, turns, stamps, stamps.tolist())


@pytest.mark.slow
@pytest.mark.parametrize(
    ('seconds', 'of_both'),
    [(3600, False), (1_700_000_000, False), (1_700_000_000, True)],
    ids=['by an hour', 'from 1970', 'from 1970 with the log times'],
)
def test_time_goes_on_where_a_clock_was_set_forward(seconds, of_both, even, tmp_path):
    """The walk of the bias came out as if it had taken half a century, 4000 times too small."""
    turns, stamps, (walk, delay) = even
    track = make_track(stamps, turns.rates, turns.accelerations)
    rest = find_rests(track).rests[4]
    later = stamps.copy()
    later[(rest.first + rest.stop) // 2 :] += seconds * 10**9
    logged = (later if of_both else stamps).tolist()
    walk_then, delay_then = walk_and_delay(tmp_path, turns, later, logged)
    assert walk_then == pytest.approx(walk, rel=0.2)
    assert delay_then == pytest.approx(delay, abs=1e-3)


@pytest.mark.slow
def test_a_bag_gives_a_parameter_file_that_replay_takes(tmp_path, capsys, random):
    faults = random_faults(random)
    source = bag(tmp_path / 'in', lay_down(random, sides(random), faults, rate=50.0))
    files = {name: tmp_path / name for name in ('found.json', 'figures', 'kalibr.yaml')}
    arguments = ['--json', files['found.json'], '--plot', files['figures']]
    assert calibrate(tmp_path, source, *arguments, '--kalibr', files['kalibr.yaml']) == 0
    printed = capsys.readouterr()
    assert 'rests: 12 on 12 sides, ' in printed.out
    assert 'by how much gravity is missed     before  after' in printed.out
    assert 'warning' not in printed.err
    found = np.reshape(read_parameters(tmp_path / 'found.yaml').calibration_matrix, (3, 3))
    np.testing.assert_allclose(found, faults.matrix, atol=2e-3)
    results = json.loads(files['found.json'].read_text())
    np.testing.assert_allclose(results['matrix'], found, atol=1e-9)
    assert results['noise'].keys() == set(Noise._fields)
    assert len(results['after']['angles']) == len(results['legs']) == 11
    for path in sorted(files['figures'].iterdir()):
        assert path.name in ('closures.png', 'turns.png')
        assert image.imread(path)[..., :3].std() > 0.05
    assert 'the file for Kalibr has no accelerometer_random_walk. ' in printed.err
    assert re.search(r'the least known entry is .+: known to 0\.0\d+ %', printed.out)
    kalibr = yaml.safe_load(files['kalibr.yaml'].read_text())
    assert kalibr['rostopic'] == TOPIC
    assert kalibr['gyroscope_noise_density'] == pytest.approx(np.radians(0.005), rel=0.7)
    assert kalibr['update_rate'] == pytest.approx(50.0, rel=1e-3)
    replayed = ['replay', str(source), '-o', str(tmp_path / 'out'), '--quiet']
    assert main([*replayed, '--params', str(tmp_path / 'found.yaml')]) == 0


def test_what_is_not_known_is_a_warning(tmp_path, capsys, random):
    poses = [Rotation.from_rotvec([k * np.pi / 2, 0, 0]) for k in range(5)]
    source = bag(tmp_path / 'in', lay_down(random, poses, random_faults(random), rate=50.0))
    assert calibrate(tmp_path, source) == 3
    printed = capsys.readouterr()
    assert 'warning: turn it about y, too: x against y is known to' in printed.err
    assert re.search('the least known entry is .+: known to 3', printed.out)
    assert '# Not known well: turn it about y, too' in (tmp_path / 'found.yaml').read_text()


def test_errors_are_one_line(tmp_path, capsys, random):
    turns = lay_down(random, sides(random)[:1], random_faults(random), rate=50.0)
    source = bag(tmp_path / 'in', turns)
    for arguments, message in (
        ([source], 'gyro_drift calibrate: the sensor was not turned: there is one rest only.'),
        (
            [source, '--reference', '/body'],
            'no topic /body in the bag; of a type that has an orientation: ',
        ),
        ([source, '--start', '99'], 'with an angular velocity from 99'),
        ([tmp_path / 'none'], 'none'),
    ):
        assert calibrate(tmp_path, *arguments) == 1
        told = capsys.readouterr().err
        assert message in told
        assert told.count('\n') == 1
        assert not (tmp_path / 'found.yaml').exists()


@pytest.mark.parametrize('accelerometer', [True, False])
def test_turns_without_whole_turns_are_told(accelerometer, tmp_path, capsys, random):
    """Else the option would seem to have been of use."""
    turns = lay_down(random, sides(random), random_faults(random), rate=50.0)
    forces = turns.accelerations if accelerometer else np.zeros_like(turns.accelerations)
    source = write_imus(tmp_path / 'in', turns.stamps, turns.rates, forces)
    assert calibrate(tmp_path, source, '--turns') == 1
    assert '--turns says that the sensor was turned by whole turns' in capsys.readouterr().err
    assert not (tmp_path / 'found.yaml').exists()


def test_a_rate_that_can_be_none_is_told(tmp_path, capsys, random):
    turns = lay_down(random, sides(random)[:1], random_faults(random), rate=50.0)
    turns.rates[:, 2] = 1e300
    assert calibrate(tmp_path, bag(tmp_path / 'in', turns)) == 1
    note, told = capsys.readouterr().err.splitlines()
    assert f'{len(turns.rates)} samples with a rate beyond 1000000 rad/s, which no' in note
    assert 'no rate about z is a number of at most 1000000 rad/s' in told


def test_a_recording_does_not_count_twice(tmp_path, capsys, random):
    """Twice the same turns would seem to be known better than they are."""
    turns = lay_down(random, sides(random)[:1], random_faults(random), rate=50.0)
    source = bag(tmp_path / 'in', turns)
    (file,) = source.glob('*.mcap')
    (tmp_path / 'link').symlink_to(source)
    (tmp_path / 'loop').symlink_to('loop')
    for bags, message in (
        ([source, source], 'in is named twice: name it once'),
        ([source, tmp_path / 'link'], 'link is named twice: name it once'),
        ([source, file], f'{file} is part of {source}, which is named, too: name one of them'),
        ([file, source], f'{file} is part of {source}, which is named, too: name one of them'),
        ([tmp_path / 'loop', tmp_path / 'none'], 'no such bag: '),
    ):
        assert calibrate(tmp_path, *bags) == 1
        told = capsys.readouterr().err
        assert message in told
        assert told.count('\n') == 1


NOISE = Noise(1e-4, 1e-6, 2e-3, 200.0)


def openvins(text):
    """Return what OpenVINS reads: VioManagerOptions.h, StateOptions.h and opencv_yaml_parse.h."""
    # OpenCV knows YAML by this.
    assert text.startswith('%YAML')
    imu = yaml.safe_load(text)['imu0']
    assert imu['model'] in ('kalibr', 'calibrated', 'rpng')
    tw, ta, to_gyro, to_acc, tg = (
        np.array(imu[name]) for name in ('Tw', 'Ta', 'R_IMUtoGYRO', 'R_IMUtoACC', 'Tg')
    )

    def columns(inverse):  # of the lower triangle, as `vec_dw` holds it and `State::Dm` reads it
        v = [*inverse[:, 0], *inverse[1:, 1], inverse[2, 2]]
        return np.array([[v[0], 0, 0], [v[1], v[3], 0], [v[2], v[4], v[5]]])

    dw, da = columns(np.linalg.inv(tw)), columns(np.linalg.inv(ta))

    def propagated(wm, am):  # Propagator.cpp, the biases off
        acceleration = to_acc.T @ da @ am
        return to_gyro.T @ dw @ (wm - tg @ acceleration), acceleration

    return propagated


@pytest.mark.parametrize('accelerometer', [None, np.triu(MATRIX)])
def test_kalibr_and_openvins_read_what_is_written_for_them(accelerometer, random):
    sensitivity = 1e-3 * random.standard_normal((3, 3))
    text = to_kalibr(NOISE, '/imu', MATRIX, accelerometer, sensitivity)
    imu = yaml.safe_load(text)['imu0']
    m, c, a = (np.array(imu['gyroscopes'][name]) for name in ('M', 'C_gyro_i', 'A'))
    ma = np.array(imu['accelerometers']['M'])
    for lower in (m, ma):
        assert (np.triu(lower, 1) == 0.0).all()
    np.testing.assert_allclose(c @ c.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(c) == pytest.approx(1.0)
    # Of a rate and an acceleration in the axes of the IMU, what Kalibr says that is measured:
    # addAccelerometerErrorTerms and addGyroscopeErrorTerms of IccScaledMisalignedImu.
    rate, force = random.standard_normal(3), 9.0 * random.standard_normal(3)
    am = ma @ force
    wm = m @ (c @ rate) + a @ (c @ force)
    np.testing.assert_allclose(openvins(text)(wm, am), (rate, force), atol=1e-7)
    # And what this package makes of it, in axes that are turned to those.
    of = np.eye(3) if accelerometer is None else accelerometer
    axes = np.linalg.inv(ma) @ np.linalg.inv(of)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-8)
    np.testing.assert_allclose(axes @ (MATRIX @ (wm - sensitivity @ am)), rate, atol=1e-7)
    np.testing.assert_allclose(axes @ (of @ am), force, atol=1e-7)


@pytest.mark.parametrize('matrix', [None, MATRIX])
def test_kalibr_finds_the_noise_at_the_top(matrix):
    """As ImuParameters of ConfigReader.py, which takes nothing but numbers above zero."""
    top = yaml.safe_load(to_kalibr(NOISE, '/imu', matrix))
    assert (top['rostopic'], top['update_rate']) == ('/imu', 200)
    names = 'gyroscope_noise_density', 'gyroscope_random_walk', 'accelerometer_noise_density'
    assert [top[name] for name in names] == [1e-4, 1e-6, 2e-3]
    assert {name: top['imu0'][name] for name in names} == {name: top[name] for name in names}
    for unknown in (None, 0.0):
        noise = NOISE._replace(rate_walk=unknown)
        text = to_kalibr(noise, '/imu', matrix)
        assert 'gyroscope_random_walk' not in yaml.safe_load(text)
        assert 'gyroscope_random_walk: not known' in text
        assert 'no accelerometer_random_walk and no gyroscope_random_walk. ' in lacking(noise)
    rate = np.array([0.1, 0.2, 0.3])
    if matrix is None:  # OpenVINS needs all, and nothing is known
        np.testing.assert_array_equal(openvins(text)(rate, rate), (rate, rate))


def test_a_file_of_kalibr_becomes_a_parameter_file(tmp_path):
    path = tmp_path / 'results-imu.yaml'
    path.write_text(to_kalibr(NOISE, '/imu', MATRIX))
    assert calibrate(tmp_path, path) == 0
    found = read_parameters(tmp_path / 'found.yaml').calibration_matrix
    np.testing.assert_allclose(np.reshape(found, (3, 3)), MATRIX, atol=1e-8)


def test_what_a_calibration_is_not_turned_into_is_told(tmp_path, capsys):
    source = tmp_path / 'imu.yaml'
    source.write_text('a: 1')
    output = tmp_path / 'p.yaml'
    arguments = ['-o', str(output), '--json', str(tmp_path / 'r.json'), '--end', '9', '--turns']
    assert main(['calibrate', str(source), *arguments]) == 1
    assert 'leave out --json, --end, --turns' in capsys.readouterr().err
    assert not output.exists()
    binary = tmp_path / 'gyro.calib'
    binary.write_bytes(b'\xff\xfe')
    assert main(['calibrate', str(binary), '-o', str(output)]) == 1
    assert f'{binary} is no text in UTF-8\n' in capsys.readouterr().err
    source.write_text('[' * 1000)  # of many more, the scanner alone takes seconds
    assert main(['calibrate', str(source), '-o', str(output)]) == 1
    assert f'{source} is no YAML: maximum recursion depth' in capsys.readouterr().err


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
    path.write_text(f'{2 * "1 0 0 0 1 0 0 0 1 "} 0 0.3 0')
    assert calibrate(tmp_path, path) == 0
    assert read_parameters(tmp_path / 'found.yaml').bias_max == pytest.approx(0.34)
    (tmp_path / 'found.yaml').unlink()
    path.write_text(f'{2 * "1 0 0 0 1 0 0 0 1 "} 0 100 0')
    assert calibrate(tmp_path, path) == 1
    assert 'the bias about y is 100 rad/s, where 10 is' in capsys.readouterr().err
    assert not (tmp_path / 'found.yaml').exists()


@pytest.mark.parametrize(
    ('read', 'content', 'message'),
    [
        (from_imu_tk, '1 2 3', '21 numbers, misalignment, scale and bias, not 3'),
        (from_imu_tk, 18 * '1 ' + 'nan 0 inf', 'numbers that are not finite'),
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
