"""Connects detector and camera setup to ROS: images, poses, notices. The other folders of this package work without ROS."""
