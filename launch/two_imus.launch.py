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

"""An example: two gyroscopes side by side, each with a filter in its own namespace.

/front/imu/data_raw becomes /front/imu/data_filtered, and so for /rear.

ros2 launch gyro_drift_filter two_imus.launch.py rear_params_file:=rear.yaml

Other arguments are those of both filters: name topics without a slash before them, as
input:=imu/raw.
"""

from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description import LaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

NAMESPACES = ('front', 'rear')


def generate_launch_description() -> LaunchDescription:
    """Return the description: the launch file of the filter, twice."""
    share = FindPackageShare('gyro_drift_filter')
    shipped = PathJoinSubstitution([share, 'config', 'gyro_drift_filter.yaml'])
    filter_launch = PathJoinSubstitution([share, 'launch', 'gyro_drift_filter.launch.py'])
    description = LaunchDescription()
    for namespace in NAMESPACES:
        file = f'{namespace}_params_file'
        arguments = {'namespace': namespace, 'params_file': LaunchConfiguration(file)}
        include = IncludeLaunchDescription(
            PythonLaunchDescriptionSource(filter_launch), launch_arguments=arguments.items()
        )
        description.add_action(
            DeclareLaunchArgument(file, default_value=shipped, description='ROS 2 parameter file')
        )
        # In a group, as arguments would otherwise go on from one to the next.
        description.add_action(GroupAction([include]))
    return description
