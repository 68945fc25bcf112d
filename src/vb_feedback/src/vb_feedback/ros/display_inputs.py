"""The inputs of both displays, the smart display and the projector, as one consistent snapshot."""

from __future__ import annotations

import collections
import threading
from dataclasses import dataclass, replace
from typing import Any, Callable, Deque, Optional, Tuple

import numpy as np
import rospy

from vb_core import names
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.ros.messages import NumpyBorderPreview, grid_from_message
from vb_feedback.display.scene import TrailPoint
from vb_msgs.msg import BorderPreview, BorderProgress, InteractionState, LaserSpot, VirtualBorder, VirtualBorderArray

_MAX_SPOTS = 60  # of all cameras together; enough for 1.5 s if one or two cameras see the spot in 25 frames/s


@dataclass(frozen=True)
class DisplayInputs:
    """The newest messages, each None as long as there is none."""

    state: Optional[InteractionState] = None
    progress: Optional[BorderProgress] = None
    preview: Optional[BorderPreview] = None
    region: Optional[GridMap] = None  # the area that saving would restrict, taken from the preview
    borders: Tuple[VirtualBorder, ...] = ()
    spots: Tuple[TrailPoint, ...] = ()


class InputListener:
    """Keeps the newest messages. Its methods may be called from any thread.

    Args:
        on_change: called after each message, in the subscriber's thread.
    """

    def __init__(self, on_change: Callable[[], None]) -> None:
        self._on_change = on_change
        self._lock = threading.Lock()
        self._newest = DisplayInputs()
        self._spots: Deque[TrailPoint] = collections.deque(maxlen=_MAX_SPOTS)
        rospy.Subscriber(names.STATE, InteractionState, lambda state: self._change(state=state), queue_size=5)
        rospy.Subscriber(names.PROGRESS, BorderProgress, lambda drawn: self._change(progress=drawn), queue_size=1)
        rospy.Subscriber(names.PREVIEW, NumpyBorderPreview, self._on_preview, queue_size=1)
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=50, tcp_nodelay=True)

    def current(self) -> DisplayInputs:
        """Returns the newest inputs. Progress and preview are None unless they belong to the current interaction."""
        with self._lock:
            newest = replace(self._newest, spots=tuple(self._spots))
        interaction_id = newest.state.interaction_id if newest.state is not None else ""

        def is_current(message: Any) -> bool:
            return message is not None and interaction_id != "" and message.interaction_id == interaction_id

        if not is_current(newest.progress):
            newest = replace(newest, progress=None)
        if not is_current(newest.preview) or not newest.preview.available:
            newest = replace(newest, preview=None, region=None)
        return newest

    def _change(self, **newest: Any) -> None:
        with self._lock:
            self._newest = replace(self._newest, **newest)
        self._on_change()

    def _on_preview(self, message: BorderPreview) -> None:
        region = None
        try:
            region = grid_from_message(message.region) if len(message.region.data) else None
        except CodedError as error:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: the preview: {error}")
        self._change(preview=message, region=region)

    def _on_borders(self, message: VirtualBorderArray) -> None:
        self._change(borders=tuple(message.borders))

    def _on_spot(self, message: LaserSpot) -> None:
        x, y = message.position.x, message.position.y
        if not (np.isfinite(x) and np.isfinite(y)):
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: a spot of camera '{message.camera}' has no position")
            return
        with self._lock:
            self._spots.append(TrailPoint(message.camera, x, y, message.header.stamp.to_sec()))
        self._on_change()
