"""A camera that the detector reads directly: its images, settings and lens file. No ROS."""
