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

"""Inputs that nobody meant, for all that reads bytes from elsewhere: none may crash, hang or bloat.

    PYTHONPATH=test python -m support.fuzz [--inputs 1000000] [--only TARGET ...]

Edits seeds at random. What fails is kept in test/corpus, and tested from then on.
"""

import argparse
import hashlib
import json
import logging
import resource
import struct
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path
from random import Random

import numpy as np
from mcap.writer import CompressionType

from gyro_drift_filter.bags.recording import Piece
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.core import ParameterError, Parameters
from gyro_drift_filter.core.bias.shift import BiasShift
from gyro_drift_filter.mcap.reader import read_layout
from gyro_drift_filter.mcap.records import McapError
from gyro_drift_filter.mcap.recovery import is_cut_off, recover
from gyro_drift_filter.messages.imu import (
    EXAMPLE,
    IMU_TYPE,
    ImuKind,
    fault_text,
    frame_id,
    read_message,
)
from gyro_drift_filter.messages.memory_file import (
    MemoryFileError,
    RememberedBias,
    recall,
    remember,
)
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.simulation.bag import TOPIC, imu_message
from support.bags import write_mcap
from support.chunks import EACH_CHANNEL, imus_of, read_messages
from support.messages import START, TEXT, doubles_of, fault_of, text
from support.paths import PARAMETER_FILE, TESTS

CORPUS = TESTS / 'corpus'
LONGEST = 1.0  # s
LARGEST = 2**30  # bytes, beyond what the process has at its begin
# Lengths and counts that lie.
NUMBERS = [
    0,
    1,
    2,
    3,
    31,
    255,
    2**15,
    2**16 - 1,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**62,
    2**63,
    2**64 - 1,
]
WORDS = [
    b'*a',
    b'&a ',
    b'{',
    b'[' * 50,
    b'- ',
    b': ',
    b'\n',
    b'!!python/name:os',
    b'"',
    b'1e999',
    b'.nan',
    b'1' * 400,
]
DOUBLES = [struct.pack('<d', x) for x in (0.0, -0.0, 5e-324, 1e308, np.inf, -np.inf, np.nan)]
FILTER = MessageFilter(Parameters())  # of all inputs of this process
NODE, FRAME = '/gyro_drift_filter', 'imu_link'


def edited(random: Random, seeds: Sequence[bytes]) -> bytes:
    """Return a seed with a few edits, or any bytes."""
    if random.randrange(20) == 0:
        return random.randbytes(random.randrange(600))
    data = bytearray(random.choice(seeds))
    for _ in range(random.randint(1, 4)):
        place = random.randrange(max(1, len(data)))
        match random.randrange(8):
            case 0:
                data[place : place + 1] = random.randbytes(1)
            case 1:
                data = data[:place]
            case 2:
                layout = random.choice(['<B', '<H', '<I', '<Q', '>I'])
                number = random.choice(NUMBERS) % 256 ** struct.calcsize(layout)
                data[place : place + struct.calcsize(layout)] = struct.pack(layout, number)
            case 3:
                data[place:place] = random.randbytes(random.randrange(20))
            case 4:
                del data[place : place + random.randint(1, 40)]
            case 5:
                other = random.randrange(max(1, len(data)))
                data[place : place + random.randint(1, 60)] = data[other : other + 60]
            case 6:
                data[place:place] = random.choice(WORDS)
            case 7:
                data[place : place + 8] = random.choice([random.randbytes(8), *DOUBLES])
    return bytes(data)


@contextmanager
def in_one_line(kind):
    """Let an error of this kind pass that is told in one line of text."""
    try:
        yield
    except kind as error:
        if '\n' in str(error):
            raise AssertionError('more than a line') from error


def check_cdr(data, folder):
    """Check that the kernel and a plain reader agree, and nothing but finite numbers comes out."""
    filtered, imu = FILTER.take(data), read_message(data)
    fault = fault_of(data)
    assert (imu['kind'] == ImuKind.MALFORMED) == (fault is not None)
    if fault is not None:
        assert (filtered, fault_text(imu['fault'])) == (None, fault)
        return
    doubles = doubles_of(data)
    np.testing.assert_array_equal(imu['sample']['angular_velocity'], doubles[13:16])
    assert (imu['kind'] == ImuKind.GOOD) == (doubles[16] != -1.0)
    frame_id(data, imu)
    if filtered is not None:
        assert fault_of(filtered) is None
        assert imu['kind'] == ImuKind.NOT_REPORTED or np.isfinite(doubles_of(filtered)[13:25]).all()


def check_mcap(data, folder):
    """Check that the reader of chunks walks the file, or says why not."""
    path = folder / 'in.mcap'
    path.write_bytes(data)
    layout = read_layout(path)
    if layout is None:
        return
    with in_one_line(McapError):
        for chunk, rows in read_messages(path, layout, EACH_CHANNEL):
            assert (rows['start'] + rows['size'] <= len(chunk)).all()
            imus_of(Piece(chunk, rows))


