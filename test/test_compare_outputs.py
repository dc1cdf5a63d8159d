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

"""The comparison of two checkouts' outputs finds what differs, and no more."""

import numpy as np
import pytest

from benchmark.compare_outputs import compare_bags, is_same_text, main
from gyro_drift_filter.bags.output import DIAGNOSTICS_TYPE
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC, imu_message
from support.bags import simulated, write
from support.messages import START, STORE, TEXT, text
from support.paths import REPOSITORY


def imu(k, rate=0.5):
    return START + k, imu_message(START + k, (rate, -0.25, 0.0), (0.0, 0.0, 9.8))


def diagnostics(value):
    """Return a serialized DiagnosticArray with one value."""
    types = STORE.types
    pair = types['diagnostic_msgs/msg/KeyValue']('Noise (rad/s)', value)
    status = types['diagnostic_msgs/msg/DiagnosticStatus'](
        level=1, name='filter', message='3 of 100 samples', hardware_id='', values=[pair]
    )
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](1, 2), '')
    message = types[DIAGNOSTICS_TYPE](header, [status])
    return START, bytes(STORE.serialize_cdr(message, DIAGNOSTICS_TYPE))


@pytest.fixture
def bag(tmp_path):
    """Return a function that writes a small bag, with one of its rates or values changed."""

    def made(rate=0.5, value='0.0123', word='word', log_time=0, n=20):
        path = tmp_path / f'{len(list(tmp_path.iterdir()))}'
        imus = [imu(k, rate if k == 7 else 0.5) for k in range(n)]
        imus[-1] = (imus[-1][0] + log_time, imus[-1][1])
        topics = {
            (TOPIC, IMU_TYPE): imus,
            ('/words', TEXT): [(START, text(word))],
            ('/diagnostics', DIAGNOSTICS_TYPE): [diagnostics(value)],
        }
        return write(path, topics)

    return made


@pytest.mark.slow
def test_the_same_is_the_same(bag):
    assert compare_bags(bag(), bag()) == ([], 0.0)
    assert compare_bags(bag(rate=np.nan), bag(rate=np.nan), 1e-12) == ([], 0.0)


@pytest.mark.slow
def test_one_number_that_differs_is_found(bag):
    before, after = bag(), bag(rate=0.5 + 2.0**-41)  # 9e-13 of the largest
    assert compare_bags(before, after)[0] == [f'{TOPIC}: 1 of 20 messages are other bytes']
    lines, largest = compare_bags(before, after, 1e-12)
    assert lines == []
    assert largest == pytest.approx(2.0**-40)
    (line,), _ = compare_bags(before, bag(rate=0.5 + 2.0**-40), 1e-12)
    assert line == f'{TOPIC}: angular_velocity differs by 1.8e-12 of its largest'
    (line,), _ = compare_bags(before, bag(rate=np.nan), 1e-12)
    assert line == f'{TOPIC}: angular_velocity differs by inf of its largest'


@pytest.mark.slow
def test_texts_times_and_counts_have_to_be_the_same(bag):
    for other, topic in (
        ({'word': 'other'}, '/words'),
        ({'log_time': 5}, TOPIC),
        ({'n': 19}, TOPIC),
        ({'value': '0.0125'}, '/diagnostics'),
        ({'value': 'unknown'}, '/diagnostics'),
    ):
        (line,), _ = compare_bags(bag(), bag(**other), 1e-12)
        assert line.startswith(f'{topic}: ')
    assert compare_bags(bag(), bag(value='0.0124'), 1e-12)[0] == []


@pytest.mark.parametrize(
    ('before', 'after', 'same'),
    [
        ('3 of 100 samples', '4 of 100 samples', False),
        ('at 1.50 Hz', 'at 1.51 Hz', True),
        ('at 1.50 Hz', 'at 1.52 Hz', False),
        ('1.25e-05 rad/s', '1.26e-05 rad/s', True),
        ('1.25e-05 rad/s', '1.25e-04 rad/s', False),
        ('axis x', 'axis y', False),
        ('imu1', 'imu2', False),
    ],
)
def test_numbers_in_texts(before, after, same):
    assert is_same_text(before, after, 1e-12) == same


@pytest.mark.slow
def test_a_checkout_writes_what_it_writes(tmp_path, capsys):
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(200)})
    arguments = [str(REPOSITORY), str(REPOSITORY), str(source), '--methods', 'kalman']
    assert main(arguments) == 0
    assert capsys.readouterr().out == 'in kalman same\nin kalman --diagnostics same\n'
    arguments[1] = str(tmp_path)  # no checkout: whatever is installed, or nothing
    (tmp_path / 'gyro_drift_filter').mkdir()
    (tmp_path / 'gyro_drift_filter' / '__init__.py').touch()
    assert main(arguments) == 1
    assert f'in kalman DIFFERS: {tmp_path}: ' in capsys.readouterr().out
