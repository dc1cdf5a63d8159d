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

"""The command as a person meets it: what it prints, and how it ends."""

import errno
import io
import json
import math
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import shtab

from gyro_drift_filter.accelerate import ahead
from gyro_drift_filter.calibrate.exchange import Noise
from gyro_drift_filter.cli import command, printing, progress
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.cli.result_files import as_plain, saying
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.motion_hint import HINT_TYPES
from gyro_drift_filter.simulation.bag import TOPIC, imu_message, imu_messages
from support.bags import read, simulated, write
from support.messages import NOT_REPORTED, TEXT, even_stamps, imu_fields, text
from support.processes import run_command

COMMAND = Path(sys.executable).parent / 'gyro_drift'


def run(*arguments, **environment):
    return run_command(COMMAND, *arguments, environment=environment, timeout=300)


@pytest.mark.slow
def test_simulate_then_replay(tmp_path):
    bag, out = tmp_path / 'bag', tmp_path / 'out'
    done = run('simulate', '-o', bag, '--seed', 5, '--static', 5, '--dynamic', 10)
    assert done.returncode == 0, done.stderr
    assert re.search(r'1500 samples, \d+ outliers on three axes', done.stdout)
    assert f'truth in {tmp_path}/bag_truth.npz' in done.stdout
    done = run('replay', bag, '-o', out, '--method', 'kalman')
    assert done.returncode == 0, done.stderr
    assert done.stderr == ''
    lines = done.stdout.splitlines()
    assert lines[0] == ('/imu/data_raw -> /imu/data_filtered: 1500 messages, 1500 written, 100 Hz')
    assert lines[2].startswith('It helped: ')
    assert [line.split()[0] for line in lines if line.startswith('  r')] == ['rest']
    assert re.search(r'found at rest after 2\.\d s', done.stdout)
    assert ' '.join(lines[-6].split()) == 'deg/s bias +- std raw kalman ratio outliers'
    assert [line.split()[0] for line in lines[-5:-2]] == ['x', 'y', 'z']
    assert lines[-1] == f'wrote {out}'
    assert (out / 'metadata.yaml').exists()


@pytest.mark.slow
def test_replay_loads_only_what_it_needs(tmp_path):
    """Start-up is an eighth of the time of a million messages."""
    write(tmp_path / 'bag', {(TOPIC, IMU_TYPE): simulated(300)})
    arguments = ['replay', str(tmp_path / 'bag'), '-o', str(tmp_path / 'out')]
    code = (
        f'import sys; from gyro_drift_filter.cli.main import main; assert main({arguments}) == 0; '
        'print(*sys.modules)'
    )
    done = run_command(sys.executable, '-c', code, timeout=300)
    assert done.returncode == 0, done.stderr
    loaded = done.stdout.split()
    assert 'rosbags.rosbag2' in loaded
    assert 'gyro_drift_filter.cli.identify' not in loaded
    assert 'rosbags.typesys.stores.ros2_jazzy' not in loaded


def table_of(messages, tmp_path, capsys, *options):
    """Return the lines that `replay` prints of these Imu messages, split in words."""
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): messages})
    assert main(['replay', str(bag), '-o', str(tmp_path / 'out'), *options]) == 0
    printed = capsys.readouterr().out
    assert 'nan' not in printed
    return printed.splitlines()


def resting(random, seconds, bias, moving=0.0):
    """Return Imu messages at 100 Hz: in motion for so long, then at rest."""
    n = round(100 * seconds)
    rates = np.array(bias) + 0.002 * random.standard_normal((n, 3))
    rates[: round(100 * moving)] += np.sin(0.05 * np.arange(round(100 * moving)))[:, None]
    forces = [0.0, 0.0, 9.8] + 0.01 * random.standard_normal((n, 3))
    return list(imu_messages(even_stamps(n), rates, forces))


def test_the_table_counts_from_the_bias_on(tmp_path, random, capsys):
    """The step by which the bias comes off made a good run look worse than none."""
    lines = table_of(resting(random, 30, (0.05, -0.02, 0.1)), tmp_path, capsys)
    for line, bias in zip(lines[-5:-2], np.degrees((0.05, -0.02, 0.1)), strict=True):
        _, known, sure, raw, filtered, ratio, _ = line.split()
        assert float(known) == pytest.approx(bias, abs=4 * float(sure))
        assert float(raw) == pytest.approx(np.degrees(0.002), rel=0.1)
        assert float(filtered) < 0.5 * float(raw)
        assert float(ratio) == pytest.approx(float(filtered) / float(raw), abs=0.01)


