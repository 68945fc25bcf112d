"""Connects displays and sounds to ROS: inputs, markers and events. This package's other folders work without ROS."""