def check_recovery(data, folder):
    """Check that what is cut off is recovered as a sound file, or it says why not."""
    path, copy = folder / 'cut.mcap', folder / 'copy.mcap'
    path.write_bytes(data)
    if not is_cut_off(path):
        return
    copy.unlink(missing_ok=True)
    with in_one_line(McapError):
        count = recover(path, copy)
        assert not is_cut_off(copy)
        assert count == 0 or copy.stat().st_size > 31 * count


def check_parameters(data, folder):
    """Parameters, or one line."""
    path = folder / 'p.yaml'
    path.write_bytes(data)
    with in_one_line(ParameterError):
        assert read_parameters(path) == read_parameters(path)


def check_memory(data, folder):
    """Check that there is a bias, or one line."""
    path = folder / 'bias.json'
    path.write_bytes(data)
    with in_one_line(MemoryFileError):
        found = recall(path, NODE, FRAME, 0.2)
        assert found is not None
        assert np.isfinite([*found.bias, *found.deviation]).all()
        assert max(map(abs, found.bias)) <= 0.2


def mcap_seeds():
    """Return small files of all kinds."""
    rows = []
    for k in range(6):
        rows.append((TOPIC, IMU_TYPE, START + k, imu_message(START + k, (0.1, 0, 0), (0, 0, 9.8))))
        rows.append(('/words', TEXT, START + k, text('word')))
    forms = [{'compression': c, 'chunk_size': 900} for c in CompressionType]
    forms += [{'use_chunking': False}, {'enable_crcs': False, 'compression': CompressionType.NONE}]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'seed.mcap'
        return [write_mcap(path, rows, **form).read_bytes() for form in forms]


def memory_seeds():
    """Return a file as it is written."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'bias.json'
        shift = BiasShift((2e-4, -8e-4, 1e-3), (3e-4,) * 3)
        remember(path, NODE, FRAME, RememberedBias((0.01, -0.02, 0.0), (1e-4,) * 3, shift))
        return [path.read_bytes(), json.dumps({'format': 2, 'node': NODE, 'frame': FRAME}).encode()]


def seeds_of(name):
    """Return the inputs that are edited."""
    match name:
        case 'cdr':
            named = imu_message(START, (0.1, 0.2, 0.3), (0, 0, 9.8), frame='a frame')
            return [EXAMPLE, imu_message(START, (1, 2, 3), (0, 0, 9.8)), named, named + bytes(3)]
        case 'mcap':
            return mcap_seeds()
        case 'recovery':
            return [data[: 2 * len(data) // 3] for data in mcap_seeds()]
        case 'parameters':
            shipped = PARAMETER_FILE.read_bytes()
            return [
                shipped,
                b'/**: {ros__parameters: {method: kalman, epsilon: 1, model: {phi: [0, 0, 0]}}}\n',
                b'a: {gyro_drift_filter: {ros__parameters: {outlier: {run: 3}}}}\n',
            ]
    return memory_seeds()


# Target: what checks an input, and its share of all inputs.
TARGETS = {
    'cdr': (check_cdr, 0.5),
    'mcap': (check_mcap, 0.1),
    'recovery': (check_recovery, 0.05),
    'parameters': (check_parameters, 0.1),
    'memory': (check_memory, 0.25),
}


def check(name, data, folder):
    """Check one input, its time included; a machine that is busy gets a second chance."""
    for chance in range(2):
        begin = time.monotonic()
        TARGETS[name][0](data, folder)
        if time.monotonic() - begin < LONGEST:
            return
        assert chance == 0, f'takes more than {LONGEST:g} s'


def keep(name, data):
    """Keep a failing input."""
    path = CORPUS / name / hashlib.sha256(data).hexdigest()[:16]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def fuzz(name: str, inputs: int, seed: int = 0) -> None:
    """Check so many inputs.

    Raises:
        Exception: Whatever an input has led to, after it was kept.
    """
    random, seeds = Random(f'{name} {seed}'), seeds_of(name)
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(inputs):
            data = edited(random, seeds)
            try:
                check(name, data, Path(folder))
            except Exception:
                print(f'{name}: kept {keep(name, data)}', file=sys.stderr)
                raise


def limit_memory():
    """Let this process have no more than `LARGEST` beyond what it has."""
    pages = int(Path('/proc/self/statm').read_text().split()[0])
    size = pages * resource.getpagesize() + LARGEST
    resource.setrlimit(resource.RLIMIT_AS, (size, resource.RLIM_INFINITY))


def main():
    """Run it, and print how many inputs there were."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--inputs', type=int, default=1_000_000)
    parser.add_argument('--only', nargs='*', default=list(TARGETS), choices=list(TARGETS))
    parser.add_argument('--seed', type=int, default=0)
    options = parser.parse_args()
    for name in options.only:
        fuzz(name, 50)  # compiles
    limit_memory()
    logging.disable()
    for name in options.only:
        inputs, begin = round(options.inputs * TARGETS[name][1]), time.monotonic()
        fuzz(name, inputs, options.seed)
        print(f'{name}: {inputs:,} inputs in {time.monotonic() - begin:.0f} s', flush=True)


if __name__ == '__main__':
    main()
