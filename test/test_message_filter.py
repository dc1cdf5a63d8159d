"""Messages in, messages out, and what is reported of them."""

from itertools import pairwise

import numpy as np
import pytest

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.cdr import read_imu
from gyro_drift_filter.messages.health import ERROR, OK, STALE, WARN, Health
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


def report(messages, seconds=1.0):
    filter_ = MessageFilter(Parameters())
    health = Health()
    for data in messages:
        filter_.process(data)
    return health.judge(filter_.report(), seconds)


def test_health_of_a_sound_input():
    input_, filter_ = report(simulated(600), seconds=6.0)
    assert (input_.level, filter_.level) == (OK, OK)
    assert input_.values['Actual frequency (Hz)'] == '100'
    assert input_.values['Events since startup'] == '600'
    assert filter_.values['Method'] == Parameters().method
    for key in ('Outliers', 'Process noise Q ((rad/s)^2)', 'Measurement noise R ((rad/s)^2)'):
        for axis in 'xyz':
            assert float(filter_.values[f'{key} {axis}']) >= 0


@pytest.mark.parametrize(
    ('messages', 'level', 'text'),
    [
        ([], STALE, 'no message: is the driver running'),
        ([b'junk'], ERROR, 'messages refused, the last because 4 bytes are too few'),
        (
            [imu_message(10**18, (0, 0, 0), (0, 0, 9.8), covariance=NOT_REPORTED)],
            WARN,
            'no angular velocity reported',
        ),
        (
            [imu_message(10**18 + k * 10**7, (90.0, 1, 1), (0, 0, 9.8)) for k in range(50)],
            WARN,
            'the driver may publish degrees per second',
        ),
    ],
)
def test_health_says_what_is_wrong(messages, level, text):
    input_, _ = report(messages)
    assert input_.level == level
    assert text in input_.message


def test_a_single_spike_is_no_sign_of_degrees():
    messages = simulated(100)
    messages[50] = imu_message(read_imu(messages[50]).stamp, (90.0, 1, 1), (0, 0, 9.8))
    assert report(messages)[0].level == OK


def test_health_tells_of_unusable_rates():
    messages = simulated(100)
    messages[50] = imu_message(read_imu(messages[50]).stamp, (np.nan, 1, 1), (0, 0, 9.8))
    input_, _ = report(messages)
    assert input_.level == WARN
    assert 'no usable number' in input_.message


def test_health_tells_of_a_band_that_is_too_tight():
    """A moving robot under the paper's filter: most samples count as outliers."""
    messages = [
        imu_message(10**18 + k * 10**7, (10 * np.sin(k / 10), 0, 0), (0, 0, 9.8))
        for k in range(400)
    ]
    filter_ = MessageFilter(Parameters(method='kalman', epsilon=1e-3))
    health = Health()
    filter_.process_batch(messages)
    _, status = health.judge(filter_.report(), 4.0)
    assert status.level == WARN
    assert 'set method to adaptive' in status.message


def quiet(n, deviation, random, rate=100.0):
    """Return messages of a sensor at rest."""
    return [
        imu_message(
            10**18 + int(k * 1e9 / rate),
            deviation * random.standard_normal(3),
            [0, 0, 9.8] + 0.02 * random.standard_normal(3),
        )
        for k in range(n)
    ]


def test_health_tells_of_a_filter_that_is_inert(random):
    """The paper's filter with its own model, on a sensor a hundred times as quiet."""
    messages = quiet(1500, 5e-5, random)
    filter_ = MessageFilter(Parameters(method='kalman'))
    health = Health()
    filter_.process_batch(messages[:500])
    _, status = health.judge(filter_.report(), 5.0)
    assert status.level == WARN
    assert 'far smaller than the filter expects' in status.message
    assert float(status.values['Normalised innovation squared x']) < 0.1
    filter_.filter.configure(Parameters(method='adaptive'))
    for k in range(5, 15):
        filter_.process_batch(messages[100 * k : 100 * k + 100])
        _, status = health.judge(filter_.report(), 1.0)
    assert (status.level, status.message) == (OK, 'filtering')


