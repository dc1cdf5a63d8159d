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

"""`gyro_drift identify` as a person meets it."""

import errno
import json
import os
import re
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from matplotlib import image

from gyro_drift_filter.bags.message_types import message_type, serialize
from gyro_drift_filter.cli import identification_report
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.identify.allan import Coefficient
from gyro_drift_filter.identify.identification import DeadAxis
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC, imu_message
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate
from support.bags import write, write_imus
from support.messages import START
from support.paths import RECORDINGS, recorded
from support.processes import run_command

pytestmark = pytest.mark.slow


def bag(path, seconds=90.0, change=None, gap=0.0, burst=1, polled=1):
    """Write a motionless recording at 100 Hz; `gap` in s in its middle.

    The driver stamps `burst` samples at once, or sends each one `polled` times.
    """
    data = simulate(
        SimulationSettings(static_seconds=seconds, dynamic_seconds=0, white_deviation=1e-4)
    )
    rates = data.angular_velocity if change is None else change(data.angular_velocity.copy())
    stamps = data.stamps.copy()
    stamps[len(stamps) // 2 :] += round(gap * 1e9)
    stamps = stamps[np.minimum(np.arange(len(stamps)) // burst * burst, len(stamps) - 1)]
    accelerations = data.linear_acceleration
    if polled > 1:
        rates, accelerations = (np.repeat(v, polled, axis=0) for v in (rates, accelerations))
        stamps = stamps[0] + 10_000_000 // polled * np.arange(len(rates))
    return write_imus(path, stamps, rates, accelerations)


def identify(tmp_path, source, *options):
    return main(['identify', str(source), '-o', str(tmp_path / 'model.yaml'), *options])


def head(set_back=()):
    """Return the head of a report, of a recording that is cut where a clock may have been set."""
    begins, spans = [20.0 * k for k in range(87)], [range(1000)] * 87
    result = SimpleNamespace(
        begins=begins,
        ends=[begin + 10.0 for begin in begins],
        seconds=870.0,
        timing=SimpleNamespace(
            period=0.01, uneven=0.0, breaks=set_back, set_back=np.array(set_back)
        ),
        quiet=SimpleNamespace(spans=spans, accelerometer=True, missing=0, other_rates=()),
        axes=3 * [DeadAxis(0.0)],
    )
    return identification_report._head(result).splitlines()


def test_the_rests_of_a_day_are_no_screenful():
    line = head()[0]
    assert line.startswith('rest: 870.0 s in 87 spans, by gyroscope and accelerometer: 0.0 to 10.0')
    assert line.endswith('100.0 to 110.0 s and 81 more')


@pytest.mark.parametrize(
    ('set_back', 'cuts'),
    [
        ([], 'spaced'),
        ([0.0, 0.0], '; cut at 2 gaps'),
        ([-20.0], '; cut at 1 setting of the clock'),
        ([0.0, -20.0, 7.0], '; cut at 1 gap and 2 settings of the clock'),
    ],
)
def test_a_clock_that_was_set_is_no_gap(set_back, cuts):
    assert head(set_back)[1].endswith(cuts)


@pytest.fixture(scope='module')
def motionless(tmp_path_factory):
    """Folder with a motionless recording and all that can be made of it, and what was told."""
    folder = tmp_path_factory.mktemp('motionless')
    names = {'--json': 'model.json', '--kalibr': 'kalibr.yaml', '--plot': 'figures'}
    options = [word for option, name in names.items() for word in (option, str(folder / name))]
    with redirect_stdout(StringIO()) as printed, redirect_stderr(StringIO()) as told:
        assert identify(folder, bag(folder / 'in'), *options) == 0
    return SimpleNamespace(folder=folder, printed=printed.getvalue(), told=told.getvalue())


def test_a_motionless_recording_gives_a_parameter_file(motionless, tmp_path):
    folder, printed = motionless.folder, motionless.printed
    kalibr = yaml.safe_load((folder / 'kalibr.yaml').read_text())['imu0']
    # Driving noise of 4e-3 with phi 0.218 at 100 Hz.
    assert kalibr['gyroscope_noise_density'] == pytest.approx(4e-4 / 0.782, rel=0.15)
    assert kalibr['rostopic'] == TOPIC
    assert 'bias (deg/s)' in printed
    assert 'ARMA(1, 0) *' in printed
    assert 'time: 100 Hz, samples taken as evenly spaced\n' in printed
    assert len(re.findall(r'^  [xyz]  [a-z ]{12}  (holds|FAILS)  ', printed, re.MULTILINE)) == 12
    assert 'x  stationarity  holds  stationary: ADF' in printed
    assert not re.search(r'[1-9]\d{9}', (folder / 'model.yaml').read_text())
    parameters = read_parameters(folder / 'model.yaml')
    assert parameters.sample_rate == pytest.approx(100.0, rel=1e-3)
    np.testing.assert_allclose(parameters.model_phi, 0.218, atol=0.04)
    np.testing.assert_allclose(parameters.model_noise_deviation, 0.0041, rtol=0.05)
    results = json.loads((folder / 'model.json').read_text())
    biases = [axis['preprocessed']['bias'] for axis in results['axes']]
    np.testing.assert_allclose(biases, [0.01, -0.02, 0.005], atol=3e-4)
    arguments = ['--params', str(folder / 'model.yaml'), '--method', 'kalman']
    assert main(['replay', str(folder / 'in'), '-o', str(tmp_path / 'out'), *arguments]) == 0


def test_results_for_programs_take_the_place_of_the_text(tmp_path, capsys):
    source = bag(tmp_path / 'in', 30)
    assert identify(tmp_path, source, '--json', '-') == 0
    assert json.loads(capsys.readouterr().out)['axes']


def test_a_reader_that_has_left_loses_no_file(tmp_path):
    bag(tmp_path / 'in', 30)
    command = [sys.executable, '-m', 'gyro_drift_filter.cli.main', 'identify', 'in', '-o', 'model']
    options = ['--json', '-', '--kalibr', 'kalibr', '--plot', 'figures']
    read, written = os.pipe()
    os.close(read)
    with os.fdopen(written, 'w') as output:
        done = subprocess.run(
            [*command, *options],
            cwd=tmp_path,
            stdout=output,
            stderr=subprocess.PIPE,
            check=False,
            timeout=300,
        )
    assert done.returncode == 1
    assert b'Traceback' not in done.stderr
    assert read_parameters(tmp_path / 'model').bias_initial != (0.0, 0.0, 0.0)
    assert yaml.safe_load((tmp_path / 'kalibr').read_text())['imu0']
    assert len(list((tmp_path / 'figures').glob('*.png'))) > 1


def test_more_orders_on_request(tmp_path, capsys):
    assert identify(tmp_path, bag(tmp_path / 'in', 30), '--order', '5,3', '--order', '0,2') == 0
    printed = capsys.readouterr().out
    assert printed.count('ARMA(5, 3)') == printed.count('ARMA(0, 2)') == 3


@pytest.mark.parametrize('order', ['6,0', '1,4', '-1,0', '2', 'one,two'])
def test_orders_beyond_are_refused(order, tmp_path, capsys):
    with pytest.raises(SystemExit):
        identify(tmp_path, tmp_path / 'in', f'--order={order}')
    assert f'an order is two numbers from 0,0 to 5,3, not {order}' in capsys.readouterr().err


def test_a_sample_rate_that_is_no_number_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        identify(tmp_path, tmp_path / 'in', '--sample-rate=fast')
    assert 'a sample rate lies between 0.1 and 100000 Hz, not fast' in capsys.readouterr().err


def test_figures(motionless):
    names = ('allan', 'autocorrelation', 'recording', 'spectrum')
    drawn = sorted((motionless.folder / 'figures').iterdir())
    assert [path.name for path in drawn] == [f'{name}.png' for name in names]
    for path in drawn:
        picture = image.imread(path)
        assert min(picture.shape[:2]) > 500
        assert picture[..., :3].std() > 0.05
        assert str(path) in motionless.printed


def test_noise_as_the_paper_takes_it(tmp_path):
    assert identify(tmp_path, bag(tmp_path / 'in'), '--noise', 'paper') == 0
    parameters = read_parameters(tmp_path / 'model.yaml')
    np.testing.assert_allclose(parameters.model_process_noise, 0.004**2, rtol=0.1)
    np.testing.assert_allclose(parameters.model_measurement_noise, 0.0041**2, rtol=0.1)


def test_a_short_rest_draws_a_warning(tmp_path, capsys):
    assert identify(tmp_path, bag(tmp_path / 'in'), '--end', '40') == 0
    assert 's of rest: the figures are rough below 60 s' in capsys.readouterr().err


def test_a_noise_that_no_gyroscope_has_is_said_to_be_in_degrees(tmp_path, capsys):
    assert identify(tmp_path, bag(tmp_path / 'in', 30, change=np.degrees)) == 0
    assert 'rad/s or more on each axis: the driver may publish degrees' in capsys.readouterr().err


def test_a_bias_beyond_the_default_limit_is_one_that_rest_may_have(tmp_path, capsys):
    """It was subtracted as `bias.initial`, never learned anew, and told as left in."""
    source = bag(tmp_path / 'in', 30, change=lambda rates: np.add(rates, [0.3, 0, 0]))
    assert identify(tmp_path, source) == 0
    assert re.search(r'the bias about x, 17\.\d deg/s, is beyond the', capsys.readouterr().err)
    parameters = read_parameters(tmp_path / 'model.yaml')
    assert parameters.bias_max == pytest.approx(parameters.bias_initial[0] + 0.04)
    arguments = ['-o', str(tmp_path / 'out'), '--params', str(tmp_path / 'model.yaml')]
    assert main(['replay', str(source), *arguments]) == 0
    printed = capsys.readouterr().out
    assert 'found at rest' in printed
    assert 'bias.max' not in printed


def test_a_rest_at_another_rate_is_told(tmp_path, capsys):
    def turning(rates):
        rates[4000:4100] += 1.0
        rates[4100:, 2] += 0.01
        return rates

    identify(tmp_path, bag(tmp_path / 'bag', change=turning))
    printed = capsys.readouterr()
    assert re.search(r'left out: 3\d\.\d s in 1 span at other rates', printed.out)
    assert 'differs by up to 0.57 deg/s: a slow turn, or the bias has moved' in printed.err


@pytest.mark.slow
def test_of_a_sensor_that_changes_its_rate_one_rate_is_identified(tmp_path, capsys):
    """The rate in the file was one that the sensor never had, and rests longer than the bag."""
    data = simulate(SimulationSettings(static_seconds=80, dynamic_seconds=0, white_deviation=1e-4))
    kept = np.sort(np.concatenate([np.arange(2000), np.arange(2000, 8000, 4)]))
    values = (v[kept] for v in (data.stamps, data.angular_velocity, data.linear_acceleration))
    assert identify(tmp_path, write_imus(tmp_path / 'in', *values)) == 0
    printed = capsys.readouterr()
    assert 'rest: 60.0 s in 1 span' in printed.out
    assert ': 20.0 to 80.0 s\n' in printed.out
    assert 'time: 25 Hz' in printed.out
    said = 'the sensor changed its rate from 100 to 25 Hz at 20.0 s: the figures are those at 25 Hz'
    assert said in printed.err
    assert '20 s of rest at other sample rates are left out' in printed.err
    assert read_parameters(tmp_path / 'model.yaml').sample_rate == 25.0
    assert '60 s of rest at 25 Hz' in (tmp_path / 'model.yaml').read_text()


def test_a_rate_that_can_be_none_is_told(tmp_path, capsys):
    """Numpy warned of overflows, with paths of its own."""

    def beyond(rates):
        rates[:, 0] = 1e300
        return rates

    assert identify(tmp_path, bag(tmp_path / 'in', change=beyond)) == 1
    note, told = capsys.readouterr().err.splitlines()
    assert note.startswith('note: 9000 samples with a rate beyond 1000000 rad/s')
    assert 'no rate about x is a number of at most 1000000 rad/s: the gyroscope or its' in told


def test_a_driver_that_polls_faster_than_the_sensor_measures_draws_a_warning(
    motionless, tmp_path, capsys
):
    """White noise that is sent five times has a correlation of 0.8."""
    assert identify(tmp_path, bag(tmp_path / 'in', polled=5)) == 0
    said = ' '.join(capsys.readouterr().err.split())
    assert '80 % of the samples are sent twice or more, so that the noise looks correlated' in said
    assert 'twice or more' not in motionless.told


def moving(rates):
    time = np.arange(len(rates)) / 100
    return rates + np.sin(time)[:, None]


def constant(rates):
    rates[:, 1] = 0.25
    return rates


def zero(rates):
    rates[:, 2] = 0.0
    return rates


def deadband(rates):
    rates[:, 0] = np.where(np.abs(rates[:, 0] - 0.01) < 0.006, 0.0, rates[:, 0] - 0.01)
    return rates


def missing(rates):
    rates[:, 1] = np.nan
    return rates


@pytest.mark.parametrize(
    ('change', 'options', 'message'),
    [
        (moving, [], 'no rest: even the quietest second of the recording moves; 20 s of rest are'),
        (None, ['--end', '10'], 'only 10.0 s of rest, the longest 10.0 s, from 0.0 s after the st'),
        (lambda rates: 0 * rates, [], 'all three axes are dead'),
        (deadband, [], 'axis x has a dead band'),
        (missing, [], 'no rate about y is a number'),
        (None, ['--end', '19.98'], 'only 19.9 s of rest, the longest 19.9 s, from 0.0 s after'),
        (
            moving,
            ['--end', '0.5'],
            'the recording has no more than 0.51 s: 20 s of rest are needed',
        ),
        (None, ['--start', '500'], 'with an angular velocity from 500'),
    ],
)
def test_what_can_not_be_identified_is_said_in_one_line(change, options, message, tmp_path, capsys):
    assert identify(tmp_path, bag(tmp_path / 'in', change=change), *options) == 1
    printed = capsys.readouterr()
    assert message in printed.err
    assert printed.err.count('\n') == 1
    assert not (tmp_path / 'model.yaml').exists()


@pytest.mark.parametrize(
    ('change', 'dead', 'value'),
    [(zero, 2, '0 deg/s throughout'), (constant, 1, '14.3239 deg/s throughout')],
)
def test_a_dead_axis_is_told_and_the_others_are_identified(change, dead, value, tmp_path, capsys):
    source = bag(tmp_path / 'in', change=change)
    paths = [str(tmp_path / 'model.json'), '--plot', str(tmp_path / 'figures')]
    assert identify(tmp_path, source, '--json', *paths) == 0
    printed = capsys.readouterr()
    assert f'axis {"xyz"[dead]}: dead, {value}: it does not measure' in printed.err
    cells = next(line for line in printed.out.splitlines() if line.startswith('bias')).split()[2:]
    assert [cell == 'dead' for cell in cells] == [axis == dead for axis in range(3)]
    assert f'axis {"xyz"[dead]} ' not in printed.out
    parameters = read_parameters(tmp_path / 'model.yaml')
    alive = [axis for axis in range(3) if axis != dead]
    np.testing.assert_allclose(
        np.array(parameters.bias_initial)[alive], np.array([0.01, -0.02, 0.005])[alive], atol=3e-4
    )
    assert parameters.bias_initial[dead] == parameters.model_noise_deviation[dead] == 0.0
    assert f'Dead: axis {"xyz"[dead]}' in (tmp_path / 'model.yaml').read_text()
    results = json.loads((tmp_path / 'model.json').read_text())
    assert list(results['axes'][dead]) == ['value']


def test_a_node_takes_the_file_in_any_namespace_and_under_any_name(motionless):
    """By the loading of parameters that every rclpy node has."""
    import rclpy
    from rclpy.node import Node

    path = motionless.folder / 'model.yaml'
    expected = read_parameters(path)
    context = rclpy.Context()
    rclpy.init(context=context)
    try:
        node = Node(
            'my_filter',
            namespace='/robot1/front',
            context=context,
            cli_args=['--ros-args', '--params-file', str(path)],
            automatically_declare_parameters_from_overrides=True,
        )
        for name in ('model.phi', 'bias.initial'):
            values = node.get_parameter(name).value
            assert list(values) == list(expected.names()[name])
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)


def test_what_the_filter_would_refuse_is_not_written(tmp_path, capsys):
    source = bag(tmp_path / 'in', 30, change=lambda rates: 20.0 - rates)
    assert identify(tmp_path, source) == 1
    assert 'the bias about x is 19.99 rad/s, where 10 is the most' in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ['in']


def test_the_older_form_of_the_file_is_read_as_well(motionless, tmp_path):
    path = motionless.folder / 'model.yaml'
    text = path.read_text()
    named = tmp_path / 'named.yaml'
    named.write_text(text.replace('/**:', 'gyro_drift_filter:'))
    assert named.read_text() != text
    assert read_parameters(named) == read_parameters(path)


@pytest.mark.parametrize(
    ('options', 'said'),
    [
        (['-o', '{}/model.yaml', '--json', '{}/model.yaml'], 'name the same path'),
        (['-o', '{}/model.yaml', '--json', '{0}/../{1}/model.yaml'], 'name the same path'),
        (['-o', '{}/model.yaml', '--plot', '{}/model.yaml'], '-o and --plot name the same path'),
        (['-o', '{}/none/model.yaml'], 'there is no folder'),
        (['-o', '{}'], 'is a folder: name a file'),
        (['-o', '{}/model.yaml', '--plot', '{}/allan.svg'], 'name a folder; several PNG files'),
        (['-o', '{}/model.yaml', '--plot', '{}/file/figures'], 'is no folder'),
        (['-o', '/proc/model.yaml'], '/proc can not be written'),
    ],
)
def test_a_wrong_target_is_found_before_the_work(options, said, tmp_path, capsys):
    """The bag is none, which only the work would find."""
    (tmp_path / 'file').touch()
    options = [option.format(tmp_path, tmp_path.name) for option in options]
    assert main(['identify', str(tmp_path / 'no bag'), *options]) == 1
    printed = capsys.readouterr()
    assert said in printed.err
    assert printed.err.count('\n') == 1
    assert [path.name for path in tmp_path.iterdir()] == ['file']


def test_pictures_that_are_there_are_left_alone(tmp_path, capsys):
    picture = tmp_path / 'figures' / 'allan.png'
    picture.parent.mkdir()
    picture.touch()
    arguments = ['-o', str(tmp_path / 'model.yaml'), '--plot', str(picture.parent)]
    assert main(['identify', str(tmp_path / 'no bag'), *arguments]) == 1
    assert 'it holds PNG files already: remove them or' in capsys.readouterr().err


def test_a_full_disk_leaves_no_empty_file(tmp_path, monkeypatch, capsys):
    source = bag(tmp_path / 'in', 30)
    write_text = Path.write_text

    def full(self, text, **options):
        write_text(self, text[:100], **options)
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(Path, 'write_text', full)
    assert identify(tmp_path, source) == 1
    told = capsys.readouterr().err
    assert 'warning: only 30 s of rest' in told
    assert 'model.yaml can not be written: No space left' in told
    assert [path.name for path in tmp_path.iterdir()] == ['in']


def test_an_ascii_terminal_does_not_end_it(tmp_path):
    source = bag(tmp_path / 'in', 25)
    output = tmp_path / 'model.yaml'
    environment = {'LC_ALL': 'C', 'PYTHONUTF8': '0', 'PYTHONIOENCODING': 'ascii'}
    command = sys.executable, '-m', 'gyro_drift_filter.cli.main', 'identify', source, '-o', output
    done = run_command(*command, environment=environment)
    assert done.returncode == 0, done.stderr
    read_parameters(output)


@pytest.mark.parametrize(('options', 'rate'), [((), 100.0), (('--sample-rate', '50'), 50.0)])
def test_stamps_of_zero_take_the_log_times_or_a_rate(options, rate, tmp_path, capsys):
    data = simulate(SimulationSettings(static_seconds=40, dynamic_seconds=0, white_deviation=1e-4))
    samples = zip(
        data.stamps.tolist(), data.angular_velocity, data.linear_acceleration, strict=True
    )
    rows = [(stamp, imu_message(0, *sample)) for stamp, *sample in samples]
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): rows})
    assert identify(tmp_path, source, *options) == 0
    said = '50 Hz as named' if options else 'log times'
    assert f'the stamps are zero: the time is that of {said}' in capsys.readouterr().err
    assert read_parameters(tmp_path / 'model.yaml').sample_rate == pytest.approx(rate, rel=1e-3)


