"""Take the drift, the noise and the outliers out of a gyroscope, live in ROS 2 or from a bag."""
