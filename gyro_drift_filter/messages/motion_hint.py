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
