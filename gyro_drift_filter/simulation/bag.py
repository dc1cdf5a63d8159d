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

"""Write simulated data as a bag, with its truth beside it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.bags.message_types import message_type, serialize
from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.errors import reason
from gyro_drift_filter.messages.imu import ACCELERATION, DOUBLES, ENCAPSULATION, IMU_TYPE, RATE
from gyro_drift_filter.simulation.experiments import Simulation

TOPIC = '/imu/data_raw'
FRAME = 'imu_link'
_NOT_REPORTED = np.array([-1.0] + 8 * [0.0])
_UNKNOWN = np.zeros(9)
# Messages that `imu_messages` holds in memory, a third of a megabyte.
_AT_ONCE = 1000
# Of a truth: between fewer, no rate can be interpolated.
_FEWEST_SAMPLES = 2


def imu_message(
    stamp: int,
    angular_velocity: Any,
    linear_acceleration: Any,
    frame: str = FRAME,
    covariance: Any = _UNKNOWN,
    acceleration_covariance: Any = _UNKNOWN,
) -> bytes:
    """Return a serialized `sensor_msgs/msg/Imu` without orientation.

    Args:
        stamp: header.stamp in ns.
        angular_velocity: (3,) in rad/s.
        linear_acceleration: (3,) in m/s^2.
        frame: header.frame_id.
        covariance: angular_velocity_covariance (9,) in (rad/s)^2.
        acceleration_covariance: linear_acceleration_covariance (9,) in (m/s^2)^2.
    """
    vector = message_type('geometry_msgs/msg/Vector3')
    header = message_type('std_msgs/msg/Header')
    time = message_type('builtin_interfaces/msg/Time')
    message = message_type(IMU_TYPE)(
        header(time(stamp // 10**9, stamp % 10**9), frame),
        message_type('geometry_msgs/msg/Quaternion')(0.0, 0.0, 0.0, 1.0),
        _NOT_REPORTED,
        vector(*(float(v) for v in angular_velocity)),
        np.asarray(covariance, np.float64),
        vector(*(float(v) for v in linear_acceleration)),
        np.asarray(acceleration_covariance, np.float64),
    )
    return serialize(message, IMU_TYPE)


def imu_messages(
    stamps: Integers, rates: Any, accelerations: Any, **options: Any
) -> Iterator[tuple[int, bytes]]:
    """Yield the stamp of each sample in ns, and its message, as `imu_message` makes it.

    One is serialized, into whose copies the values are written for many samples at once: that is
    many times faster.

    Args:
        stamps: (n,) in ns.
        rates: (n, 3) in rad/s.
        accelerations: (n, 3), or (3,) for all, in m/s^2.
        options: Others of `imu_message`.
    """
    message = np.frombuffer(imu_message(0, np.zeros(3), np.zeros(3), **options), np.uint8)
    doubles = len(message) - 8 * DOUBLES
    times = np.stack(np.divmod(stamps, 10**9), axis=1).astype('<i4')
    rates, forces = (np.broadcast_to(v, (len(stamps), 3)) for v in (rates, accelerations))
    for first in range(0, len(stamps), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        copies = np.tile(message, (len(stamps[part]), 1))
        for start, values in (
            (ENCAPSULATION, times[part]),
            (doubles + 8 * RATE, np.ascontiguousarray(rates[part], '<f8')),
            (doubles + 8 * ACCELERATION, np.ascontiguousarray(forces[part], '<f8')),
        ):
            written = values.view(np.uint8)
            copies[:, start : start + written.shape[1]] = written
        for stamp, copy in zip(stamps[part].tolist(), copies, strict=True):
            yield stamp, copy.tobytes()


def truth_path(bag: Path) -> Path:
    """Return where the truth of a simulated bag stands: beside it."""
    return bag.with_name(f'{bag.name}_truth.npz')


def write_simulation(bag: Path, simulation: Simulation) -> Path:
    """Write a bag with the Imu topic, and a numpy archive with the truth; return its path.

    The messages state the variance of the sensor's own noise, as a driver should. The archive holds
    the arrays of `Simulation` by name, n samples: stamps, truth, outliers,
    moving, bias.

    Raises:
        BagError: The bag or the archive exists already or can't be written.
    """
    if not bag.name:  # as of . and /
        raise BagError(f'{bag} exists already: choose another name')
    archive = truth_path(bag)
    if archive.exists():
        raise BagError(f'{archive} exists already: remove it or choose another name')
    covariance, acceleration_covariance = _covariances(simulation)
    with BagWriter(bag) as writer:
        connection = writer.add_connection(TOPIC, IMU_TYPE)
        for stamp, message in imu_messages(
            simulation.stamps,
            simulation.angular_velocity,
            simulation.linear_acceleration,
            covariance=covariance,
            acceleration_covariance=acceleration_covariance,
        ):
            writer.write(connection, stamp, message)
    try:
        np.savez_compressed(
            archive,
            stamps=simulation.stamps,
            truth=simulation.truth,
            outliers=simulation.outliers,
            moving=simulation.moving,
            bias=simulation.bias,
        )
    except OSError as error:
        archive.unlink(missing_ok=True)
        raise BagError(f'{archive} can not be written: {reason(error)}') from error
    return archive


def read_truth(archive: Path) -> tuple[Integers, Floats]:
    """Return stamps (n,) in ns and true rates (n, 3) in rad/s, as `write_simulation` writes them.

    A rate of NaN is one that is not known.

    Raises:
        BagError: The archive can't be read, or holds something else.
    """
    try:
        # Opened here, as numpy leaves a damaged archive open.
        with archive.open('rb') as file, np.load(file) as arrays:
            stamps, truth = arrays['stamps'], arrays['truth']
    except Exception as error:  # a damaged archive raises nearly anything out of the parser
        raise BagError(
            f'no truth in {archive}: it must be a numpy archive (.npz) of stamps and truth '
            f'({reason(error)})'
        ) from error
    wrong = ''
    if stamps.ndim != 1 or stamps.dtype.kind not in 'iu':
        wrong = f'stamps must be whole numbers (n,) in ns, not {stamps.dtype} {stamps.shape}'
    elif truth.shape[1:] != (3,) or truth.dtype.kind != 'f':
        wrong = (
            f'truth must be floating-point numbers (n, 3) in rad/s, not {truth.dtype} {truth.shape}'
        )
    elif len(stamps) != len(truth):
        wrong = f'there are {len(stamps)} stamps for {len(truth)} rates'
    elif len(stamps) < _FEWEST_SAMPLES:
        wrong = f'there are fewer than {_FEWEST_SAMPLES} samples'
    if wrong:
        raise BagError(f'no truth in {archive}: {wrong}')
    return stamps.astype(np.int64), truth.astype(np.float64)


def _covariances(simulation: Simulation) -> list[Floats]:
    """Return those of rates and accelerations, (9,) each; zeros, unknown, without samples at rest.

    Motion is no noise of an accelerometer, so its samples at rest count.
    """
    noises = (
        (simulation.angular_velocity - simulation.truth)[~simulation.outliers.any(axis=1)],
        simulation.linear_acceleration[~simulation.moving],
    )
    return [np.diag(noise.var(0)).ravel() if len(noise) else _UNKNOWN for noise in noises]
