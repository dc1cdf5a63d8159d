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

"""Bags of a sensor that a hand turns, sound or with a fault of its driver."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC, imu_messages
from gyro_drift_filter.simulation.experiments import Simulation
from support.handling import HandlingSettings, simulate_handling

SETTINGS = HandlingSettings(motions=2)


def handled(seed: int = 0, **settings: Any) -> Simulation:
    """Return a sensor whose driver stamps to 0.05 ms, as by an interrupt."""
    simulation = simulate_handling(replace(SETTINGS, seed=seed, **settings))
    late = 5e4 * np.random.default_rng(seed).standard_normal(len(simulation.stamps))
    return replace(simulation, stamps=simulation.stamps + late.astype(np.int64))


def logged(simulation: Simulation, seed: int = 0) -> NDArray[np.int64]:
    """Return log times (n,) in ns of a recorder beside the driver."""
    late = 3e5 + np.random.default_rng(seed).exponential(4e5, len(simulation.stamps))
    return np.maximum.accumulate(simulation.stamps + late.astype(np.int64))


def messages(
    simulation: Simulation,
    deviations: tuple[float, float] = (SETTINGS.noise, SETTINGS.acceleration_noise),
    orientations: NDArray[np.float64] | None = None,
) -> list[bytes]:
    """Return serialized Imu messages, with covariances of these deviations.

    `orientations` (n, 4) are x, y, z, w; without them none is reported.
    """
    rate, force = (np.diag(np.square([value] * 3)).ravel() for value in deviations)
    samples = imu_messages(
        simulation.stamps,
        simulation.angular_velocity,
        simulation.linear_acceleration,
        covariance=rate,
        acceleration_covariance=force,
    )
    data = [message for _, message in samples]
    if orientations is None:
        return data
    # The first thirteen of the 37 doubles.
    covariance = np.diag([1e-4] * 3).tobytes()
    return [
        message[: -37 * 8] + orientation.tobytes() + covariance + message[-24 * 8 :]
        for message, orientation in zip(data, orientations, strict=True)
    ]


def write(
    path: Path,
    simulation: Simulation,
    log_times: NDArray[np.int64] | None = None,
    topics: dict[tuple[str, str], list[tuple[int, bytes]]] | None = None,
    **options: Any,
) -> Path:
    """Write a bag; `topics` are others by name and type, options those of `messages`."""
    times = logged(simulation) if log_times is None else log_times
    rows = {
        (TOPIC, IMU_TYPE): list(zip(times.tolist(), messages(simulation, **options), strict=True))
    }
    with BagWriter(path) as writer:
        merged = []
        for (topic, kind), of_topic in (rows | (topics or {})).items():
            connection = writer.add_connection(topic, kind)
            merged += [(time, connection, data) for time, data in of_topic]
        for time, connection, data in sorted(merged, key=lambda row: row[0]):
            writer.write(connection, time, data)
    return path