def test_messages_that_come_twice_are_left_out_and_told(tmp_path, capsys):
    """The rate was twice that of the sensor, and the noise density was wrong by as much."""
    data = simulate(SimulationSettings(static_seconds=40, dynamic_seconds=0, white_deviation=1e-4))
    arrays = data.stamps, data.angular_velocity, data.linear_acceleration
    found = []
    for times in (1, 2):
        folder = tmp_path / str(times)
        folder.mkdir()
        repeated = (np.repeat(values, times, axis=0) for values in arrays)
        source = write_imus(folder / 'in', *repeated)
        assert identify(folder, source, '--kalibr', str(folder / 'kalibr.yaml')) == 0
        kalibr = (folder / 'kalibr.yaml').read_text()
        found.append((read_parameters(folder / 'model.yaml'), kalibr))
        told = f'{len(data.stamps)} messages left out that came once more, with the same stamp'
        assert (told in capsys.readouterr().err) == (times == 2)
    assert found[0] == found[1]
    assert found[0][0].sample_rate == pytest.approx(100.0, rel=1e-3)


@pytest.mark.parametrize('factor', [1000, 1e-3])
def test_stamps_in_another_unit_tell_no_noise(factor, tmp_path, capsys):
    """The noise density for Kalibr was 33 times too large, and nothing was said."""
    data = simulate(SimulationSettings(static_seconds=40, dynamic_seconds=0, white_deviation=1e-4))
    samples = zip(
        data.stamps.tolist(), data.angular_velocity, data.linear_acceleration, strict=True
    )
    begin = int(data.stamps[0])
    rows = [
        (stamp, imu_message(begin + int(factor * (stamp - begin)), *sample))
        for stamp, *sample in samples
    ]
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): rows})
    assert identify(tmp_path, source) == 1
    assert 'the driver fills sec and nanosec' in capsys.readouterr().err
    assert main(['calibrate', str(source), '-o', str(tmp_path / 'calibration.yaml')]) == 1
    assert 'the driver fills sec and nanosec' in capsys.readouterr().err


