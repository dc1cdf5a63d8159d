"""Messages in, messages out."""

import numpy as np

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.cdr import read_imu
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.simulation.bag import imu_message
from support.messages import simulated

NOT_REPORTED = [-1.0] + 8 * [0.0]


def mixed():
    """Good messages with every kind of bad one between them."""
    messages = simulated()
    stamp = read_imu(messages[300]).stamp
    messages[300] = imu_message(stamp, (1.0, 2.0, 3.0), (0, 0, 9.8), covariance=NOT_REPORTED)
    messages[301] = messages[301][:50]
    messages[302] = b''
    messages[303] = imu_message(stamp + 30_000_000, (np.nan, 0.1, 0.1), (0, 0, 9.8))
    messages[305] = messages[304]
    messages.insert(0, imu_message(stamp - 10**10, (np.nan, 0.1, 0.1), (0, 0, 9.8)))
    return messages


def test_batch_and_single_messages_give_the_same_bytes():
    messages = mixed()
    single, batch = MessageFilter(Parameters()), MessageFilter(Parameters())
    one_by_one = [single.process(data).data for data in messages]
    assert one_by_one == [outcome.data for outcome in batch.process_batch(messages)]
    assert single.malformed == batch.malformed == 2
    assert single.filter.snapshot() == batch.filter.snapshot()


def test_bad_messages_are_counted_and_told_apart():
    messages = mixed()
    filter_ = MessageFilter(Parameters())
    outcomes = filter_.process_batch(messages)
    assert outcomes[0].data is None  # no rate on axis x yet
    assert outcomes[301].data == messages[301]  # not reported: as it came
    assert outcomes[302].data is None
    assert outcomes[303].data is None
    bridged = read_imu(outcomes[304].data)
    assert np.isfinite(bridged.angular_velocity).all()
    assert outcomes[306].data == outcomes[305].data
    assert (filter_.received, filter_.malformed, filter_.not_reported) == (601, 2, 1)
    assert '0 bytes are too few' in filter_.last_malformed


def test_all_but_rate_and_covariance_is_unchanged():
    data = simulated(20)[-1]
    filter_ = MessageFilter(Parameters())
    out = filter_.process(data).data
    begin = read_imu(data).offset + 13 * 8
    assert out[:begin] == data[:begin]
    assert out[begin + 12 * 8 :] == data[begin + 12 * 8 :]
    covariance = np.frombuffer(out, '<f8', 9, begin + 24).reshape(3, 3)
    assert (np.diag(covariance) > 0).all()
    assert (covariance == np.diag(np.diag(covariance))).all()
