"""The live node: the only place with rclpy."""