def test_the_table_of_a_recording_without_rest(tmp_path, random, capsys):
    lines = table_of(resting(random, 8, (0, 0, 0), moving=8.0), tmp_path, capsys)
    assert lines[2].startswith('This filter did nothing useful here: the sensor never stood still')
    assert [line.split()[1] for line in lines[-5:-2]] == ['-', '-', '-']


def test_the_table_says_when_the_bias_is_left_in(tmp_path, random, capsys):
    parameters = tmp_path / 'p.yaml'
    parameters.write_text('/**: {ros__parameters: {bias.enabled: false}}')
    options = '--params', str(parameters)
    lines = table_of(resting(random, 10, (0.05, 0, 0)), tmp_path, capsys, *options)
    assert 'left in, as bias.enabled is false' in ' '.join(lines)
    assert float(lines[-5].split()[1]) == pytest.approx(np.degrees(0.05), abs=0.05)


def test_the_table_has_words_for_axes_without_figures(tmp_path, random, capsys):
    messages = resting(random, 10, (0, 0, 0))
    dead = [
        (t, imu_message(t, (0.5, *imu_fields(data).angular_velocity[1:]), (0, 0, 9.8)))
        for t, data in messages
    ]
    lines = table_of(dead, tmp_path, capsys)
    assert re.match(r'x +dead, always 28\.6479 +- +-', lines[-5])
    missing = [
        (t, imu_message(t, (1, 2, 3), (0, 0, 9.8), covariance=NOT_REPORTED)) for t, _ in messages
    ]
    lines = table_of(missing, tmp_path / 'missing', capsys)
    assert '1000 written (1000 of them unfiltered)' in lines[0]
    assert re.match(r'x +not reported +- +-', lines[-5])


def test_dead_axes_are_not_called_unusable(tmp_path, capsys):
    zeros = [(t, imu_message(t, (0, 0, 0), (0, 0, 9.8))) for t, _ in simulated(300)]
    source = write(tmp_path / 'zeros', {(TOPIC, IMU_TYPE): zeros})
    assert main(['replay', str(source), '-o', str(tmp_path / 'out')]) == 0
    told = ' '.join(capsys.readouterr().out.split())
    assert 'did nothing useful here: all three axes are dead, each holds one value' in told
    assert 'usable rate' not in told
    assert 'nothing unsound' not in told


def test_a_name_that_the_terminal_can_not_show_does_not_end_it(tmp_path, monkeypatch):
    """It is escaped; the bag was written, and then came a traceback."""
    bag = write(tmp_path / 'in', {('/иму', IMU_TYPE): simulated(9)})
    for arguments in (['replay', str(bag), '-o', str(tmp_path / 'out')], ['doctor', str(bag)]):
        shown = io.TextIOWrapper(io.BytesIO(), 'ascii')
        monkeypatch.setattr(sys, 'stdout', shown)
        assert main(arguments) in (0, 3)
        shown.flush()
        assert rb'/\u0438\u043c\u0443' in shown.buffer.getvalue()


def test_a_dumb_terminal_gets_lines(monkeypatch):
    monkeypatch.setattr(sys, 'stderr', SimpleNamespace(isatty=lambda: True))
    monkeypatch.setenv('TERM', 'xterm')
    assert printing.is_terminal()
    monkeypatch.setenv('TERM', 'dumb')
    assert not printing.is_terminal()


@pytest.mark.parametrize('output', ['', '.', '/'])
def test_a_simulation_needs_a_name(output, capsys):
    assert main(['simulate', '-o', output, '--static', '2', '--dynamic', '2']) == 1
    assert 'exists already' in capsys.readouterr().err


