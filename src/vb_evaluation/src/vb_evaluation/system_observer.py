"""Watches a running system over ROS and keeps what an evaluation needs."""

from __future__ import annotations

import json
from typing import Dict, List, Optional, Tuple

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan
from std_msgs.msg import Header, String

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.ros.messages import NumpyOccupancyGrid, array_from_points, grid_from_message, message_from_pose2d
from vb_msgs.msg import BorderProgress, DetectorStatus, InteractionState, LabState, VirtualBorder, VirtualBorderArray


class SystemObserver:
    """Subscribes to the topics on which the stack reports its state. Each attribute is the newest value, or None.

    Must be created after `rospy.init_node`. It sends the system nothing but `plan`'s requests to move_base.
    """

    def __init__(self) -> None:
        self.state: Optional[InteractionState] = None
        self.progress: Optional[BorderProgress] = None
        self.borders: List[VirtualBorder] = []
        self.prior: Optional[GridMap] = None
        self.posterior: Optional[GridMap] = None
        self.lab: Optional[LabState] = None
        self.lab_at_save: Optional[LabState] = None  # when the first border was saved
        self.detectors: Dict[str, DetectorStatus] = {}
        self.outcome: Optional[dict] = None
        self._subscribers = [
            rospy.Subscriber(names.STATE, InteractionState, self._on_state),
            rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress),
            rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders),
            rospy.Subscriber(names.PHYSICAL_MAP, NumpyOccupancyGrid, self._on_prior),
            rospy.Subscriber(names.MAP_WITH_BORDERS, NumpyOccupancyGrid, self._on_posterior),
            rospy.Subscriber(names.LAB_STATE, LabState, self._on_lab, queue_size=1),
            rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_detector),
            rospy.Subscriber("/sim/participant_done", String, self._on_outcome),
        ]

    def _on_state(self, message: InteractionState) -> None:
        self.state = message
        if message.last_outcome == "saved" and self.lab_at_save is None:
            self.lab_at_save = self.lab

    def _on_progress(self, message: BorderProgress) -> None:
        self.progress = message

    def _on_borders(self, message: VirtualBorderArray) -> None:
        self.borders = message.borders

    def _on_prior(self, message: NumpyOccupancyGrid) -> None:
        self.prior = grid_from_message(message)

    def _on_posterior(self, message: NumpyOccupancyGrid) -> None:
        self.posterior = grid_from_message(message)

    def _on_lab(self, message: LabState) -> None:
        self.lab = message

    def _on_detector(self, message: DetectorStatus) -> None:
        self.detectors[message.camera] = message

    def _on_outcome(self, message: String) -> None:
        self.outcome = json.loads(message.data)

    def plan(self, start: Tuple[float, float, float], goal: Tuple[float, float, float], service: str) -> np.ndarray:
        """Asks move_base for a plan between two poses [m, m, rad]. Returns (N, 2) [m], empty if there is none.

        Raises:
            CodedError: "no_planner" if the service does not answer.
        """
        header = Header(0, rospy.Time.now(), names.MAP_FRAME)
        poses = [PoseStamped(header, message_from_pose2d(*pose)) for pose in (start, goal)]
        try:
            rospy.wait_for_service(service, timeout=20.0)
            reply = rospy.ServiceProxy(service, GetPlan)(*poses, 0.0)
        except (rospy.ROSException, rospy.ServiceException) as error:
            raise CodedError("no_planner", f"{service} does not answer: {error}") from None
        return array_from_points([pose.pose.position for pose in reply.plan.poses])
