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

"""Nodes that pass Imu messages on and do nothing else: what ROS 2 costs by itself.

    python -m benchmark.relay typed|raw|bare

typed is what a node is by the book: deserialized messages, SingleThreadedExecutor. raw passes
bytes on with the EventsExecutor. bare is typed with all topics of gyro_drift_filter_node, to
compare starts.
"""

import sys

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, Temperature
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

INPUT_QOS = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)


def relay(kind: str) -> Node:
    """Return a node that publishes what it gets."""
    node = rclpy.create_node('relay')
    output = node.create_publisher(Imu, 'imu/data_filtered', 10)
    node.create_subscription(Imu, 'imu/data_raw', output.publish, INPUT_QOS, raw=kind == 'raw')
    if kind == 'bare':
        for i in range(6):
            node.create_publisher(Vector3Stamped, f'~/vector{i}', 10)
        node.create_publisher(Bool, '~/at_rest', 10)
        node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        node.create_subscription(Temperature, 'imu/temperature', lambda message: None, 10)
        for name in ('reset', 'calibrate'):
            node.create_service(Trigger, f'~/{name}', lambda request, response: response)
    return node


def main(kind: str) -> None:
    """Pass messages on until interrupted."""
    rclpy.init()
    node = relay(kind)
    executor = EventsExecutor() if kind == 'raw' else SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while rclpy.ok():
            executor.spin_once(timeout_sec=1.0)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == '__main__':
    main(sys.argv[1])