def test_an_interrupt_while_it_loads_is_one_line(monkeypatch, capsys):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, 'parser', interrupted)
    assert main(['doctor', 'bag']) == 130
    assert capsys.readouterr().err == 'gyro_drift: interrupted, nothing written\n'


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_compiles_is_one_line(number):
    """Within a callback of the compiler, where an exception would be lost."""
    code = f"""
import ctypes, signal
from gyro_drift_filter.cli import signals
signal.signal(signal.SIGINT, signal.default_int_handler)
with signals.raising(), signals.ending_at_once(lambda: print('cleaned', flush=True)):
    ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal({int(number)}))()
    print('went on')
"""
    done = run_command(sys.executable, '-c', code, timeout=60)
    assert done.returncode == 128 + number
    why = 'interrupted' if number == signal.SIGINT else 'ended by SIGTERM'
    assert done.stderr == f'gyro_drift: {why}, nothing written\n'
    assert done.stdout == 'cleaned\n'


def test_the_first_run_says_that_it_compiles(tmp_path, monkeypatch, capsys):
    """With how far it is, in lines where there is no terminal."""
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(50)})
    told = threading.Event()

    def tell(text, end='\n'):
        print(text, end=end, file=sys.stderr)
        if '%' in text:
            told.set()

    monkeypatch.setattr(progress, 'tell', tell)
    monkeypatch.setattr(progress, 'has_to_compile', lambda: True)
    monkeypatch.setattr(progress, '_LINE_SECONDS', 0.01)
    monkeypatch.setattr(ahead, 'compile_all', lambda: '' if told.wait(60) else 'no line')
    arguments = ['replay', str(bag), '-o', str(tmp_path / 'out')]
    assert main(arguments) == 0
    first, second, *others = capsys.readouterr().err.splitlines()
    assert first == 'compiling the filter for this machine: once, for one to three minutes'
    assert re.fullmatch(r'compiled: \d+ % in 0 s', second)
    assert any(re.fullmatch(r'compiled in \d s', line) for line in others)
    assert main([*arguments, '--force', '--quiet']) == 0
    assert capsys.readouterr().err == ''


@pytest.mark.slow
@pytest.mark.parametrize(
    ('redirection', 'status', 'told'),
    [
        ('>&-', 0, ''),
        ('>/dev/full', 1, 'gyro_drift replay: all is written, but the standard output can not be'),
        ('2>&- >/dev/full', 1, ''),
    ],
)
def test_an_output_that_takes_nothing_is_no_traceback(redirection, status, told, tmp_path):
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(50)})
    command = f'{sys.executable} -m gyro_drift_filter.cli.main replay in -o out {redirection}'
    done = run_command('sh', '-c', command, cwd=tmp_path, timeout=300)
    assert done.returncode == status
    assert done.stderr.startswith(told)
    assert done.stderr.count('\n') == bool(told)
    assert (bag.parent / 'out' / 'metadata.yaml').exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ('options', 'told'),
    [('', 'the standard'), ('--json a.json', 'all is written, but the standard')],
)
def test_a_page_that_is_not_taken_is_not_said_to_be_written(options, told, tmp_path):
    write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(50)})
    command = f'{sys.executable} -m gyro_drift_filter.cli.main doctor in {options} >/dev/full'
    done = run_command('sh', '-c', command, cwd=tmp_path, timeout=300)
    assert done.returncode == 1
    assert f'gyro_drift doctor: {told} output can not be' in done.stderr
    assert (tmp_path / 'a.json').exists() == bool(options)


@pytest.mark.parametrize(
    'arguments',
    [
        ['replay', 'in', '-o', 'out'],
        ['replay', 'in', '-o', 'out', '--quiet'],
        pytest.param(['report', 'in', '-o', 'out'], marks=pytest.mark.slow),
        pytest.param(['tune', 'in', '-o', 'out', '--seconds', '0.001'], marks=pytest.mark.slow),
        ['doctor', 'in'],
        ['explain', 'in'],
    ],
)
def test_results_for_programs_take_the_place_of_the_text(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(3000)})
    status = main([*arguments, '--json', '-'])
    printed = capsys.readouterr().out
    assert json.loads(printed)
    assert not Path('-').exists()
    if Path('out').exists():
        Path('out').rename('before')
    assert main([*arguments, '--json', 'file']) == status
    written = json.loads(Path('file').read_text())
    assert written.keys() == json.loads(printed).keys()
    assert not capsys.readouterr().out.startswith('{')


