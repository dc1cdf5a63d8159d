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

"""Start and end of the node's process."""

import signal
import sys
import time
from collections.abc import Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyro_drift_filter.accelerate.kernels import spare_linear_algebra
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.ros.arguments import (
    USAGE,
    UsageError,
    asks_for_help,
    parameter_files,
    reporting_rcl,
)

try:
    from rclpy.experimental import EventsExecutor
except ImportError:
    EventsExecutor = None  # type: ignore[assignment]

# How long a signal may wait, where no message comes.
_LATEST_SECONDS = 0.2
# How long the node may take to end. Until then another signal changes nothing, as Ctrl-C beneath
# `ros2 launch` sends two, and what was learned has to be kept. A later one ends it at once.
_END_SECONDS = 1.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT, SIGTERM, or SIGHUP as of a terminal that is closed.

    Args:
        arguments: Of the process, its name first.

    Returns:
        0 after one of them or --help; 1 after a known error, 2 after an unknown option, which are
        one line on stderr.
    """
    arguments = sys.argv if arguments is None else arguments
    asked: list[float] = []

    def stop(number: int, frame: object) -> None:
        asked.append(time.monotonic())
        if asked[-1] > asked[0] + _END_SECONDS:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)

    # Not rclpy's own handlers, as they invalidate what is being set up. Nor an exception, as it
    # leaves EventsExecutor half made, which aborts.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # as under nohup
        signal.signal(signal.SIGHUP, stop)
    node = None
    try:
        if asks_for_help(arguments):
            print(USAGE, end='')
            return 0
        node = _start(arguments)
        spin(node, asked)
    except GyroDriftFilterError as error:
        print(f'gyro_drift_filter_node: {error}', file=sys.stderr)
        return 2 if isinstance(error, UsageError) else 1
    except ExternalShutdownException:
        pass
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        # While Python ends, a handler of its own is none any more.
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
    return 0


def _start(arguments: Sequence[str]) -> Node:
    with reporting_rcl(arguments):
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    spare_linear_algebra()
    # Imported here, as it loads the kernels.
    from gyro_drift_filter.ros.node import GyroDriftFilterNode

    return GyroDriftFilterNode(parameter_files(arguments))


def spin(node: Node, asked: Sequence[float]) -> None:
    """Run the node's callbacks until `asked` holds the time of a signal."""
    if EventsExecutor is None:
        node.get_logger().warning(
            'this rclpy has no EventsExecutor: falling back to SingleThreadedExecutor, at several '
            'times the processor load'
        )
    executor = SingleThreadedExecutor() if EventsExecutor is None else EventsExecutor()
    # EventsExecutor.spin() of rclpy 7.1 turns without running a callback; spin_once does not.
    try:
        executor.add_node(node)
        while rclpy.ok() and not asked:
            executor.spin_once(timeout_sec=_LATEST_SECONDS)
    finally:
        executor.shutdown()
