"""The parts of this package's nodes that need ROS."""
