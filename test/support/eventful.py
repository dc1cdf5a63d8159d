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

"""A recording in which everything happens, through the kernels compiled or as plain Python.

    PYTHONPATH=test python -m support.eventful OUT.npz numba|plain|extension

A process of its own, as numba has to be there or not before the package is imported.
"""

import os
import sys
import tempfile
from pathlib import Path

import numpy as np

RATE = 25.0
DEGREE = np.pi / 180


def recording(random):
    """Return stamps (n,), rates and accelerations (n, 3): five minutes."""
    n = round(300 * RATE)
    seconds = np.arange(n) / RATE

    def during(first, last):
        return (seconds >= first) & (seconds < last)

    def at(*moments):
        return [round(moment * RATE) for moment in moments]

    def for_samples(first, count):
        (k,) = at(first)
        return slice(k, k + count)

    rates = 0.005 * random.standard_normal((n, 3)) + 0.01
    accelerations = np.array([0.0, 0.0, 9.8]) + 0.02 * random.standard_normal((n, 3))
    for first, last in ((15, 19), (40, 44), (150, 153), (240, 243)):
        part = during(first, last)
        window = np.sin(np.pi * (seconds[part] - first) / (last - first))[:, None] ** 2
        wave = np.sin(np.outer(seconds[part], [3.0, 4.0, 5.0]))
        rates[part] += 2.0 * window * wave
        accelerations[part] += window * wave
    # Outliers at rest and in motion: single, in a run, drop-outs, huge, growing.
    for k in at(1.2, 8.0, 15.6, 18.0, 18.2, 42.0):
        rates[k, k % 3] += 1.5
    rates[for_samples(24.0, 3), 0] += 3.0
    rates[for_samples(26.0, 2)] = 0.0
    rates[for_samples(26.4, 10)] = 0.0
    rates[at(28.0), 1] = 34.0
    rates[for_samples(29.0, 10), 2] += np.linspace(0.0, 4.0, 10)
    rates[for_samples(29.4, 10), 2] += np.linspace(4.0, 0.0, 10)
    rates[for_samples(30.0, 4), 0] += 25.0
    rates[during(30.8, 32.0), 1] += 1.0  # a step
    # A knock: the accelerometer feels it, too.
    (knock,) = at(33.0)
    rates[knock, 0] += 2.0
    rates[knock + 1, 0] += 1.0
    accelerations[knock] += 30.0
    # What is no number, or no rate.
    rates[at(34.0), 0] = np.nan
    rates[for_samples(34.2, 20)] = np.inf
    rates[during(35.0, 38.0), 2] = np.nan
    accelerations[for_samples(35.2, 10)] = np.nan
    # Stuck, and at the end of the range.
    (stuck,) = at(46.0)
    rates[during(46.0, 48.4)] = rates[stuck]
    accelerations[during(46.0, 48.4)] = accelerations[stuck]
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
    jumps = {104.0: 0.2, 108.0: 0.9, 112.0: 5.0, 116.0: -0.5, 120.0: -30.0}
    for k, jump in zip(at(*jumps), jumps.values(), strict=True):
        stamps[k:] += int(jump * 1e9)
    stamps[for_samples(124.0, 5)] = 0
    same, twice = at(126.0, 126.2)
    stamps[same] = stamps[same - 1]
    stamps[twice], rates[twice] = stamps[twice - 1], rates[twice - 1]
    (late,) = at(127.0)
    for values in (stamps, rates, accelerations):
        values[[late, late + 1]] = values[[late + 1, late]]  # it comes after the next one
    return stamps, rates, accelerations


def through(filter_, stamps, rates, accelerations, commands):
    """Filter, and give it commands on the way: {index: function}."""
    parts, done = [], 0
    for k in [*sorted(commands), len(stamps)]:
        parts.append(filter_.run(stamps[done:k], rates[done:k], accelerations[done:k]))
        done = k
        if k in commands:
            commands[k](filter_)
    return np.concatenate(parts)


