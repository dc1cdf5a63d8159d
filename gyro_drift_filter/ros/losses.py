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

"""How many messages the middleware drops between the publisher of the input and the node."""

from collections.abc import Callable

from rclpy.event_handler import QoSMessageLostInfo
from rclpy.subscription import Subscription


class Losses:
    """Count what is lost, by two signs of which neither shows all.

    The middleware's own event tells what the network has lost. Fast DDS says nothing of messages
    that are dropped because the node does not keep up and its queue is full. But then messages are
    waiting, and the number that the publisher gave one of them tells how many were sent. To ask for
    the number of every message costs too much, and EventsExecutor of rclpy 7.1 fails at it.
    """

    def __init__(self, take: Callable[[bytes], None], received: Callable[[], int]) -> None:
        """Start, by what the node does with a message, and what tells how many it has taken."""
        self._take = take
        self._received = received
        self._reported = 0  # by the event
        self._counted = 0  # by the publisher's numbers
        # The publisher's number of a message, and how many had been received with it.
        self._last: tuple[int, int] | None = None

    def note_event(self, info: QoSMessageLostInfo) -> None:
        """Take what the middleware tells."""
        self._reported = info.total_count

    def forget(self) -> None:
        """Begin to count from the next message that waits."""
        self._last = None

    @property
    def total(self) -> int:
        """How many have been lost, as far as is known."""
        return max(self._reported, self._counted)

    def count(self, subscription: Subscription) -> None:
        """Take a message that waits, if there is one, and see what was lost before it."""
        with subscription.handle:
            waiting = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if waiting is not None:
            data, info = waiting
            self._take(data)
            self._compare(info['publication_sequence_number'], self._received())

    def _compare(self, number: int | None, received: int) -> None:
        if number is None:  # the middleware does not number them
            return
        if self._last is not None:
            # Where it is negative the publisher is another one, which counts from 1.
            self._counted += max(0, number - self._last[0] - (received - self._last[1]))
        self._last = number, received
