"""The rospy helpers shared by all nodes: start-up, parameters, messages, transforms."""
