"""Connects the displays and sounds to ROS: inputs, markers, events. The other folders of this package work without ROS."""
