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

"""Who else is on the node's topics, or has its name: what keeps messages away, or mixes them."""

from collections.abc import Collection

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from gyro_drift_filter.messages.imu import IMU_TYPE

# rclpy remaps the topic that it is asked about. The name of a publisher or subscription is remapped
# already, and may be that from which another topic is remapped.
_INPUT, _OUTPUT = 'imu/data_raw', 'imu/data_filtered'
# What rmw says of an endpoint that was discovered before its node.
_UNKNOWN_NODE = '_NODE_NAME_UNKNOWN_'


class Neighbours:
    """Look at the nodes at the input and the output, and at those of the same name."""

    def __init__(self, node: Node, input_: Subscription, output: Publisher) -> None:
        self._node = node
        self._input = input_
        self._output = output

    def fault(self) -> str | None:
        """Return what is wrong with the connections, by the names of the other nodes."""
        node, topic, output = self._node, self._input.topic_name, self._output.topic_name
        publishers = self._publishers()
        requested = self._own(node.get_subscriptions_info_by_topic(_INPUT))
        for other in publishers:
            reason = _mismatch(other, requested)
            if reason:
                return (
                    f'nothing comes from {node_name(other)} on {topic}: {reason}; set '
                    f'qos_overrides.{topic}.subscription.* to what it offers'
                )
        if mixture := self.mixture():
            return mixture
        own = node.get_fully_qualified_name()
        nodes = [
            _full_name(namespace, name) for name, namespace in node.get_node_names_and_namespaces()
        ]
        if nodes.count(own) > 1:
            return (
                f'another node is called {own}, too: what is asked of one may be answered by the '
                'other; start one with -r __node:=NAME or in a namespace'
            )
        outputs = node.get_publishers_info_by_topic(_OUTPUT)
        for other in outputs:
            if other.topic_type == IMU_TYPE and node_name(other) != own:
                return (
                    f'{node_name(other)} publishes {output}, too: the messages are mixed; remap '
                    'the output of one'
                )
        offered = self._own(outputs)
        for other in node.get_subscriptions_info_by_topic(_OUTPUT):
            reason = _mismatch(offered, other)
            if reason:
                return f'{node_name(other)} gets nothing of {output}: {reason}'
        return None

    def mixture(self) -> str | None:
        """Return who publishes into the input beside one another."""
        requested = self._own(self._node.get_subscriptions_info_by_topic(_INPUT))
        names = sorted(
            node_name(other)
            for other in self._publishers()
            if other.topic_type == IMU_TYPE and not _mismatch(other, requested)
        )
        if len(names) < 2:
            return None
        return (
            f'{len(names)} publishers on {self._input.topic_name}: {", ".join(names)}. Their '
            'messages are mixed: remap all but one'
        )

    def silence(self) -> str:
        """Return why no message comes in."""
        topic = self._input.topic_name
        publishers = self._publishers()
        wrong = [p for p in publishers if p.topic_type != IMU_TYPE]
        if wrong:
            return (
                f'{node_name(wrong[0])} publishes {wrong[0].topic_type} on {topic}, '
                f'not {IMU_TYPE}: remap imu/data_raw to an Imu topic'
            )
        if publishers:
            return f'no message, though {node_name(publishers[0])} publishes {topic}'
        others = topics_of(self._node, IMU_TYPE, (topic, self._output.topic_name))
        hint = f'; Imu topics there are: {", ".join(others)}' if others else ''
        return (
            f'nobody publishes {topic}: is the driver running, and is imu/data_raw remapped?{hint}'
        )

    def _own(self, endpoints: list[TopicEndpointInfo]) -> TopicEndpointInfo | None:
        """Return the node's own one: only the graph knows the QoS with all of its defaults."""
        name = self._node.get_fully_qualified_name()
        return next((endpoint for endpoint in endpoints if node_name(endpoint) == name), None)

    def _publishers(self) -> list[TopicEndpointInfo]:
        return self._node.get_publishers_info_by_topic(_INPUT)


def topics_of(node: Node, type_: str, left_out: Collection[str]) -> list[str]:
    """Return the topics of a type that there are, without some, in order."""
    return sorted(
        name
        for name, types in node.get_topic_names_and_types()
        if type_ in types and name not in left_out
    )


def node_name(other: TopicEndpointInfo) -> str:
    """Return the full name of the node that has a publisher or subscription."""
    if other.node_name == _UNKNOWN_NODE:
        return 'a node whose name ROS does not know yet'
    return _full_name(other.node_namespace, other.node_name)


def _full_name(namespace: str, name: str) -> str:
    return f'{namespace.rstrip("/")}/{name}'


def _mismatch(offered: TopicEndpointInfo | None, requested: TopicEndpointInfo | None) -> str:
    """Return why a publisher and a subscription do not match, '' where they do."""
    if offered is None or requested is None or offered.topic_type != requested.topic_type:
        return ''
    verdict, reason = qos_check_compatible(offered.qos_profile, requested.qos_profile)
    is_error = verdict == QoSCompatibility.ERROR
    return str(reason).replace('ERROR: ', '').rstrip('; ') if is_error else ''
