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

"""What the robot says of its own motion: wheel odometry, or the command it was given."""

from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.timer import Timer

from gyro_drift_filter.messages.motion_hint import HINT_TYPES, moves
from gyro_drift_filter.ros.neighbours import node_name, topics_of

_CLASSES = {'twist': Twist, 'twist_stamped': TwistStamped, 'odometry': Odometry}
assert set(_CLASSES) == set(HINT_TYPES)
# By then the executor has let go of a subscription that was destroyed in one of its callbacks.
_PAUSE_SECONDS = 0.1
_TOPIC = 'motion_hint'
# Publishers are known some seconds after a node has started.
_DISCOVERY_SECONDS = 5.0


class MotionHint:
    """Subscribe to `motion_hint` with the type that the parameter names, and pass on hints."""

    def __init__(self, node: Node, hint: Callable[[bool], None], kind: str) -> None:
        self._node = node
        self._hint = hint
        self._kind = 'none'
        self._subscription: Any = None
        self._pause: Timer | None = None
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._since = self._steady.now()
        self.listen(kind)

    def listen(self, kind: str) -> None:
        """Listen to messages of another type, 'none' for not at all."""
        if kind == self._kind:
            return
        self._kind = kind
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
            # DDS refuses another type for a topic while the old subscription is still there.
            self._pause = self._node.create_timer(_PAUSE_SECONDS, self._resume, clock=self._steady)
        elif self._pause is None:
            self._subscribe()

    def _resume(self) -> None:
        assert self._pause is not None
        self._node.destroy_timer(self._pause)
        self._pause = None
        self._subscribe()

    def fault(self) -> str | None:
        """Return why no hint can come, None where one may.

        Who publishes the right type may be silent, as a robot without a command is.
        """
        if self._subscription is None:
            return None
        if (self._steady.now() - self._since).nanoseconds < _DISCOVERY_SECONDS * 1e9:
            return None
        topic, wanted = self._subscription.topic_name, HINT_TYPES[self._kind]
        publishers = self._node.get_publishers_info_by_topic(_TOPIC)  # rclpy remaps it
        if any(other.topic_type == wanted for other in publishers):
            return None
        head = f'motion_hint is {self._kind}, but'
        if publishers:
            other = publishers[0]
            return (
                f'{head} {node_name(other)} publishes {other.topic_type} on {topic}: set '
                'motion_hint to its type, or remap the topic motion_hint'
            )
        others = topics_of(self._node, wanted, (topic,))
        there = f'; {wanted} is on: {", ".join(others)}' if others else ''
        return f'{head} nobody publishes {topic}: is the topic motion_hint remapped?{there}'

    def _subscribe(self) -> None:
        if self._kind != 'none':
            self._since = self._steady.now()
            self._subscription = self._node.create_subscription(
                _CLASSES[self._kind], _TOPIC, self._receive, qos_profile_sensor_data
            )

    def _receive(self, message: Any) -> None:
        self._hint(moves(message))
