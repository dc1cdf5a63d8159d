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

"""What the node's process is called with: ROS's own arguments, and --help."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.utilities import remove_ros_args

from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.messages.parameter_sections import NoSectionsError, read_sections

_METHODS = f'{", ".join(METHOD_NAMES[:-1])} or {METHOD_NAMES[-1]}'
USAGE = f"""\
usage: gyro_drift_filter_node [--help] [--ros-args ...]

Filter a gyroscope while the robot runs: drift, noise and outliers go, motion stays.

  subscribes  imu/data_raw       sensor_msgs/Imu, the raw rates
              imu/temperature    sensor_msgs/Temperature, where there is one
              motion_hint        what the parameter motion_hint names
  publishes   imu/data_filtered  sensor_msgs/Imu, every sample
              /diagnostics       what came in, and what to do about it
              ~/bias, ~/innovation and others, while there are subscribers
  serves      ~/reset, ~/calibrate

  -r imu/data_raw:=/camera/imu   filter another topic
  -r __ns:=/robot1               run in a namespace; -r __node:=NAME gives another name
  --params-file FILE.yaml        parameters, as config/gyro_drift_filter.yaml
  -p method:=adaptive            how to filter: {_METHODS}
  -p bias.enabled:=true          whether the bias is subtracted; it is learned in any case
  -p sample_rate:=0.0            Hz, for a driver that does not stamp; 0 learns it from stamps

All of these stand behind --ros-args. 'ros2 param describe /gyro_drift_filter NAME' explains a
parameter; docs/parameters.md has them all. 'gyro_drift --help' is for bags.
"""


class UsageError(GyroDriftFilterError):
    """The process was called with an option that does not exist."""


def reason_of_rcl(error: Exception) -> str:
    """Return what rcl says, without the places in its own source that it appends."""
    return str(error).partition(', at ')[0]


@contextmanager
def reporting_rcl(arguments: Sequence[str]) -> Iterator[None]:
    """Turn what rcl says of arguments or a parameter file that it can't read into one line.

    Of a file rcl tells no more than "Error parsing a event near line 1"; PyYAML says what is wrong.
    """
    try:
        yield
    except RuntimeError as error:
        reason = reason_of_rcl(error)
        if 'should be of same type' in reason:
            reason += ': in a list write 0.0, not 0, where others have a decimal point'
        elif 'params file' in reason:
            for path in parameter_files(arguments):
                with suppress(NoSectionsError):
                    # What only one node would not take is not why rcl refuses the file.
                    read_sections(path, lambda section: False)
        raise GyroDriftFilterError(reason) from error


def asks_for_help(arguments: Sequence[str]) -> bool:
    """Tell whether the arguments of a process, its name first, ask for help.

    Raises:
        UsageError: There is one that neither ROS nor the node knows.
        GyroDriftFilterError: One that is for ROS can't be read.
    """
    with reporting_rcl(arguments):
        try:
            left = remove_ros_args(list(arguments))[1:]
        except rclpy_implementation.UnknownROSArgsError as error:
            raise UsageError(f'unknown options behind --ros-args: {error}; see --help') from error
    if {'-h', '--help'} & set(left):
        return True
    if left:
        raise UsageError(f'unknown options: {" ".join(left)}; see --help')
    return False


def parameter_files(arguments: Sequence[str]) -> list[Path]:
    """Return the parameter files among ROS's own arguments."""
    files, is_ros = [], False
    for argument, value in pairwise([*arguments, '']):
        is_ros = argument == '--ros-args' or (is_ros and argument != '--')
        if is_ros and argument == '--params-file':
            files.append(Path(value))
    return files
