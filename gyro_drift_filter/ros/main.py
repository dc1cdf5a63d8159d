"""Start and end of the node's process."""

import signal
import sys
from collections.abc import Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from gyro_drift_filter.accelerate.kernels import spare_linear_algebra
from gyro_drift_filter.core import GyroDriftFilterError

try:
    from rclpy.experimental import EventsExecutor
except ImportError:
    EventsExecutor = None  # type: ignore[assignment]

# How long a signal may wait, where no message comes.
_LATEST_SECONDS = 0.2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Returns:
        0 after one of them, 1 after a known error, which is one line on stderr.
    """
    asked: list[int] = []

    def stop(number: int, frame: object) -> None:
        asked.append(number)
        signal.signal(number, signal.SIG_DFL)  # a second one ends it at once

    # Not rclpy's own handlers: they invalidate what is being set up, and an exception besides
    # leaves EventsExecutor half made, which aborts.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    node = None
    try:
        node = _start(arguments)
        spin(node, asked)
    except GyroDriftFilterError as error:
        print(f'gyro_drift_filter_node: {error}', file=sys.stderr)
        return 1
    except ExternalShutdownException:
        pass
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _start(arguments: Sequence[str] | None) -> Node:
    try:
        rclpy.init(
            args=None if arguments is None else list(arguments),
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except RuntimeError as error:  # rcl could not read the arguments or the parameter file
        reason, _, _ = str(error).partition(', at ')  # rcl appends places in its own source
        raise GyroDriftFilterError(reason) from error
    spare_linear_algebra()
    # Imported here, as it loads the kernels.
    from gyro_drift_filter.ros.node import GyroDriftFilterNode

    return GyroDriftFilterNode()


def spin(node: Node, asked: Sequence[int]) -> None:
    """Run the node's callbacks until `asked` holds a signal's number."""
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
