"""`gyro_drift compile`: compile the kernels ahead, so that no start has to wait for it."""

import argparse
import sys
import time
from typing import Any

import numpy as np

from gyro_drift_filter.accelerate.ahead import build_extension
from gyro_drift_filter.accelerate.kernels import (
    is_compiled,
    is_extension,
    note_all_compiled,
    note_no_extension,
)
from gyro_drift_filter.bags.chunk_kernels import (
    BATCH,
    ROW,
    end_batches,
    group_index,
    lay_out,
    list_messages,
    times_of,
)
from gyro_drift_filter.bags.statistics import Moments
from gyro_drift_filter.core import GyroDriftFilterError, Parameters, commands
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.sample import RESULT
from gyro_drift_filter.messages.cdr import EXAMPLE
from gyro_drift_filter.messages.diagnostics import diagnostic_arrays
from gyro_drift_filter.messages.imu_kernels import IMU, no_frame, read_imus, room_for_doubles
from gyro_drift_filter.messages.message_filter import MessageFilter


def add_parser(subcommands: Any) -> None:
    """Add the subcommand to the parser of `gyro_drift`."""
    command = subcommands.add_parser(
        'compile',
        help='compile ahead of the first start',
        description='Compile all kernels and keep them in ~/.cache/gyro_drift_filter, so that the '
        'first start of the node does not have to. Needed once after an installation.',
    )
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    if not is_compiled():
        raise GyroDriftFilterError('numba is not installed: there is nothing to compile')
    if is_extension():
        print('compiled already')
        return
    begin = time.monotonic()
    compile_all()
    try:
        build_extension()
    except GyroDriftFilterError as error:
        note_no_extension()
        print(f'{error}; without, each start loads numba', file=sys.stderr)
    print(f'compiled in {time.monotonic() - begin:.0f} s')


def compile_all() -> None:
    """Call every kernel that Python calls, so that it is compiled and kept."""
    messages = MessageFilter(Parameters())
    messages.step(EXAMPLE)
    messages.process_batch([EXAMPLE])
    messages.filter.step(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    messages.filter.note_temperature(20.0)
    for method in METHOD_NAMES:
        messages.filter.configure(Parameters(method=method))
        messages.filter.step(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    commands.calibrate(messages.filter.record)
    messages.filter.hint(True)
    data = np.frombuffer(EXAMPLE, np.uint8)
    rows, imus = np.zeros(1, ROW), np.zeros(1, IMU)
    no_channels, zeros = np.zeros(1, np.bool_), np.zeros(1, np.int64)
    list_messages(data[:0], no_channels, rows)
    times_of(rows)
    end_batches(rows, 1, 1, np.zeros(1, BATCH), np.zeros(1, BATCH))
    read_imus(data, rows, no_channels, room_for_doubles(), no_frame(), imus, zeros)
    index = np.zeros((0, 2), '<u8')
    group_index(zeros[:0], index, zeros, index, np.zeros(2, '<u8'))
    results = np.zeros(1, RESULT)
    messages.process_imus(imus, range(1), bytes, results)
    messages.report()
    texts, _ = diagnostic_arrays([])
    lay_out(
        data,
        rows,
        zeros,
        no_channels,
        imus,
        results,
        np.zeros((1, 0), np.uint8),
        room_for_doubles(),
        0,
        np.zeros((0, 2), np.int64),
        0,
        np.zeros(1),
        0,
        np.zeros((0, 3), np.int64),
        texts,
        np.zeros(0, np.uint8),
        np.zeros(0, np.int64),
        np.zeros((0, 2), np.int64),
    )
    Moments().add(np.zeros((0, 3)), np.zeros((0, 3)))
    Moments().add_results(imus[:0], results[:0])
    note_all_compiled()