@pytest.mark.parametrize(
    'arguments',
    [
        ['replay', 'in', '-o', 'out', '--json', 'full'],
        pytest.param(['tune', 'in', '-o', 'full', '--seconds', '0.001'], marks=pytest.mark.slow),
        ['doctor', 'in', '--json', 'full'],
        ['explain', 'in', '--json', 'full'],
    ],
)
def test_results_that_the_disk_does_not_take_are_said(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(3000)})
    write_text = Path.write_text

    def full(self, *arguments, **options):
        if self.name.startswith('.full.'):
            raise OSError(errno.ENOSPC, 'No space left on device')
        return write_text(self, *arguments, **options)

    monkeypatch.setattr(Path, 'write_text', full)
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert 'full can not be written: No space left' in printed.err
    assert len(printed.out.splitlines()) > 2
    assert printed.out.endswith('\n\nwrote out\n') == ('out' in arguments)


def test_programs_get_the_results_where_another_file_can_not_be_written(tmp_path, capsys):
    path = tmp_path / 'results.json'
    with pytest.raises(OSError, match='disk'), saying('text', path, {'bias': 0.1}):
        raise OSError('the disk is full')
    assert json.loads(path.read_text()) == {'bias': 0.1}
    assert capsys.readouterr().out == f'text\n\nwrote {path}\n'


def test_every_record_has_names_in_the_results_for_programs():
    @dataclass
    class Result:
        noise: Noise
        samples: tuple[float, ...] = field(metadata={'in_json': False})

    noise = Noise(0.1, None, math.nan, 100.0)
    plain = {'rate_density': 0.1, 'rate_walk': None, 'acceleration_density': None}
    plain['sample_rate'] = 100.0
    assert as_plain([Result(noise, (1.0, 2.0))]) == [{'noise': plain}]


def test_simulate_is_reproducible(tmp_path):
    for name in 'ab':
        output = tmp_path / name / 'bag'
        assert main(['simulate', '-o', str(output), '--static', '2', '--dynamic', '2']) == 0
    a, b = (np.load(tmp_path / name / 'bag_truth.npz') for name in 'ab')
    assert all((a[name] == b[name]).all() for name in a.files)
    bags = [(tmp_path / name / 'bag' / 'bag.mcap').read_bytes() for name in 'ab']
    assert bags[0] == bags[1]


def test_replay_takes_a_parameter_file(tmp_path, capsys):
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(50)})
    parameters = tmp_path / 'p.yaml'
    parameters.write_text('/**:\n  ros__parameters: {method: kalman, epsilon: 1}\n')
    arguments = ['replay', str(bag), '-o', str(tmp_path / 'out'), '--params', str(parameters)]
    assert main(arguments) == 0
    assert 'kalman' in capsys.readouterr().out


def test_replay_tells_of_hints_that_only_the_node_would_hear(tmp_path, capsys):
    hints = [(10**18, bytes(52))]
    bag = write(
        tmp_path / 'in',
        {(TOPIC, IMU_TYPE): simulated(50), ('/cmd_vel', HINT_TYPES['twist']): hints},
    )
    parameters = tmp_path / 'p.yaml'
    parameters.write_text('/**: {ros__parameters: {motion_hint: twist}}')
    arguments = ['replay', str(bag), '--params', str(parameters), '--force']
    told = 'warning: motion_hint is twist, but no topic is named by --motion-hint'
    assert main([*arguments, '-o', str(tmp_path / 'out')]) == 0
    assert told in capsys.readouterr().err
    assert main([*arguments, '-o', str(tmp_path / 'out'), '--motion-hint', '/cmd_vel']) == 0
    assert told not in capsys.readouterr().err
    # What it explains may come out otherwise, too.
    arguments = ['explain', str(bag), '--params', str(parameters)]
    assert main(arguments) == 0
    assert told in capsys.readouterr().err
    assert main([*arguments, '--motion-hint', '/cmd_vel']) == 0
    assert told not in capsys.readouterr().err


