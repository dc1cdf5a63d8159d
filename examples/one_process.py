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

"""Two filters in one process, as its several nodes: less memory than two processes.

A node of rclpy is an object: one executor runs the callbacks of several, in turns on one processor.
`two_imus.launch.py` starts a process for each instead, which takes two processors where they are.

python3 examples/one_process.py --ros-args --params-file both.yaml
"""

import signal
import sys

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from gyro_drift_filter.ros.node import GyroDriftFilterNode


def main() -> None:
    """Filter /front/imu/data_raw and /rear/imu/data_raw until SIGINT or SIGTERM."""
    asked: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: asked.append(number))
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    executor = EventsExecutor()
    nodes = [GyroDriftFilterNode(namespace=namespace) for namespace in ('front', 'rear')]
    for node in nodes:
        executor.add_node(node)
    # EventsExecutor.spin() of rclpy 7.1 turns without running a callback; spin_once does not.
    while not asked:
        executor.spin_once(timeout_sec=0.2)
    executor.shutdown()
    for node in nodes:
        node.destroy_node()  # keeps the bias for the next start
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
