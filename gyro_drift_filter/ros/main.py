"""Start and end of the node's process."""

import sys
from collections.abc import Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from gyro_drift_filter.core import GyroDriftFilterError

try:
    from rclpy.experimental import EventsExecutor
except ImportError:
    EventsExecutor = None


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node until it is interrupted.

    Returns:
        0 after an interrupt, 1 after a known error told in one line on stderr.
    """
    node = None
    try:
        node = _start(arguments)
        spin(node)
    except GyroDriftFilterError as error:
        print(f'gyro_drift_filter_node: {error}', file=sys.stderr)
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        # A signal shuts the context down; what it interrupts, such as the compiler, may raise
        # anything.
        if rclpy.ok():
            raise
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _start(arguments: Sequence[str] | None) -> Node:
    try:
        rclpy.init(args=None if arguments is None else list(arguments))
    except RuntimeError as error:  # rcl could not read the arguments or the parameter file
        reason, _, _ = str(error).partition(', at ')  # rcl appends places in its own source
        raise GyroDriftFilterError(reason) from error
    # Imported here, as an interrupt may come while numba is loaded.
    from gyro_drift_filter.ros.node import GyroDriftFilterNode

    return GyroDriftFilterNode()


def spin(node: Node) -> None:
    """Run the node's callbacks until shutdown."""
    if EventsExecutor is None:
        node.get_logger().warning(
            'this rclpy has no EventsExecutor: falling back to SingleThreadedExecutor, at several '
            'times the processor load'
        )
    executor = (EventsExecutor or SingleThreadedExecutor)()
    # An interrupt may come at once, and EventsExecutor aborts where it has a node and is not shut
    # down. Its spin() of rclpy 7.1 turns without running a callback; spin_once does not.
    try:
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(timeout_sec=1.0)
    finally:
        executor.shutdown()