def test_a_file_that_exists_is_left_alone(tmp_path, capsys):
    (tmp_path / 'model.yaml').write_text('mine')
    assert identify(tmp_path, bag(tmp_path / 'in', seconds=5)) == 1
    assert 'exists already' in capsys.readouterr().err
    assert (tmp_path / 'model.yaml').read_text() == 'mine'


def test_nans_and_a_gap(tmp_path, capsys):
    def broken(rates):
        rates[1000::500] = np.nan
        return rates

    assert identify(tmp_path, bag(tmp_path / 'in', change=broken, gap=20.0)) == 0
    printed = capsys.readouterr().out
    assert 'in 2 spans, by gyroscope and accelerometer: 0.0 to 45.0 s, 65.0 to 110.0 s' in printed
    assert '100 Hz, samples taken as evenly spaced; cut at 1 gap\n' in printed
    assert 'missing: 16 samples are not finite' in printed
    assert read_parameters(tmp_path / 'model.yaml').model_phi[0] == pytest.approx(0.218, abs=0.04)


def test_what_is_done_about_bursts_is_said(tmp_path, capsys):
    assert identify(tmp_path, bag(tmp_path / 'in', burst=10)) == 0
    assert 'evenly spaced, though 100 % of the stamps come in bursts' in capsys.readouterr().out
    assert read_parameters(tmp_path / 'model.yaml').sample_rate == pytest.approx(100.0, rel=0.01)


