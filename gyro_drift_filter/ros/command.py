"""Entry point of `gyro_drift_filter_node`."""

import sys


def main() -> int:
    """Run the node and return its exit status, see `main.main`."""
    try:
        from gyro_drift_filter.ros.main import main as run
    except ImportError as error:
        print(
            f'gyro_drift_filter_node: the node needs ROS 2 and its messages ({error}): '
            "'source /opt/ros/jazzy/setup.bash' first. gyro_drift filters bags without ROS",
            file=sys.stderr,
        )
        return 1
    return run()


if __name__ == '__main__':
    sys.exit(main())
