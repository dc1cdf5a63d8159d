"""The drift model from a motionless recording: the paper's section 2. No ROS, no files."""
