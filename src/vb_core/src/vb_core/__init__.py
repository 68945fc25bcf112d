"""Geometry, camera model, grid map, parameters and the shared rospy helpers of the virtual borders stack."""
