"""The Imu messages of a chunk, by the compiled reader."""

import numpy as np

from gyro_drift_filter.bags.chunk_kernels import CHANNELS
from gyro_drift_filter.messages.imu_kernels import IMU, no_frame, read_imus, room_for_doubles


def read_all(data, rows):
    """Return the IMUs of all messages that ROWs tell of."""
    imus, places = np.zeros(len(rows), IMU), np.zeros(len(rows), np.int64)
    ours = np.ones(CHANNELS, np.bool_)
    assert read_imus(data, rows, ours, room_for_doubles(), no_frame(), imus, places) == len(rows)
    return imus
