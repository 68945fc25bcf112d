"""The rospy helpers that all nodes share: start-up, parameters, messages, transforms."""
