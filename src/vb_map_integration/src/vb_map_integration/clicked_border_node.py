"""Node: borders from RViz's "Publish Point" tool."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Callable, List, Optional

import numpy as np
import rospy
from geometry_msgs.msg import PointStamped
from std_msgs.msg import String
from std_srvs.srv import Trigger, TriggerResponse
from visualization_msgs.msg import Marker, MarkerArray

from vb_core import geometry, names
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_core.ros.transforms import TransformLookup
from vb_map_integration.borders import draft_markers
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_client import BorderClient
from vb_map_integration.borders.clicks import ClickParams, Clicks


@dataclass(frozen=True)
class ClickedBorderParams(Parameters):
    """The node's own parameters, beside `ClickParams`."""

    frame_id: str = param(names.MAP_FRAME)


class ClickedBorderNode:
    """Makes borders from clicked points: chain, its end, seed; then preview, and if that finds no error, add.

    Subscribed topics:
        /clicked_point (geometry_msgs/PointStamped): clicks in any frame that tf connects with the map's. The rule
            for what a click means is that of `Clicks`.
        /tf, /tf_static (tf2_msgs/TFMessage): the frames of clicks to the map's.
    Published topics:
        ~status (std_msgs/String, latched): the result of the last click, and what the next one does.
        ~markers (visualization_msgs/MarkerArray, latched): the chain so far.
    Services:
        ~close, ~end (std_srvs/Trigger): end the chain as a polygon, as a separating curve.
        ~remove_last (std_srvs/Trigger): undoes a click.
        ~cancel (std_srvs/Trigger): forgets the chain.
    Services called:
        /virtual_borders/preview_border (vb_msgs/PreviewBorder), /virtual_borders/add_border (vb_msgs/AddBorder)
    Parameters:
        config/clicked_border.yaml
    """

    def __init__(self, params: ClickedBorderParams, click_params: ClickParams) -> None:
        self._params = params
        self._clicks = Clicks(click_params)
        self._client = BorderClient("clicked_point", params.frame_id)
        self._lock = threading.Lock()
        self._transforms: Optional[TransformLookup] = None
        self._status_out = rospy.Publisher("~status", String, queue_size=1, latch=True)
        self._markers_out = rospy.Publisher("~markers", MarkerArray, queue_size=1, latch=True)
        # each click counts, in the order in which they came
        self._inbox: "node.Queue[PointStamped]" = node.Queue()
        node.Worker(self._inbox, self._take_click)
        for name, command in (
            ("~close", lambda: self._clicks.end(closed=True)),
            ("~end", lambda: self._clicks.end(closed=False)),
            ("~remove_last", self._clicks.remove_last),
            ("~cancel", self._clicks.cancel),
        ):
            rospy.Service(name, Trigger, lambda _, command=command: self._trigger(command))
        rospy.Subscriber("/clicked_point", PointStamped, self._inbox.put, queue_size=100)
        self._show("")

    def close(self) -> None:
        """Ends the worker."""
        self._inbox.close()

    def _take_click(self, message: PointStamped) -> None:
        try:
            place = self._place(message)
            with self._lock:
                border = self._clicks.click(place)
                if border is None:
                    self._show("")
            if border is not None:
                self._save(border)
        except CodedError as error:
            with self._lock:
                self._show(error.message)

    def _place(self, message: PointStamped) -> np.ndarray:
        """Transforms a click to (2,) [m] in the map's frame."""
        point = np.array([message.point.x, message.point.y, message.point.z])
        frame = message.header.frame_id.lstrip("/")
        if frame and frame != self._params.frame_id:
            if self._transforms is None:  # clicks in RViz come in its fixed frame, nearly always the map's
                self._transforms = TransformLookup()
            point = geometry.apply(self._transforms.lookup(self._params.frame_id, frame, rospy.Time(0), 1.0), point)
        return point[:2]

    def _save(self, border: VirtualBorder) -> None:
        answer = self._client.save(border)
        warnings = "; ".join(found.message for found in answer.issues) if answer.success else ""
        word = "added" if answer.success else f"refused [{answer.code}]"
        text = f"{word}: {answer.message}" + (f" ({warnings})" if warnings else "")
        with self._lock:
            if answer.success:
                self._clicks.cancel()
            self._show(text)

    def _trigger(self, command: Callable[[], None]) -> TriggerResponse:
        with self._lock:
            try:
                command()
            except CodedError as error:
                self._show(error.message)
                return TriggerResponse(False, str(error))
            self._show("")
            return TriggerResponse(True, self._clicks.describe())

    def _show(self, news: str) -> None:
        text = f"{news}. {self._clicks.describe()}" if news else self._clicks.describe()
        if news:
            rospy.loginfo("%s: %s", rospy.get_name(), news)
        self._status_out.publish(text)
        clear = Marker(action=Marker.DELETEALL)
        clear.header.frame_id = self._params.frame_id
        markers: List[Marker] = []
        points = np.array(self._clicks.points).reshape(-1, 2)
        if len(points) > 1:
            markers.append(draft_markers.chain_marker(points, bool(self._clicks.closed), draft_markers.DRAFT))
        if len(points):
            markers.append(draft_markers.vertices_marker(points, draft_markers.DRAFT))
            markers.append(draft_markers.text_marker(text, points[-1], draft_markers.DRAFT))
        self._markers_out.publish([clear] + draft_markers.numbered(markers, self._params.frame_id, "clicked_border"))


def build() -> ClickedBorderNode:
    """Reads the parameters and makes the node."""
    own, shared = (tuple(cls.__dataclass_fields__) for cls in (ClickedBorderParams, ClickParams))
    return ClickedBorderNode(
        parameters.read(ClickedBorderParams, ignore=shared), parameters.read(ClickParams, ignore=own)
    )
