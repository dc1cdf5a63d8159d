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

"""Run the real node as a process, play messages into it over ROS 2 and record what it publishes."""

import atexit
import itertools
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import Imu

EXECUTABLE = Path(sys.executable).parent / 'gyro_drift_filter_node'
# Nothing may get lost between player and node, however busy the machine is.
LOSSLESS = (
    *('-p', 'qos_overrides./imu/data_raw.subscription.reliability:=reliable'),
    *('-p', 'qos_overrides./imu/data_raw.subscription.depth:=1000'),
    *('-p', 'qos_overrides./imu/data_filtered.publisher.depth:=1000'),
)
_IN_FLIGHT = 100
_PATIENCE = 300.0  # a first start compiles, which two busy cores may take four minutes for
# Of requests, too, one may go before both sides have found each other.
_ATTEMPTS = 60
_BLOCK = 10  # ROS domains of a process
_BLOCKS = 10  # with more of them, DDS would use ports that the system gives to others
_numbers = itertools.cycle(range(_BLOCK))
_taken: set[int] = set()  # the domains of the nodes that are running


@cache
def _own_block() -> int:
    """Return a block of domains; a socket keeps other processes from taking it, until the end."""
    for block in range(_BLOCKS):
        mark = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            mark.bind(f'\0gyro_drift_filter_domains_{block}')  # a name without a file
        except OSError:
            mark.close()
        else:
            atexit.register(mark.close)
            return block
    return os.getpid() % _BLOCKS


def own_domain() -> int:
    """Return a ROS domain that no other process takes, and no `LiveNode` of this one.

    Nor is it one that the last nodes of this process had, which may not have left it yet.
    """
    domains = (1 + _BLOCK * _own_block() + number for number in _numbers)
    return next(domain for domain in domains if domain not in _taken)


def environment(domain: int) -> dict[str, str]:
    """Return the environment of a node that stays on this machine, in a domain of its own."""
    return {
        **os.environ,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_DOMAIN_ID': str(domain),
    }


class LiveNode:
    """A running node and a player beside it, in a domain of their own.

    Use as a context manager; leaving it interrupts the node as Ctrl-C does.

    Attributes:
        node: The player's own rclpy node, for further subscriptions.
        process: The node's process.
        domain: Their ROS domain.
        returncode: The node's exit status after the end.
    """

    def __init__(
        self, arguments: Sequence[str] = LOSSLESS, node: Path = EXECUTABLE, home: Path | None = None
    ) -> None:
        os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
        self.domain = domain = own_domain()
        _taken.add(domain)
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node('player', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        qos = QoSProfile(depth=10 * _IN_FLIGHT)
        self._create_player = partial(self.node.create_publisher, Imu, 'imu/data_raw', qos)
        self._player = self._create_player()
        self.received: list[bytes] = []
        self._listens = False
        self.node.create_subscription(
            Imu,
            'imu/data_filtered',
            self.received.append,
            qos,
            raw=True,
            event_callbacks=SubscriptionEventCallbacks(matched=self._note_match),
        )
        # What other runs of the node remember is of no concern here.
        self._home = tempfile.TemporaryDirectory()
        self.process = subprocess.Popen(
            [str(node), '--ros-args', *arguments],
            env=environment(domain) | {'ROS_HOME': str(home or self._home.name)},
            stderr=subprocess.PIPE,
            text=True,
        )
        self.returncode: int | None = None
        self.log = ''

    def __enter__(self) -> 'LiveNode':
        """Wait until player and node have found each other."""
        try:
            self.wait(lambda: self._listens, 'the node to appear')
            self._meet()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        """Interrupt the node and wait for its end; `log` has what it wrote to stderr."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            _, self.log = self.process.communicate(timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            _, self.log = self.process.communicate()
        self.returncode = self.process.returncode
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()
        _taken.discard(self.domain)
        self._home.cleanup()

    def _note_match(self, info: QoSSubscriptionMatchedInfo) -> None:
        self._listens = info.current_count > 0

    def _meet(self) -> None:
        """Wait until the node hears the player: what is sent before would be lost.

        That the player has found the node does not say so. But DDS announces the endpoints of a
        process in the order in which they were made: a node that answers a client that is younger
        than the player's publisher and subscription has found these, too.
        """
        self.wait(self._player.get_subscription_count, 'the node to listen')
        client = self.node.create_client(GetParameters, '/gyro_drift_filter/get_parameters')
        self.wait(client.service_is_ready, 'the services of the node')
        for _ in range(_ATTEMPTS):
            answer = client.call_async(GetParameters.Request())
            if self._is_done(answer, _PATIENCE / _ATTEMPTS):
                break
            client.remove_pending_request(answer)
        else:
            raise TimeoutError(f'the node has not answered {_ATTEMPTS} requests')
        self.node.destroy_client(client)

    def _is_done(self, answer: Future, seconds: float) -> bool:
        """Wait for an answer for so long at the most."""
        end = time.monotonic() + seconds
        self.wait(lambda: answer.done() or time.monotonic() > end, 'an answer')
        return bool(answer.done())

    def wait(self, condition: Callable[[], object], what: str) -> None:
        """Run callbacks until a condition holds.

        Raises:
            TimeoutError: It does not come to hold.
            RuntimeError: The node has ended.
        """
        end = time.monotonic() + _PATIENCE
        while not condition():
            if self.process.poll() is not None:
                raise RuntimeError(f'the node has ended with status {self.process.returncode}')
            if time.monotonic() > end:
                raise TimeoutError(
                    f'waited {_PATIENCE:g} s for {what}; {len(self.received)} messages have come'
                )
            self.spin(0.05)

    def wait_for(self, count: int, what: str) -> None:
        """Run callbacks until so many messages have been received since the start."""
        self.wait(lambda: len(self.received) >= count, what)

    def spin(self, seconds: float) -> None:
        """Run the callbacks that come within this time, the first of them at once."""
        self._executor.spin_once(timeout_sec=seconds)

    def restart_player(self) -> None:
        """End the publisher of the input, and begin another one, as a driver that starts anew."""
        self.node.destroy_publisher(self._player)
        self._player = self._create_player()
        self._meet()

    def publish(self, message: bytes) -> None:
        """Publish one serialized Imu."""
        self._player.publish(message)

    def play(self, messages: Sequence[bytes], in_flight: int = _IN_FLIGHT) -> list[bytes]:
        """Publish messages as fast as the node takes them; return what it published for them.

        Each message must give one output; no more than `in_flight` are on their way at a time.
        """
        first = len(self.received)
        for sent, message in enumerate(messages, 1):
            self.publish(message)
            self.wait_for(first + sent - in_flight, 'the node to keep up')
        self.wait_for(first + len(messages), 'the last message')
        return self.received[first:]