def messages():
    """Return the results of the kernels that read, filter and write messages."""
    from gyro_drift_filter.bags.replay import replay
    from gyro_drift_filter.core import Parameters
    from gyro_drift_filter.mcap.message_kernels import rows_of
    from gyro_drift_filter.mcap.reader import read_layout
    from gyro_drift_filter.messages.imu import read_message
    from gyro_drift_filter.messages.message_filter import NOTE, MessageFilter
    from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS
    from support.bags import mixed, write_mcap
    from support.chunks import EACH_CHANNEL, imus_of, piece_of, read_messages

    rows = mixed(np.random.default_rng(3), 3)
    with tempfile.TemporaryDirectory() as folder:
        source = write_mcap(Path(folder) / 'in.mcap', rows, chunk_size=30_000)
        out = Path(folder) / 'out'
        (summary,) = replay(source, out, parameters=Parameters(), diagnostics=True)
        written = out / 'out.mcap'
        file = np.frombuffer(written.read_bytes(), np.uint8)
        layout = read_layout(written)
        assert layout is not None
        chunks = list(read_messages(written, layout, EACH_CHANNEL))
    data, listed = chunks[0]
    for cut in (1, 20, len(data) - 3):
        assert rows_of(data[:cut], EACH_CHANNEL) is None
    imu_messages = [message for topic, _, _, message in rows if topic == '/imu/data_raw']
    alone = [read_message(message) for message in imu_messages]
    piece = piece_of(imu_messages)
    imus = imus_of(piece)
    at_once, one_by_one = MessageFilter(Parameters()), MessageFilter(Parameters())
    notes = np.zeros(4, NOTE)
    notes['index'] = [0, 100, 100, len(imus)]
    at_once.take_imus(piece.data, imus, notes)
    taken = [one_by_one.take(message) or b'' for message in imu_messages]
    samples = [one_by_one.sample_message(topic) for topic in SAMPLE_TOPICS]
    good = imus[imus['kind'] == 0]
    return {
        'written': file,
        'records': np.concatenate([data for data, _ in chunks]),
        'rows': np.array([row.tolist() for row in listed]),
        'counts': np.array([summary.received, summary.written, summary.not_reported]),
        'faults': np.array([imu['fault'].tolist() for imu in alone if imu['kind'] == 2]),
        'stamps': good['sample']['stamp'],
        'kinds': imus['kind'],
        'status': good['result']['status'],
        'taken': np.frombuffer(b''.join(taken), np.uint8),
        'samples': np.frombuffer(b''.join(samples), np.uint8),
        'telemetry': np.nan_to_num([np.hstack(r.telemetry) for r in at_once.reports(notes)]),
        'counts of reports': np.array([r[:2] + r[3:5] for r in at_once.reports(notes)]),
    }


def main(out, way):
    """Save all results."""
    if way == 'plain':
        os.environ['NUMBA_DISABLE_JIT'] = '1'
        sys.modules['numba'] = None  # type: ignore[assignment]  # its import fails
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

    commands = {
        14.0: lambda f: f.note_temperature(20.0),
        16.0: lambda f: f.note_temperature(25.0),
        20.0: lambda f: f.hint(True),
        22.0: lambda f: f.hint(False),
        74.0: lambda f: f.hint(False),
        140.0: calibrate,
        154.0: calibrate,
        208.0: lambda f: f.note_temperature(np.nan),
        280.0: lambda f: f.configure(Parameters(method='kalman', sample_rate=RATE)),
        282.0: lambda f: f.configure(Parameters(model_noise_deviation=(0.004,) * 3)),
        288.0: lambda f: f.configure(Parameters(sample_rate=100.0, outlier_enabled=False)),
    }
    commands = {round(moment * RATE): command for moment, command in commands.items()}
    stamps, rates, accelerations = recording(np.random.default_rng(1))
    saved = messages()
    for method in METHOD_NAMES:
        n = len(stamps) if method == 'adaptive' else round(50.0 * RATE)
        filter_ = Filter(Parameters(method=method))
        results = through(
            filter_,
            stamps[:n],
            rates[:n],
            accelerations[:n],
            {k: f for k, f in commands.items() if k < n},
        )
        saved |= {f'{method} {name}': results[name] for name in results.dtype.names}
        bias = filter_.state['bias']
        saved |= {
            f'{method} {name}': bias[name]
            for name in ('segments', 'segments_turning', 'segments_beyond_max')
        }
    still = Filter(Parameters(bias_initial=(0.01, 0.0, 0.0)))
    silent = np.full((300, 3), np.nan)
    results = still.run(stamps[:300], np.zeros((300, 3)), silent)
    saved |= {f'zeros {name}': results[name] for name in results.dtype.names}
    np.savez(out, **saved)


if __name__ == '__main__':
    main(*sys.argv[1:])
