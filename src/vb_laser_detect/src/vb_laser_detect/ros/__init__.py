"""The detector's connection to ROS: images, poses, notices. All other folders of this package work without ROS."""
