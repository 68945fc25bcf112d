"""Watches a running system over ROS and keeps what an evaluation needs."""

from __future__ import annotations

import json
from typing import Any, Callable, Dict, List, Optional, Tuple, Type

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.srv import GetPlan, GetPlanRequest
from std_msgs.msg import Header, String

from vb_core import names
from vb_core.grid_map import GridMap
from vb_core.ros import services
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
            self._keep("progress", names.PROGRESS, BorderProgress),
            self._keep("borders", names.BORDERS, VirtualBorderArray, lambda message: message.borders),
            self._keep("prior", names.PHYSICAL_MAP, NumpyOccupancyGrid, grid_from_message),
            self._keep("posterior", names.MAP_WITH_BORDERS, NumpyOccupancyGrid, grid_from_message),
            rospy.Subscriber(names.LAB_STATE, LabState, self._on_lab, queue_size=1),
            rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_detector),
            self._keep("outcome", "/sim/participant_done", String, lambda message: json.loads(message.data)),
        ]

    def _keep(
        self, attribute: str, topic: str, message_type: Type, convert: Callable[[Any], Any] = lambda message: message
    ) -> rospy.Subscriber:
        return rospy.Subscriber(topic, message_type, lambda message: setattr(self, attribute, convert(message)))

    def _on_state(self, message: InteractionState) -> None:
        self.state = message
        if message.last_outcome == "saved" and self.lab_at_save is None:
            self.lab_at_save = self.lab

    def _on_lab(self, message: LabState) -> None:
        self.lab = message

    def _on_detector(self, message: DetectorStatus) -> None:
        self.detectors[message.camera] = message

    def plan(self, start: Tuple[float, float, float], goal: Tuple[float, float, float], service: str) -> np.ndarray:
        """Asks move_base for a plan between two poses [m, m, rad]. Returns (N, 2) [m], empty if there is none.

        Raises:
            CodedError: "no_service" or "no_response", as in `services.call`.
        """
        header = Header(0, rospy.Time.now(), names.MAP_FRAME)
        poses = [PoseStamped(header, message_from_pose2d(*pose)) for pose in (start, goal)]
        reply = services.call(service, GetPlan, GetPlanRequest(*poses, 0.0), {"who": service}, 20.0, 20.0)
        return array_from_points([pose.pose.position for pose in reply.plan.poses])
