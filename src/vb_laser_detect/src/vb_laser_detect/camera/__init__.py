"""A camera that the detector reads itself: its images, its settings, its lens file. No ROS."""
