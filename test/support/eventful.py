"""A recording in which everything happens, through the kernels compiled or as plain Python.

    PYTHONPATH=test python -m support.eventful OUT.npz numba|plain|extension

A process of its own, as numba has to be there or not before the package is imported.
"""

import os
import sys

import numpy as np

RATE = 50.0
DEGREE = np.pi / 180


def recording(random):
    """Return stamps (n,), rates and accelerations (n, 3): five minutes."""
    n = round(300 * RATE)
    seconds = np.arange(n) / RATE

    def during(first, last):
        return (seconds >= first) & (seconds < last)

    rates = 0.005 * random.standard_normal((n, 3)) + 0.01
    accelerations = np.array([0.0, 0.0, 9.8]) + 0.02 * random.standard_normal((n, 3))
    for first, last in ((15, 19), (40, 44), (150, 153), (240, 243)):
        part = during(first, last)
        window = np.sin(np.pi * (seconds[part] - first) / (last - first))[:, None] ** 2
        wave = np.sin(np.outer(seconds[part], [3.0, 4.0, 5.0]))
        rates[part] += 2.0 * window * wave
        accelerations[part] += window * wave
    # Outliers at rest and in motion: single, in a run, drop-outs, huge, growing.
    for k in (60, 400, 780, 900, 905, 2100):
        rates[k, k % 3] += 1.5
    rates[1200:1203, 0] += 3.0
    rates[1300:1302] = 0.0
    rates[1310:1320] = 0.0
    rates[1400, 1] = 34.0
    rates[1450:1460, 2] += np.linspace(0.0, 4.0, 10)
    rates[1460:1470, 2] += np.linspace(4.0, 0.0, 10)
    rates[1500:1504, 0] += 25.0
    rates[1540:1600, 1] += 1.0  # a step
    # A knock: the accelerometer feels it, too.
    rates[1650, 0] += 2.0
    rates[1651, 0] += 1.0
    accelerations[1650] += 30.0
    # What is no number, or no rate.
    rates[1700, 0] = np.nan
    rates[1710:1730] = np.inf
    rates[1740:1900, 2] = np.nan
    accelerations[1750:1760] = np.nan
    # Stuck, and at the end of the range.
    rates[2300:2420], accelerations[2300:2420] = rates[2300], accelerations[2300]
    rates[during(60, 62)] = np.clip(
        20.0 * np.sin(8.0 * seconds[during(60, 62)])[:, None], -8.7, 8.7
    )
    # Turns that are no bias, and one that stays so long that it is.
    rates[during(70, 80), 2] += 0.8 * DEGREE
    rates[during(90, 100), 2] += 15.0 * DEGREE
    rates[during(155, 230), 1] += 6e-4 * (seconds[during(155, 230)] - 155)
    rates[seconds >= 160, 0] += 1.0 * DEGREE
    # A vibration that begins.
    rates[during(245, 260)] += 0.05 * np.sin(np.outer(seconds[during(245, 260)], [60, 70, 80]))
    stamps = 10**18 + np.round(seconds * 1e9).astype(np.int64)
    for k, jump in ((5200, 0.2), (5400, 0.9), (5600, 5.0), (5800, -0.5), (6000, -30.0)):
        stamps[k:] += int(jump * 1e9)
    stamps[6200:6205] = 0
    stamps[6300] = stamps[6299]
    stamps[6310], rates[6310] = stamps[6309], rates[6309]
    return stamps, rates, accelerations


def through(filter_, stamps, rates, accelerations, told):
    """Filter, and tell it something on the way: {index: function}."""
    parts, done = [], 0
    for k in [*sorted(told), len(stamps)]:
        parts.append(filter_.run(stamps[done:k], rates[done:k], accelerations[done:k]))
        done = k
        if k in told:
            told[k](filter_)
    return np.concatenate(parts)