def test_levels_do_not_flicker(random):
    """A share of outliers between the two limits keeps the level that there was."""
    filter_ = MessageFilter(Parameters(method='kalman', epsilon=1e-3))
    health = Health()
    state, levels = filter_.filter.state, []
    filter_.process_batch(quiet(300, 5e-3, random))
    state['counts']['samples'] = 0
    for share in [0.0] * 12 + [0.08] * 12 + [0.15] * 12 + [0.08] * 12 + [0.02] * 12:
        state['counts']['samples'] += 1000
        state['counts']['nis_samples'] += 1000
        state['counts']['nis_sum'] += 1000.0
        state['counts']['outliers'][0] += round(1000 * share)
        _, status = health.judge(filter_.report(), 1.0)
        levels.append(status.level)
    assert levels[23] == OK
    assert levels[35] == levels[47] == WARN
    assert levels[59] == OK
    assert sum(a != b for a, b in pairwise(levels)) == 2


def test_a_rate_that_is_off_is_told(random):
    messages = quiet(3000, 5e-3, random)
    for parameters, part, message in (
        (Parameters(sample_rate=200.0), 100, 'fewer messages come than sample_rate says'),
        (Parameters(sample_rate=100.0), 100, 'receiving'),
        (Parameters(), 50, 'fewer messages come than their stamps say: are some lost'),
        (Parameters(), 200, 'more messages come than their stamps say'),
    ):
        filter_ = MessageFilter(parameters)
        health = Health()
        for k in range(14):
            filter_.process_batch(messages[part * k : part * (k + 1)])
            status, _ = health.judge(filter_.report(), 1.0)
        assert status.message.startswith(message)
        assert status.level == (OK if message == 'receiving' else WARN)


def levels(health, parts, filter_):
    """Return the messages of the input after each part, a second each."""
    messages = []
    for part in parts:
        filter_.process_batch(part)
        messages.append(health.judge(filter_.report(), 1.0)[0].message)
    return messages


def test_a_silence_is_no_wrong_rate(random):
    """Before the driver starts, while it pauses, and what was kept meanwhile."""
    data = quiet(4000, 5e-3, random)
    seconds = [data[100 * k : 100 * k + 100] for k in range(40)]
    for parameters in (Parameters(), Parameters(sample_rate=100.0)):
        filter_ = MessageFilter(parameters)
        parts = [*[[]] * 15, data[:40], *seconds[1:12], [], [], data[1200:1230], *seconds[13:20]]
        told = levels(Health(), parts, filter_)
        assert not [text for text in told if 'messages come' in text]
        filter_ = MessageFilter(parameters)
        told = levels(Health(), [*[[]] * 9, data[:2000], *seconds[20:]], filter_)
        assert not [text for text in told if 'messages come' in text]


def test_a_message_that_comes_again_and_again(random):
    data = quiet(300, 5e-3, random)
    filter_ = MessageFilter(Parameters())
    told = levels(Health(), [data[:100], data[100:200], 100 * [data[199]]], filter_)
    assert told[1] == 'receiving'
    assert told[2].startswith('the same message comes again and again')


def test_stamps_that_go_to_and_fro_or_are_none(random):
    """Two sensors of one name; a driver that does not stamp."""
    a, b = quiet(1200, 5e-3, random), quiet(1200, 5e-3, random)
    late = [
        imu_message(read_imu(m).stamp - 20_000_000, read_imu(m).angular_velocity, (0, 0, 9.8))
        for m in b
    ]
    both = [message for pair in zip(a, late, strict=True) for message in pair]
    filter_ = MessageFilter(Parameters())
    told = levels(Health(), [both[200 * k : 200 * k + 200] for k in range(12)], filter_)
    assert told[-1].startswith('many stamps go backward')
    none = [imu_message(0, read_imu(m).angular_velocity, (0, 0, 9.8)) for m in a]
    for rate, text in ((0.0, 'the driver does not stamp'), (100.0, 'receiving')):
        filter_ = MessageFilter(Parameters(sample_rate=rate))
        told = levels(Health(), [none[100 * k : 100 * k + 100] for k in range(12)], filter_)
        assert told[-1].startswith(text)


