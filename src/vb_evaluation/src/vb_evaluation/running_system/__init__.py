"""Watches, drives and checks a running system over ROS, whether it is a lab or its simulation."""