@pytest.mark.parametrize('command', ['report', 'tune', 'fleet'])
def test_hints_that_a_command_does_not_take_are_told(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path('p.yaml').write_text('/**: {ros__parameters: {motion_hint: odometry}}')
    assert main([command, 'no_bag', '-o', 'out', '--params', 'p.yaml']) == 1
    told = capsys.readouterr().err
    assert f'warning: motion_hint is odometry, but gyro_drift {command} takes no hints' in told


@pytest.mark.slow
@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['replay', 'none', '-o', 'out'], 'no such bag: none'),
        (['replay', 'words', '-o', 'out'], 'no topic of type sensor_msgs/msg/Imu in the bag'),
        (
            ['replay', 'in', '-o', 'in'],
            'in exists already, and is the bag to be read: choose another name',
        ),
        (
            ['replay', 'in', '-o', '.'],
            '. exists already: choose another name, as it is no rosbag2 folder',
        ),
        (
            ['replay', 'in/in.mcap', '-o', '.', '--force'],
            '. is the bag to be read, or holds it: choose another name',
        ),
        (
            ['replay', 'in', '-o', '/dev/full'],
            '/dev/full exists already: choose another name, as it is no rosbag2 folder',
        ),
        (['replay', '.', '-o', 'out'], '. is no rosbag2 folder: it holds no metadata.yaml'),
        (['report', 'silent', '-o', 'out'], 'can be filtered: no rate about y is a number of'),
        (['replay', 'in', '-o', 'out', '--params', 'none.yaml'], 'none.yaml: No such file'),
        (['replay', 'in', '-o', 'out', '--params', 'bad.yaml'], "did you mean 'epsilon'?"),
        (['replay', 'in', '-o', 'out', '--params', 'text.yaml'], "'epsilon' must be a number"),
        (['replay', 'in', '-o', 'out', '--json', 'out'], '--json and -o name the same path'),
        (
            ['replay', 'in', '-o', 'out', '--json', 'a', '--bias-memory', './a'],
            '--json and --bias-memory name the same path, a',
        ),
        *(
            (
                ['replay', 'in', '-o', output, '--force', option, name],
                f'{option} {name} lies within -o {output}, which holds nothing else than what',
            )
            for output, option, name in (
                ('out', '--bias-memory', 'out/metadata.yaml'),
                ('out', '--bias-memory', 'old/../out/a/bias.json'),
                ('old', '--json', 'old/verdict.json'),
            )
        ),
        (['replay', 'in', '-o', 'out', '--bias-memory', '/proc/a/b'], '/proc can not be written'),
        (['report', 'in', '-o', 'out', '--png', 'out'], '--output and --png name the same path'),
        (['simulate', '-o', 'out', '--rate', '0'], '--rate must be 1 to 10000 Hz'),
        (['simulate', '-o', 'out', '--static', '-1'], '--static and --dynamic must not be'),
        (['simulate', '-o', 'out', '--seed', '-1'], '--seed must not be negative'),
        (['simulate', '-o', 'in'], 'in exists already'),
        (
            ['simulate', '-o', 'out', '--rate', '1', '--static', '1', '--dynamic', '1'],
            'are fewer than 10 samples',
        ),
    ],
)
def test_a_known_error_is_one_line_and_status_1(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(9)})
    write(tmp_path / 'old', {(TOPIC, IMU_TYPE): simulated(9)})
    write(tmp_path / 'words', {('/words', TEXT): [(1, text('a'))]})
    silent = [(10**18 + k, imu_message(10**18 + k, (0, np.nan, 0), (0, 0, 9.8))) for k in range(9)]
    write(tmp_path / 'silent', {(TOPIC, IMU_TYPE): silent})
    (tmp_path / 'bad.yaml').write_text('gyro_drift_filter: {ros__parameters: {epsilonn: 1.0}}')
    (tmp_path / 'text.yaml').write_text('/**: {ros__parameters: {epsilon: wide}}')
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert printed.out == ''
    assert printed.err.startswith(f'gyro_drift {arguments[0]}: ')
    assert message in printed.err
    assert printed.err.count('\n') == 1
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize(
    ('option', 'command'),
    [
        *(('--topic', name) for name in ('report', 'doctor', 'identify', 'calibrate', 'tune')),
        *(('--params', name) for name in ('replay', 'report', 'explain', 'tune')),
    ],
)
def test_an_option_of_one_value_is_given_once(option, command, capsys):
    """All but the last value were passed over without a word."""
    with pytest.raises(SystemExit) as exit_:
        main([command, 'bag', option, 'a', option, 'b'])
    assert exit_.value.code == 2
    said = f'{option} is given twice, and this command takes one\n'
    assert capsys.readouterr().err.endswith(said)


