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

"""What the node costs on a robot, beside relays that do nothing: CPU, latency, loss, start, memory.

`benchmark.speed` tells it.
"""

import contextlib
import itertools
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
import psutil
import rclpy
from geometry_msgs.msg import Vector3Stamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu

from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS
from gyro_drift_filter.simulation.bag import imu_message
from harness.live_node import EXECUTABLE, LOSSLESS, environment, own_domain

# Works where the working directory is that of the repository.
RELAY = [sys.executable, '-m', 'benchmark.relay']
NODE_COMMAND = [str(EXECUTABLE), '--ros-args']
START = 10**18
WARM_UP = 500  # messages
PATIENCE = 60.0


class Player:
    """Publish Imu messages at a rate to a process under test, and note when its output comes."""

    def __init__(self, command: Sequence[str], *, listen: bool = False) -> None:
        self._context = rclpy.Context()
        domain = own_domain()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node('player', context=self._context)
        deep = QoSProfile(depth=10_000)
        self._player = self._node.create_publisher(Imu, 'imu/data_raw', deep)
        self._node.create_subscription(Imu, 'imu/data_filtered', self._arrived, deep, raw=True)
        self.diagnostics = 0
        if listen:
            for name in SAMPLE_TOPICS:
                self._node.create_subscription(
                    Vector3Stamped, f'gyro_drift_filter/{name}', self._listened, deep, raw=True
                )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._home = tempfile.TemporaryDirectory()
        self.started = time.monotonic()
        self.process = subprocess.Popen(
            command,
            env=environment(domain) | {'ROS_HOME': self._home.name},
            stderr=subprocess.DEVNULL,
        )
        self.arrivals: list[tuple[int, float]] = []
        self.sent: list[float] = []
        self._stop = threading.Event()
        self._spinner = threading.Thread(target=self._spin)

    def __enter__(self) -> 'Player':
        """Begin to receive."""
        self._spinner.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End the process under test."""
        self._stop.set()
        self._spinner.join()
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            self.process.wait(PATIENCE)
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()
        self._home.cleanup()

    def _spin(self) -> None:
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def _arrived(self, data: bytes) -> None:
        self.arrivals.append((stamp_of(data), time.monotonic()))

    def _listened(self, data: bytes) -> None:
        self.diagnostics += 1

    def wait(self, condition: Callable[[], object]) -> None:
        """Wait until a condition holds.

        Raises:
            TimeoutError: It does not.
        """
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                raise TimeoutError('the process under test does not answer')
            time.sleep(0.002)

    def ready(self) -> float:
        """Send messages until the first one comes back; return the time since the start in s."""
        self.wait(
            lambda: (
                self._player.get_subscription_count() > 0
                and self._node.count_publishers('imu/data_filtered') > 0
            )
        )
        while not self.arrivals:
            self._player.publish(imu_message(START - 10**9 + 1, (0, 0, 0), (0, 0, 9.8)))
            time.sleep(0.005)
        return self.arrivals[0][1] - self.started

    def play(self, rate: float, messages: Sequence[bytes]) -> float:
        """Publish messages at a rate in Hz; return the CPU time in s a message of the process."""
        last = stamp_of(messages[-1])
        process = psutil.Process(self.process.pid)
        begin = time.monotonic() + 0.01
        used = 0.0
        for k, message in enumerate(messages):
            due = begin + k / rate
            while (late := due - time.monotonic()) > 0:
                time.sleep(late)
            if k == WARM_UP:
                used = sum(process.cpu_times()[:2])
            self.sent.append(time.monotonic())
            self._player.publish(message)
        with contextlib.suppress(TimeoutError):
            end = time.monotonic() + 5.0
            self.wait(lambda: self.arrivals[-1][0] == last or time.monotonic() > end)
        return float((sum(process.cpu_times()[:2]) - used) / (len(messages) - WARM_UP))

    def memory(self) -> float:
        """Return the resident memory of the process in MB."""
        return float(psutil.Process(self.process.pid).memory_info().rss / 1e6)


def stamp_of(message: bytes) -> int:
    """Return the stamp of a serialized Imu since the first one, in ns."""
    seconds, nanoseconds = struct.unpack_from('<iI', message, 4)
    return int(seconds * 10**9 + nanoseconds - START)


def imus(rate: float, seconds: float) -> list[bytes]:
    """Return serialized Imu messages of a sensor at rest."""
    random = np.random.default_rng(0)
    step = round(1e9 / rate)
    return [
        imu_message(START + k * step, 0.005 * random.standard_normal(3), (0.0, 0.0, 9.8))
        for k in range(round(rate * seconds))
    ]


CANDIDATES = {
    'typed': ([*RELAY, 'typed'], False),
    'raw': ([*RELAY, 'raw'], False),
    'node': (NODE_COMMAND, False),
    'node, all listened to': (NODE_COMMAND, True),
}


def cpu_and_latency(repetitions: int) -> dict[str, dict[str, float]]:
    """Return medians of CPU (us a message) and of the latency's median and 99th percentile (ms)."""
    messages = imus(1000.0, 5.0)
    found: dict[str, list[tuple[float, float, float]]] = {name: [] for name in CANDIDATES}
    for _, (name, (command, listen)) in itertools.product(range(repetitions), CANDIDATES.items()):
        with Player(command, listen=listen) as player:
            player.ready()
            first = len(player.arrivals)
            cpu = player.play(1000.0, messages)
            sent = dict(enumerate(player.sent))
            delays = [
                at - sent[stamp // 1_000_000]
                for stamp, at in player.arrivals[first:]
                if stamp >= WARM_UP * 1_000_000
            ]
        found[name].append(
            (cpu * 1e6, float(np.median(delays)) * 1e3, float(np.quantile(delays, 0.99)) * 1e3)
        )
    names = 'cpu', 'latency', 'latency99'
    return {
        name: dict(zip(names, np.median(rows, axis=0).tolist(), strict=True))
        for name, rows in found.items()
    }


def loss(rate: float, seconds: float) -> tuple[int, int]:
    """Return how many messages were lost, and how many came out of order, reliable all the way."""
    messages = imus(rate, seconds)
    with Player([*NODE_COMMAND, *LOSSLESS]) as player:
        player.ready()
        player.play(rate, messages)
        stamps = [stamp for stamp, _ in player.arrivals if stamp >= 0]
    return len(messages) - len(set(stamps)), int((np.diff(stamps) <= 0).sum())


def starts(repetitions: int) -> dict[str, list[float]]:
    """Return medians of the time from start to first output (s) and of resident memory (MB)."""
    found: dict[str, list[tuple[float, float]]] = {'bare': [], 'node': []}
    commands = {'bare': [*RELAY, 'bare'], 'node': NODE_COMMAND}
    for _, (name, command) in itertools.product(range(repetitions), commands.items()):
        with Player(command) as player:
            found[name].append((player.ready(), player.memory()))
    return {name: np.median(rows, axis=0).tolist() for name, rows in found.items()}