def test_a_bag_with_temperature_only(tmp_path, capsys):
    name = 'sensor_msgs/msg/Temperature'
    header = message_type('std_msgs/msg/Header')(
        stamp=message_type('builtin_interfaces/msg/Time')(sec=1, nanosec=0), frame_id='imu'
    )
    data = serialize(message_type(name)(header=header, temperature=21.0, variance=0.0), name)
    source = write(tmp_path / 'in', {('/imu/temperature', name): [(START, data)]})
    assert identify(tmp_path, source) == 1
    error = capsys.readouterr().err
    assert 'sensor_msgs/msg/Imu' in error
    assert '/imu/temperature' in error
    assert error.count('\n') == 1


@pytest.mark.parametrize(
    ('name', 'said'),
    [
        ('static_mpu6050_bursty', r'99\.\d+ Hz, .* though \d\d % of the stamps come in bursts'),
        ('xio_fusion', r'rest: \d\d\.\d s in \d spans, by gyroscope and accelerometer'),
        ('broad_24_tapping', r'rest: \d\d\.\d s in \d spans, by gyroscope and accelerometer'),
    ],
)
def test_real_recordings_with_bursts_and_motion(name, said, tmp_path, capsys):
    assert identify(tmp_path, recorded(RECORDINGS / name)) == 0
    assert re.search(said, capsys.readouterr().out)
    read_parameters(tmp_path / 'model.yaml')


def test_averaging_times_have_no_exponent():
    assert identification_report._taus(Coefficient(1.0, 0.1, 430.0)) == '0.1 to 430'
    assert identification_report._taus(Coefficient(1.0, 3600.0, 3600.0)) == '3600'


def test_a_real_recording(tmp_path):
    source = recorded(RECORDINGS / 'static_adis16405')
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
