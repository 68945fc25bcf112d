"""Connects the robots to ROS: their navigation, planners and drivers. This package's other folders work without ROS."""
