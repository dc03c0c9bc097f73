"""ROS 2 nodes: thin edges around the library, and the only place that imports rclpy."""
