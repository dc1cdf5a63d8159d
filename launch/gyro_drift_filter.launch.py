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

"""Start the filter with its shipped parameters.

ros2 launch gyro_drift_filter gyro_drift_filter.launch.py input:=camera/imu namespace:=robot1
"""

from launch.actions import DeclareLaunchArgument
from launch.launch_description import LaunchDescription
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the description: one node, and arguments for what users change."""
    shipped = PathJoinSubstitution(
        [FindPackageShare('gyro_drift_filter'), 'config', 'gyro_drift_filter.yaml']
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'params_file', default_value=shipped, description='ROS 2 parameter file'
            ),
            DeclareLaunchArgument(
                'name', default_value='gyro_drift_filter', description='of the node'
            ),
            DeclareLaunchArgument('namespace', default_value='', description='of the node'),
            DeclareLaunchArgument(
                'input',
                default_value='imu/data_raw',
                description='sensor_msgs/Imu topic to filter',
            ),
            DeclareLaunchArgument(
                'output', default_value='imu/data_filtered', description='filtered topic'
            ),
            DeclareLaunchArgument(
                'temperature',
                default_value='imu/temperature',
                description='sensor_msgs/Temperature topic of the gyroscope',
            ),
            DeclareLaunchArgument(
                'motion_hint',
                default_value='motion_hint',
                description='topic that tells whether the robot moves; its type is the parameter '
                'motion_hint',
            ),
            DeclareLaunchArgument(
                'log_level',
                default_value='info',
                description='debug, info, warn, error or fatal',
            ),
            DeclareLaunchArgument(
                'use_sim_time', default_value='false', description='take the time from /clock'
            ),
            Node(
                package='gyro_drift_filter',
                executable='gyro_drift_filter_node',
                name=LaunchConfiguration('name'),
                namespace=LaunchConfiguration('namespace'),
                ros_arguments=[
                    # Not as `parameters`, where a file that does not exist is only warned of.
                    '--params-file',
                    LaunchConfiguration('params_file'),
                    '--log-level',
                    LaunchConfiguration('log_level'),
                ],
                parameters=[
                    {
                        'use_sim_time': ParameterValue(
                            LaunchConfiguration('use_sim_time'), value_type=bool
                        )
                    },
                ],
                remappings=[
                    ('imu/data_raw', LaunchConfiguration('input')),
                    ('imu/data_filtered', LaunchConfiguration('output')),
                    ('imu/temperature', LaunchConfiguration('temperature')),
                    ('motion_hint', LaunchConfiguration('motion_hint')),
                ],
                output='screen',
            ),
        ]
    )