def test_a_dead_band_and_coarse_steps_are_no_fault(random):
    """Zeros at rest are noise that is not there; a flat top of a turn is not the range's end."""
    step = np.radians(0.061)
    seconds = np.arange(6000) / 200.0
    turn = 2.5 + 0.5 * np.sin(2 * np.pi * 0.3 * seconds)
    rates = turn[:, None] + np.radians(0.05) * random.standard_normal((6000, 3))
    rates = np.round(rates / step) * step
    filter_ = MessageFilter(Parameters())
    messages = [
        imu_message(10**18 + 5_000_000 * k, rate, [0, 0, 9.8] + 0.02 * random.standard_normal(3))
        for k, rate in enumerate(rates)
    ]
    health = Health()
    told = levels(health, [messages[200 * k : 200 * k + 200] for k in range(30)], filter_)
    assert set(told) == {'receiving'}
    still = [
        imu_message(2 * 10**18 + 5_000_000 * k, (0, 0, 0), 0.02 * random.standard_normal(3))
        for k in range(4000)
    ]
    for k in range(20):
        filter_.process_batch(still[200 * k : 200 * k + 200])
        input_, status = health.judge(filter_.report(), 1.0)
        assert k < 2 or (input_.message, status.message) == ('receiving', 'filtering')


def test_telemetry_is_that_of_the_state(random):
    filter_ = MessageFilter(Parameters())
    filter_.process_batch([*simulated(500), b'junk'])
    state, told = filter_.filter.state, filter_.report().telemetry
    counts, clock, bias = state['counts'], state['clock'], state['bias']
    checks = state['checks']
    expected = {
        **{name: counts[name] for name in ('samples', 'repeats', 'refused')},
        **{name: checks[name] for name in ('unusable', 'clipped', 'beyond_range', 'times_stuck')},
        'outliers': counts['outliers'],
        **{name: counts[name] for name in ('nis_samples', 'nis_sum')},
        **{name: clock[name] for name in ('period', 'blocks', 'gaps', 'missing_samples')},
        **{name: clock[name] for name in ('restarts', 'zero_stamps', 'same_stamps')},
        'backward_stamps': clock['backward_stamps'],
        'divergences': state['methods']['paper']['divergences'],
        'stuck': checks['stuck'],
        'all_zero': not checks['measured'].any(),
        'process_noise': state['result']['process_noise'],
        'measurement_noise': state['result']['measurement_noise'],
        **{name: bias[name] for name in ('bias', 'beyond', 'rest_seconds')},
        'packages': bias['segments'],
        **{name: bias[name] for name in ('beyond_max', 'turning')},
        'bias_deviation': filter_.filter.bias_deviation if bias['known'] else np.full(3, np.nan),
        'at_rest': bias['rest']['at_rest'],
    }
    assert expected.keys() == told._asdict().keys()
    for name, value in told._asdict().items():
        np.testing.assert_array_equal(value, expected[name], err_msg=name)
    assert told.samples == 500
    assert told.packages > 0


def test_counts_that_a_reset_clears_are_no_fault(random):
    filter_, health = MessageFilter(Parameters()), Health()
    messages = quiet(500, 5e-3, random)
    for k in range(88, 100):
        stamp = read_imu(messages[k]).stamp
        messages[k] = imu_message(stamp, (8.7 if k < 97 else np.nan, 0.01, 0.02), (0, 0, 9.8))
    filter_.process_batch(messages[:100])
    assert 'end of the measuring range' in health.judge(filter_.report(), 1.0)[0].message
    assert any(filter_.report().telemetry.unusable)
    filter_.filter.reset()
    filter_.process_batch(messages[100:300])
    assert health.judge(filter_.report(), 2.0)[0].message == 'receiving'


def test_health_survives_a_reset():
    filter_ = MessageFilter(Parameters())
    health = Health()
    filter_.process_batch(simulated(300))
    health.judge(filter_.report(), 3.0)
    filter_.filter.reset()
    filter_.process_batch(simulated(100))
    input_, status = health.judge(filter_.report(), 1.0)
    assert (input_.level, status.level) == (OK, OK)
    assert status.values['Outliers of late (%) x'] == 'nan'  # too few to tell
    filter_.process_batch(simulated(400)[100:])
    _, status = health.judge(filter_.report(), 3.0)
    assert 0 < float(status.values['Outliers of late (%) x']) < 10
