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

"""The types that are written, beside those of rosbags' store of all of Jazzy."""

from typing import Any

import pytest

from gyro_drift_filter.bags.message_types import all_types, message_type, serialize, types_with

WRITTEN = [
    'sensor_msgs/msg/Imu',
    'diagnostic_msgs/msg/DiagnosticArray',
    'geometry_msgs/msg/Vector3Stamped',
    'std_msgs/msg/Bool',
]


@pytest.mark.parametrize('name', WRITTEN)
def test_they_are_what_jazzy_has(name):
    few, jazzy = types_with(name), all_types()
    assert few is not jazzy
    assert few.generate_msgdef(name, ros_version=2) == jazzy.generate_msgdef(name, ros_version=2)
    assert few.hash_rihs01(name) == jazzy.hash_rihs01(name)


def test_other_types_are_jazzys():
    vector = message_type('geometry_msgs/msg/Vector3')
    twist = message_type('geometry_msgs/msg/Twist')(vector(1.0, 2.0, 3.0), vector(4.0, 5.0, 6.0))
    data = serialize(twist, 'geometry_msgs/msg/Twist')
    read: Any = all_types().deserialize_cdr(data, 'geometry_msgs/msg/Twist')
    assert read.angular.z == 6.0
    with pytest.raises(KeyError):
        message_type('nobody_knows/msg/This')