def messages():
    """Return the results of the kernels that read, patch and lay out messages."""
    from gyro_drift_filter.bags.chunk_kernels import (
        BATCH,
        ROW,
        end_batches,
        group_index,
        lay_out,
        list_messages,
        place_in_result,
        times_of,
    )
    from gyro_drift_filter.bags.replay_run import payload
    from gyro_drift_filter.bags.statistics import Moments
    from gyro_drift_filter.core import Parameters
    from gyro_drift_filter.core.sample import RESULT
    from gyro_drift_filter.mcap.records import MESSAGE, PREFIX
    from gyro_drift_filter.messages.imu_kernels import IMU, no_frame, read_imus, room_for_doubles
    from gyro_drift_filter.messages.message_filter import MessageFilter
    from support.bags import mixed

    rows = mixed(np.random.default_rng(3), 2)
    topics = sorted({row[0] for row in rows})
    records = b''
    for topic, _, time, data in rows:
        head = (1 + topics.index(topic)).to_bytes(2, 'little') + bytes(4)
        head += time.to_bytes(8, 'little') + time.to_bytes(8, 'little')
        records += PREFIX.pack(MESSAGE, len(head) + len(data)) + head + data
    chunk = np.frombuffer(records, np.uint8)
    listed = np.zeros(len(rows) + 1, ROW)
    known = np.ones(8, np.bool_)
    count = list_messages(chunk, known, listed)
    assert count == len(rows)
    for cut in (1, 20, len(chunk) - 3):
        assert list_messages(chunk[:cut], known, listed.copy()) == -1
    listed = listed[:count]
    ours = np.zeros(8, np.bool_)
    ours[1 + topics.index('/imu/data_raw')] = True
    imus, room, places = np.zeros(count, IMU), room_for_doubles(), np.zeros(count, np.int64)
    n = read_imus(chunk, listed, ours, room, no_frame(), imus, places)
    imus, mine = imus[:n], listed[places[:n]]
    batch, ends = np.zeros(1, BATCH), np.zeros(count, BATCH)
    ended = end_batches(listed, 7, 10**8, batch, ends)
    results, filtered = np.zeros(n, RESULT), MessageFilter(Parameters())
    marks = [0, n // 3, n // 3, n]
    marked = filtered.process_imus(
        imus, range(n), lambda k: payload(chunk, mine[k]), results, marks
    )
    out, index = np.zeros(8 * len(chunk), np.uint8), np.zeros((9 * len(rows), 2), np.int64)
    channels = np.zeros(len(index), np.int64)
    reports = np.array([(0, 5, 2), (3, 6, 2), (3, 7, 9)])
    size, count, written = lay_out(
        chunk,
        listed,
        np.arange(8) % 3,
        ours,
        imus,
        results,
        results.view(np.uint8).reshape(n, -1),
        room,
        9,
        np.array([[10, place_in_result('innovation')], [11, place_in_result('bias')]]),
        12,
        np.array([-1.0]),
        13,
        reports,
        np.frombuffer(b'of health', np.uint8),
        out,
        channels,
        index,
    )
    counts = filtered.received, filtered.malformed, filtered.not_reported, filtered.frame_changes
    moments = Moments()
    moments.add(imus['sample']['angular_velocity'], results['angular_velocity'])
    moments.add_results(imus, results)
    grouped, times = np.zeros((count, 2), '<u8'), np.array([2**64 - 1, 0], '<u8')
    places = np.cumsum(np.bincount(channels[:count])) - np.bincount(channels[:count])
    group_index(channels[:count], index[:count].view('<u8'), places, grouped, times)
    filter_, flags = MessageFilter(Parameters()), []
    for topic, _, _, data in rows:
        if topic == '/imu/data_raw':
            flags.append(filter_.step(data))
    return {
        'records': out[:size],
        'written': np.array(written),
        'counts': np.array(counts),
        'told': np.nan_to_num([np.hstack(r.telemetry) for r in marked]),
        'counts_at_marks': np.array([r[:2] + r[3:5] for r in marked]),
        'means': np.array([s.mean for s in moments.statistics()]),
        'deviations': np.array([s.deviation for s in moments.statistics()]),
        'batches': np.concatenate((ends[:ended], batch)).view(np.int64),
        'grouped': grouped,
        'times': np.array([*times, *times_of(listed)]),
        'channels': channels[:count],
        'index': index[:count],
        'stamps': imus['sample']['stamp'],
        'kinds': imus['kind'],
        'flags': np.array(flags),
    }


def main(out, way):
    """Save all results."""
    if way == 'plain':
        os.environ['NUMBA_DISABLE_JIT'] = '1'
        sys.modules['numba'] = None
    from gyro_drift_filter.accelerate.kernels import is_compiled, is_extension
    from gyro_drift_filter.core import Filter, GyroDriftFilterError, Parameters
    from gyro_drift_filter.core.methods import METHOD_NAMES

    assert is_extension() == (way == 'extension')
    assert is_compiled() == (way != 'plain')

    def calibrate(filter_):
        try:
            filter_.calibrate()
        except GyroDriftFilterError:
            filter_.reset()

    told = {
        700: lambda f: f.note_temperature(20.0),
        800: lambda f: f.note_temperature(25.0),
        1000: lambda f: f.hint(True),
        1100: lambda f: f.hint(False),
        3700: lambda f: f.hint(False),
        7000: calibrate,
        7700: calibrate,
        10_400: lambda f: f.note_temperature(np.nan),
        14_000: lambda f: f.configure(Parameters(method='kalman', sample_rate=RATE)),
        14_100: lambda f: f.configure(Parameters(model_noise_deviation=(0.004,) * 3)),
        14_400: lambda f: f.configure(Parameters(sample_rate=100.0, outlier_enabled=False)),
    }
    data = recording(np.random.default_rng(1))
    saved = messages()
    for method in METHOD_NAMES:
        n = len(data[0]) if method == 'adaptive' else 2500
        filter_ = Filter(Parameters(method=method))
        results = through(
            filter_, *(part[:n] for part in data), {k: f for k, f in told.items() if k < n}
        )
        saved |= {f'{method} {name}': results[name] for name in results.dtype.names}
        bias = filter_.state['bias']
        saved |= {f'{method} {name}': bias[name] for name in ('segments', 'turning', 'beyond_max')}
    still = Filter(Parameters(bias_initial=(0.01, 0.0, 0.0)))
    silent = np.full_like(data[2][:1500], np.nan)
    results = still.run(data[0][:1500], data[1][:1500] * 0.0, silent)
    saved |= {f'zeros {name}': results[name] for name in results.dtype.names}
    np.savez(out, **saved)


if __name__ == '__main__':
    main(*sys.argv[1:])
