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

"""An example: from an IMU driver to odom -> base_link, with what to mind on the way.

ros2 launch gyro_drift_filter robot.launch.py driver_package:=phidgets_spatial
    driver_executable:=phidgets_spatial driver_topic:=imu/data_raw

Copy it and change it: the driver's parameters and the wheels' topic are those of your robot.
docs/robot.md explains each choice.
"""

from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description import LaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

# It makes roll and pitch of accelerations and rates, and passes the rates on with their covariance.
MADGWICK = {
    'use_mag': False,
    'zeta': 0.0,  # it would take the bias off a second time
    'orientation_stddev': 0.02,  # rad; by its default of 0 the EKF would take it for near certainty
    'publish_tf': False,
}
# It weighs the rates by the covariance that this filter gives them.
EKF = {
    'two_d_mode': False,
    'imu0': 'imu/data',
    'imu0_config': [
        *(False, False, False),  # position
        *(True, True, False),  # roll and pitch; not yaw, which comes of the same rates
        *(False, False, False),  # velocity
        *(True, True, True),  # rates
        *(False, False, False),  # acceleration
    ],
    'odom0': 'odom',
    'odom0_config': [*[False] * 6, True, True, False, *[False] * 6],  # velocities of the wheels
}


def generate_launch_description() -> LaunchDescription:
    """Return the description: driver, gyro_drift_filter, imu_filter_madgwick and the EKF."""
    filter_launch = [FindPackageShare('gyro_drift_filter'), 'launch', 'gyro_drift_filter.launch.py']
    return LaunchDescription(
        [
            DeclareLaunchArgument('driver_package', description='package of the IMU driver'),
            DeclareLaunchArgument('driver_executable', description='executable of the IMU driver'),
            DeclareLaunchArgument(
                'driver_topic',
                default_value='imu/data_raw',
                description='sensor_msgs/Imu topic that the driver publishes',
            ),
            Node(
                package=LaunchConfiguration('driver_package'),
                executable=LaunchConfiguration('driver_executable'),
                remappings=[(LaunchConfiguration('driver_topic'), 'imu/data_raw')],
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(PathJoinSubstitution(filter_launch)),
                launch_arguments={
                    'namespace': '',
                    'input': 'imu/data_raw',
                    'output': 'imu/data_filtered',  # which the others take
                    'motion_hint': 'odom',
                }.items(),
            ),
            Node(
                package='imu_filter_madgwick',
                executable='imu_filter_madgwick_node',
                parameters=[MADGWICK],
                remappings=[('imu/data_raw', 'imu/data_filtered')],
            ),
            Node(package='robot_localization', executable='ekf_node', parameters=[EKF]),
        ]
    )
