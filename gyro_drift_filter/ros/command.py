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
    except KeyboardInterrupt:  # what follows has handlers of its own
        print('gyro_drift_filter_node: interrupted while it loaded', file=sys.stderr)
        return 130
    return run()


if __name__ == '__main__':
    sys.exit(main())
