# Source this before roslaunch, on each computer of this lab:  . network.sh
# One computer: keep both lines commented out, so that ROS stays on it. Several: read docs/how-to/protect-the-network.md first.
# export ROS_MASTER_URI=http://ROBOT:11311
# export ROS_IP=ADDRESS_OF_THIS_COMPUTER
