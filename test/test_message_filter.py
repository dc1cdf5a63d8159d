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

"""Messages in, messages out."""

import numpy as np
import pytest

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.imu import ImuKind, is_published, patch_imu
from gyro_drift_filter.messages.message_filter import LONGEST_FRAME_ID, NOTE, MessageFilter
from gyro_drift_filter.simulation.bag import imu_message
from support.chunks import imus_of, piece_of
from support.messages import NOT_REPORTED, imu_fields, offset_of_doubles, quiet, simulated


def mixed():
    """Good messages with every kind of bad one between them."""
    messages = simulated()
    stamp = imu_fields(messages[300]).stamp
    messages[300] = imu_message(stamp, (1.0, 2.0, 3.0), (0, 0, 9.8), covariance=NOT_REPORTED)
    messages[301] = messages[301][:50]
    messages[302] = b''
    messages[303] = imu_message(stamp + 30_000_000, (np.nan, 0.1, 0.1), (0, 0, 9.8))
    messages[305] = messages[304]
    messages[400], messages[401] = messages[401], messages[400]
    messages.insert(0, imu_message(stamp - 10**10, (np.nan, 0.1, 0.1), (0, 0, 9.8)))
    return messages


def take_all(filter_, messages):
    """Filter messages one by one, and return what there is to publish for each."""
    return [filter_.take(message) for message in messages]


def take_at_once(filter_, messages, indexes=()):
    """Filter messages as those of a piece; return what is published, and reports on the way."""
    piece = piece_of(messages)
    imus, notes, published = imus_of(piece), np.zeros(len(indexes), NOTE), []
    notes['index'] = indexes
    filter_.take_imus(piece.data, imus, notes)
    for k, imu in enumerate(imus):
        if imu['kind'] == ImuKind.GOOD and is_published(imu):
            patch_imu(piece.data, imu['start'], imu)
        published.append(piece.message(k) if is_published(imu) else None)
    return published, filter_.reports(notes)


def test_a_piece_and_single_messages_give_the_same_bytes():
    messages = mixed()
    single, at_once = MessageFilter(Parameters()), MessageFilter(Parameters())
    assert take_all(single, messages) == take_at_once(at_once, messages)[0]
    assert single.reception == at_once.reception
    assert single.reception['malformed'] == 2
    assert single.filter.snapshot() == at_once.filter.snapshot()


@pytest.mark.slow
def test_notes_in_a_piece_are_the_reports_at_their_places(random):
    """The sample period changes on the way, too."""
    messages = [*mixed(), *quiet(500, 5e-3, random, rate=400.0)]
    indexes = sorted([0, 40, 40, 302, *random.integers(0, 1100, 20).tolist(), len(messages)])
    for cut in (0, 40, 700):
        at_once, one_by_one = MessageFilter(Parameters()), MessageFilter(Parameters())
        take_at_once(at_once, messages[:cut])
        later = [index - cut for index in indexes if index >= cut]
        _, reports = take_at_once(at_once, messages[cut:], later)
        wanted = []
        for k in range(len(messages) + 1):
            wanted += [one_by_one.report()] * (indexes.count(k) if k >= cut else 0)
            if k < len(messages):
                one_by_one.take(messages[k])
        assert len(reports) == len(later)
        assert repr(reports) == repr(wanted)  # where NaN is like NaN


def test_bad_messages_are_counted_and_told_apart():
    messages = mixed()
    filter_ = MessageFilter(Parameters())
    published = take_all(filter_, messages)
    assert published[0] is None  # no rate on axis x yet
    assert published[301] == messages[301]  # not reported: as it came
    assert published[302] is None
    assert published[303] is None
    assert np.isfinite(imu_fields(published[304]).angular_velocity).all()
    assert published[306] == published[305]
    report = filter_.report()
    assert (report.received, report.malformed, report.not_reported) == (601, 2, 1)
    assert '0 bytes are too few' in report.last_malformed


@pytest.mark.parametrize('delay', [0, 1, 300])
def test_output_that_comes_back_is_not_filtered_again(delay):
    """As through a relay, which may take a while."""
    data, looped = simulated(), MessageFilter(Parameters())
    wanted = take_all(MessageFilter(Parameters()), data)
    messages, published = [], []
    for k, message in enumerate(data):
        messages.append(message)
        published.append(looped.take(message))
        if k >= delay:
            messages.append(published[k - delay])
            assert looped.take(published[k - delay]) is None
    assert published == wanted
    assert looped.report().own_outputs == len(data) - delay
    at_once = MessageFilter(Parameters())
    assert [out for out in take_at_once(at_once, messages)[0] if out is not None] == wanted


@pytest.mark.parametrize('stamp', [0, 10**18])
@pytest.mark.parametrize('rate', [0.0, 0.25])
def test_a_driver_that_repeats_itself_is_no_loop(stamp, rate):
    """The filter may agree with it to the last bit."""
    message, filter_ = imu_message(stamp, (rate, 0, 0), (0, 0, 9.8)), MessageFilter(Parameters())
    published = take_all(filter_, 50 * [message])
    assert imu_fields(published[0]).angular_velocity == (rate, 0.0, 0.0)
    assert filter_.report().own_outputs == 0