@pytest.mark.parametrize('arguments', [[], ['replay'], ['replay', 'bag'], ['frobnicate']])
def test_bad_usage_is_status_2(arguments, capsys):
    with pytest.raises(SystemExit) as error:
        main(arguments)
    assert error.value.code == 2
    assert 'usage: gyro_drift' in capsys.readouterr().err


def test_warns_of_rates_in_degrees(tmp_path, capsys):
    imu = [
        (10**18 + k * 10**7, imu_message(10**18 + k * 10**7, (90.0 + k, 0, 0), (0, 0, 9.8)))
        for k in range(200)
    ]
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu})
    assert main(['replay', str(bag), '-o', str(tmp_path / 'out')]) == 0
    assert 'warning: rates stay above 35 rad/s' in capsys.readouterr().err


WITHOUT = """
import sys
for name in sys.argv[1].split(','):
    sys.modules[name] = None
from gyro_drift_filter.cli.main import main
sys.exit(main(sys.argv[2:]))
"""


def run_without(modules, *arguments):
    """Run the command where modules, joined by commas, can't be imported."""
    return run_command(sys.executable, '-c', WITHOUT, modules, *arguments)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('module', 'hint'),
    [
        ('rosbags', "install it with 'pip install"),
        ('yaml', "'apt install python3-yaml'"),
    ],
)
def test_a_missing_library_is_named_in_one_sentence(tmp_path, module, hint):
    options = ['--params', tmp_path / 'p.yaml'] if module == 'yaml' else []
    done = run_without(module, 'replay', 'x', '-o', tmp_path / 'out', *options)
    assert done.returncode == 1
    assert hint in done.stderr
    assert done.stderr.count('\n') == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ('module', 'command', 'packages'),
    [('pyarrow', 'fleet', '".[fleet]"'), ('scipy', 'doctor', 'scipy')],
)
def test_packages_are_named_as_pip_takes_them_in_a_clone_on_ubuntu(
    tmp_path, module, command, packages
):
    options = ['-o', tmp_path / 'out'] if command == 'fleet' else []
    done = run_without(module, command, tmp_path, *options)
    assert done.returncode == 1
    assert f"with 'pip install {packages}'" in done.stderr
    assert done.stderr.endswith(', on Ubuntu within a venv\n')


@pytest.mark.slow
def test_the_offline_tools_run_without_ros(tmp_path):
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(50)})
    ros = 'rclpy,sensor_msgs,std_msgs,geometry_msgs,diagnostic_msgs'
    done = run_without(ros, 'replay', bag, '-o', tmp_path / 'out')
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_topic_beyond_ascii_is_read_in_any_locale(tmp_path):
    topic = '/imu/d\u00e4t\u00e4'
    bag = write(tmp_path / 'in', {(topic, IMU_TYPE): simulated(50)})
    locale = {'LC_ALL': 'C', 'PYTHONUTF8': '0', 'PYTHONCOERCECLOCALE': '0'}
    out = tmp_path / 'out'
    done = run_command(COMMAND, 'replay', bag, '-o', out, environment=locale)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ''
    assert len(read(out)[0][f'{topic}_filtered']) == 50


