"""The statuses that navigation gives its goals."""

from actionlib_msgs.msg import GoalStatus

# of goals that have neither ended nor been refused
RUNNING_GOAL_STATUSES = (GoalStatus.PENDING, GoalStatus.ACTIVE, GoalStatus.PREEMPTING, GoalStatus.RECALLING)
