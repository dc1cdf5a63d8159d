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

"""Whether a robot's own message says that it moves; for the node and for `replay`."""

import math
from typing import Any

# By the name of the parameter `motion_hint`.
HINT_TYPES = {
    'twist': 'geometry_msgs/msg/Twist',
    'twist_stamped': 'geometry_msgs/msg/TwistStamped',
    'odometry': 'nav_msgs/msg/Odometry',
}
# Wheels that stand report less, in m/s and rad/s.
STANDING = 1e-3


def moves(message: Any) -> bool:
    """Tell whether a Twist, TwistStamped or Odometry says that the robot moves.

    A value that is not finite says nothing good: it counts as motion.
    """
    twist = message
    while hasattr(twist, 'twist'):  # Odometry holds a TwistWithCovariance, that a Twist
        twist = twist.twist
    values = [getattr(part, axis) for part in (twist.linear, twist.angular) for axis in 'xyz']
    return not all(math.isfinite(value) and abs(value) < STANDING for value in values)