@pytest.mark.slow
def test_an_interrupted_replay_leaves_nothing(tmp_path):
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): 60 * simulated(3000)})
    with subprocess.Popen(
        [COMMAND, 'replay', bag, '-o', tmp_path / 'out'],
        stderr=subprocess.PIPE,
        text=True,
        # Tests that run in the background inherit that interrupts are ignored.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    ) as process:
        end = time.monotonic() + 60
        while not list(tmp_path.glob('.out.*.incomplete/out/*.mcap')):
            assert process.poll() is None
            assert time.monotonic() < end
        process.send_signal(signal.SIGINT)
        _, log = process.communicate(timeout=60)
    assert process.returncode == 130
    assert log == 'gyro_drift replay: interrupted: what was not complete is not written\n'
    assert [path.name for path in tmp_path.iterdir()] == ['in']


@pytest.mark.parametrize('terminal', [True, False])
def test_progress_tells_rate_and_time_left(terminal, monkeypatch, capsys):
    """On a terminal in a line that is written over, elsewhere in lines of long work alone."""
    now = [0.0]
    monkeypatch.setattr(progress, 'is_terminal', lambda: terminal)
    monkeypatch.setattr(time, 'monotonic', lambda: now[0])
    with progress.Progress(enabled=True) as shown:
        for seconds, done in ((1.0, 100), (11.0, 1000), (12.0, 1100)):
            now[0] = seconds
            shown(done, 16_500)
    told = capsys.readouterr().err
    if not terminal:
        assert told == '6 % of 16500 messages, 91 a second, 2 min 50 s left\n'
        return
    assert told.count('\n') == 0
    assert told.count('\r') == 4
    assert '100 a second, 2 min 44 s left' in told
    assert told.endswith('\r\x1b[K')


def test_progress_takes_one_row_of_a_narrow_terminal(monkeypatch, capsys):
    """What is wider takes two, of which the next one writes over the last one alone."""
    now = [0.0]
    monkeypatch.setattr(progress, 'is_terminal', lambda: True)
    monkeypatch.setattr(progress, 'terminal_columns', lambda: 40)
    monkeypatch.setattr(time, 'monotonic', lambda: now[0])
    with progress.Progress(enabled=True) as shown:
        now[0] = 11.0
        shown(1000, 16_500)
    assert capsys.readouterr().err == '\r6 % of 16500 messages, 91 a second, 2 m\x1b[K\r\x1b[K'


def test_progress_has_no_time_left_at_its_end_alone(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(progress, 'is_terminal', lambda: False)
    monkeypatch.setattr(time, 'monotonic', lambda: now[0])
    with progress.Progress(enabled=True) as shown:
        for now[0], done in ((20.0, 199), (40.0, 200)):
            shown(done, 200)
    assert capsys.readouterr().err.splitlines() == [
        '99 % of 200 messages, 9.9 a second, 1 s left',
        '100 % of 200 messages, 5 a second',
    ]


@pytest.mark.parametrize(
    ('options', 'left_out'),
    [
        ((), ''),
        (('--json', '-'), ''),
        (('--json', 'found.json'), ': what was not complete is not written'),
    ],
)
def test_an_interrupt_tells_of_files_where_some_were_to_be_written(
    options, left_out, monkeypatch, capsys
):
    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr('gyro_drift_filter.cli.doctor.run', interrupted)
    assert main(['doctor', 'drive', *options]) == 130
    assert capsys.readouterr().err == f'gyro_drift doctor: interrupted{left_out}\n'


@pytest.mark.slow
def test_one_message_is_one(tmp_path, capsys):
    write(tmp_path / 'in', {(TOPIC, IMU_TYPE): [simulated()[0]]})
    assert main(['replay', str(tmp_path / 'in'), '-o', str(tmp_path / 'out')]) == 0
    assert ': 1 message, 1 written, ' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('done', 'seconds', 'told'),
    [
        (33, 100.0, '20 a minute'),
        (3, 2.0, '1.5 a second'),
        (1, 1800.0, '2 an hour'),
        (0, 10.0, '0 a second'),
        (123_456, 1.0, '120000 a second'),
    ],
)
def test_a_pace_is_told_in_a_unit_that_shows_it(done, seconds, told):
    """Of bags there were none a second."""
    assert progress._pace(done, seconds) == told


@pytest.mark.parametrize(('environment', 'coloured'), [({}, True), ({'NO_COLOR': '1'}, False)])
def test_colour_is_for_terminals_that_want_it(environment, coloured, monkeypatch):
    monkeypatch.delenv('NO_COLOR', raising=False)
    monkeypatch.setenv('TERM', 'xterm')
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert printing.in_colour('It helped', 'helped') == 'It helped'
    monkeypatch.setattr(sys, 'stdout', SimpleNamespace(isatty=lambda: True))
    assert ('\x1b' in printing.in_colour('It helped', 'helped')) == coloured


def test_shells_can_complete_the_command():
    """With shtab, as README says: it takes the parser as it is."""
    script = shtab.complete(command.parser(), shell='bash')
    for word in ('replay', 'report', '--methods', 'sage_husa', '--bias-memory'):
        assert word in script