@pytest.mark.parametrize('seconds', [8.0, 8.5])
def test_another_frame_is_another_sensor(seconds, random):
    """Its bias is learned at once, where one that jumps about the vertical takes 90 s of rest."""
    n, change = 1500, int(100 * seconds)
    rates = 0.003 * random.standard_normal((n, 3))
    rates[change:, 2] += np.radians(1.0)
    forces = (0.0, 0.0, 9.81) + 0.02 * random.standard_normal((n, 3))
    errors = {}
    for name in ('imu', 'other'):
        filter_ = MessageFilter(Parameters())
        for k in range(n):
            frame = name if k >= change else 'imu'
            filter_.take(imu_message(10**18 + k * 10**7, rates[k], forces[k], frame=frame))
            if k == change:
                doubt = filter_.filter.bias_deviation[2]
        errors[name] = abs(filter_.filter.state['bias']['bias'][2] - np.radians(1.0))
        assert (doubt > np.radians(2.0)) == (name == 'other')
    assert errors['imu'] > np.radians(0.9)
    assert errors['other'] < np.radians(0.03)


def test_the_frame_of_an_accelerometer_beside_it_is_no_other_gyroscope(random):
    """It publishes messages without rates on the same topic."""
    rates = 0.003 * random.standard_normal((2000, 3))
    alone, beside = MessageFilter(Parameters()), MessageFilter(Parameters())
    for k, rate in enumerate(rates):
        stamp = 10**18 + k * 10**7
        message = imu_message(stamp, rate, (0, 0, 9.8), frame='imu')
        for filter_ in (alone, beside):
            filter_.take(message)
        if k % 10 == 5:
            beside.take(
                imu_message(stamp, rate, (0, 0, 9.8), frame='force', covariance=NOT_REPORTED)
            )
    assert beside.report().frame_changes == 0
    np.testing.assert_array_equal(beside.filter.bias_deviation, alone.filter.bias_deviation)


def test_a_message_without_rates_hides_no_other_frame(random):
    filter_ = MessageFilter(Parameters())
    for k, rate in enumerate(0.003 * random.standard_normal((1000, 3))):
        filter_.take(imu_message(10**18 + k * 10**7, rate, (0, 0, 9.8), frame='imu'))
    stamp = 10**18 + 10**10
    filter_.take(imu_message(stamp, (0, 0, 0), (0, 0, 9.8), frame='b', covariance=NOT_REPORTED))
    filter_.take(imu_message(stamp + 10**7, (0, 0, 0), (0, 0, 9.8), frame='b'))
    assert filter_.report().frame_changes == 1
    assert filter_.filter.bias_deviation.min() > np.radians(2.0)


def test_frames_that_alternate_keep_the_bias_learned_and_doubted(random):
    """Nobody knows whether it is one sensor with two names, or two of them."""
    filter_ = MessageFilter(Parameters())
    for k in range(2000):
        rate = np.radians(1.0) + 0.003 * random.standard_normal(3)
        force = (0.0, 0.0, 9.81) + 0.02 * random.standard_normal(3)
        frame = 'left' if k % 2 else 'right'
        filter_.take(imu_message(10**18 + k * 10**7, rate, force, frame=frame))
    bias = filter_.filter.state['bias']
    np.testing.assert_allclose(bias['bias'], np.radians(1.0), atol=np.radians(0.05))
    np.testing.assert_allclose(filter_.filter.bias_deviation, 0.04, rtol=0.01)


def test_changes_of_the_frame_are_counted():
    """Also where it differs behind what is kept of it, in length; and after one without a name."""
    filter_ = MessageFilter(Parameters())
    long = LONGEST_FRAME_ID * 'x'
    frames = ['a', 'a', 'b', '', '', 'b', long, long + 'y', long + 'z', 'b\n\xe4']
    changes = []
    for k, frame in enumerate(frames):
        filter_.take(imu_message(10**18 + k * 10**7, (0, 0, 0), (0, 0, 9.8), frame=frame))
        filter_.take(b'junk')
        changes.append(filter_.report().frame_changes)
    assert changes == [0, 0, 1, 2, 2, 3, 4, 5, 5, 6]
    assert filter_.report().frame == 'b \xe4'


def test_messages_of_any_size():
    """The buffers grow."""
    filter_ = MessageFilter(Parameters())
    for size in (0, 5000, 10, 100_000):
        frame = size * 'f'
        data = imu_message(10**18, (0.1, 0.2, 0.3), (0, 0, 9.8), frame=frame)
        assert len(filter_.take(data)) == len(data)
        assert frame.encode() in filter_.sample_message('bias')


def test_all_but_rate_and_covariance_is_unchanged():
    data = simulated(20)[-1]
    filter_ = MessageFilter(Parameters())
    out = filter_.take(data)
    assert out is not None
    begin = offset_of_doubles(data) + 13 * 8
    assert out[:begin] == data[:begin]
    assert out[begin + 12 * 8 :] == data[begin + 12 * 8 :]
    covariance = np.frombuffer(out, '<f8', 9, begin + 24).reshape(3, 3)
    assert (np.diag(covariance) > 0).all()
    assert (covariance == np.diag(np.diag(covariance))).all()
