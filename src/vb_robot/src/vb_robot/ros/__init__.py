"""Connects the robots to ROS: their navigation, planners and drivers. The other folders of this package work without ROS."""
