"""Node: fuses the spots of all cameras into the drawn border."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import List, Optional

import numpy as np
import rospy
from geometry_msgs.msg import Point

from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.interaction_tables import BORDER, DEFAULT, SEED, STATES, state_by_name
from vb_core.notices import Notice, Severity
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_core.ros.messages import points_from_array, values_from_mapping
from vb_core.ros.notices import NoticePublisher
from vb_fusion.spot_collector import CollectedSpots, SpotCollector, FloorSpot
from vb_fusion.extraction import DrawnBorder, ExtractionParams, LiveExtractor
from vb_msgs.msg import BorderProgress, InteractionState, LaserSpot, VirtualBorder
from vb_msgs.srv import GetDrawnBorder, GetDrawnBorderResponse

PROGRESS_RATE = 8.0  # [1/s] of progress messages while spots arrive; the display needs 5, and a busy machine is slower
HEARTBEAT_PERIOD = 1.0  # [s] between progress messages while no spots arrive
# of one core, for the live chain: two cores must also search the images. The final chain has no such limit
LIVE_CPU_SHARE = 0.12
MAX_SHOWN = 300  # points in a message, enough to see the drawing and cheap to display


@dataclass(frozen=True)
class FusionParams(Parameters):
    """The node's parameters."""

    extraction: ExtractionParams = param(ExtractionParams())
    seen_timeout: float = param(0.5, "s", above=0.0, high=10.0)


class BorderFusionNode:
    """Collects the spots of all cameras, publishes the border as it grows, and hands it over on request.

    Subscribed topics:
        /virtual_borders/spots (vb_msgs/LaserSpot): of every camera.
        /virtual_borders/state (vb_msgs/InteractionState, latched): spots are collected in Border and Seed only.
    Published topics:
        /virtual_borders/progress (vb_msgs/BorderProgress, latched): at 8 Hz while spots arrive in Border and Seed, at
            1 Hz while none do, and on each change of state. The last one remains after the interaction.
        /virtual_borders/notices (vb_msgs/NoticeArray, latched): failures, none of which ends the node. Doubts about the
            drawing are published from the end of a stroke until the interaction ends.
    Services:
        /virtual_borders/get_drawn_border (vb_msgs/GetDrawnBorder): the border of everything drawn in an interaction; an
            empty interaction_id means the current one. The last interaction is available until the next begins.
    Parameters:
        config/border_fusion.yaml
    """

    def __init__(self, params: FusionParams) -> None:
        self._params = params
        self._collector = SpotCollector()
        self._live = LiveExtractor(params.extraction, LIVE_CPU_SHARE)
        self._lock = threading.Lock()
        self._has_new_spots = False  # whether spots arrived since the last progress message
        self._failure: Optional[CodedError] = None  # why the last attempt to extract a border failed
        self._doubts: List[Notice] = []  # doubts about the drawing, as last published
        self._published = -np.inf

        self._notices = NoticePublisher()
        self._progress = rospy.Publisher(names.PROGRESS, BorderProgress, queue_size=5, latch=True)
        self._state_input = rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=20)
        # 4 cameras at 25 Hz fill a queue of 400 in 4 s, longer than any extraction takes
        self._spot_input = rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=400, tcp_nodelay=True)
        self._service = rospy.Service(names.GET_DRAWN_BORDER, GetDrawnBorder, self._on_get_drawn_border)
        self._timer = node.WakeTimer(1.0 / PROGRESS_RATE)
        self._worker = node.Worker(self._timer, self._publish)

    # ------------------------------------------------------------- input
    def _on_state(self, message: InteractionState) -> None:
        state = state_by_name(message.name)
        if state.name not in STATES:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: ignoring the unknown state {message.name}")
            return
        with self._lock:
            state_before = self._collector.state
            entered = message.entered.to_sec()
            is_new = self._collector.set_state(state, message.interaction_id, entered, message.last_outcome)
            if is_new:
                self._live = LiveExtractor(self._params.extraction, LIVE_CPU_SHARE)
                self._failure = None
                self._doubts = []
        if is_new or state != state_before:
            self._timer.notify()

    def _on_spot(self, message: LaserSpot) -> None:
        camera = message.camera
        frame = message.header.frame_id.lstrip("/")
        if frame != names.MAP_FRAME:
            rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: ignoring spots of camera '{camera}' in frame '{frame}'")
            with self._lock:
                self._collector.ignore_frame(camera)
            return
        stamp = message.header.stamp.to_sec()
        position = message.position
        spot = FloorSpot(stamp, position.x, position.y, camera, float(message.confidence), bool(message.mobile))
        with self._lock:
            reason_ignored = self._collector.add(spot, rospy.get_time() or np.inf)
            if not reason_ignored:
                self._has_new_spots = True

    # ------------------------------------------------------------ output
    def _publish(self, state_changed: bool) -> None:
        """Publishes progress and notices. A drawing that breaks the extraction must not end the node."""
        try:
            if self._tick(state_changed):
                self._failure = None
        except Exception as error:
            if rospy.is_shutdown():
                return
            rospy.logerr_throttle(5.0, f"{rospy.get_name()}: {error!r}")
            reason = error.message if isinstance(error, CodedError) else repr(error)
            self._failure = CodedError("extraction_failed", what=reason)
        self._publish_notices()

    def _publish_notices(self) -> None:
        """Publishes the problems that persist, and the doubts about the drawing."""
        with self._lock:
            problems = [self._failure] if self._failure is not None else []
            if self._collector.is_incomplete:
                problems.append(CodedError("drawing_lost"))
            problems += [CodedError(code, camera=camera) for code, camera in sorted(self._collector.faults)]
            state = self._collector.state
            # while a stroke is drawn, nobody knows what it will leave out or leave open: the last doubts stay published
            is_drawing = state == BORDER and bool(self._cameras_seeing())
            if state == DEFAULT:
                self._doubts = []
            elif not is_drawing:
                self._doubts = self._find_doubts(self._live.drawn)
            doubts = self._doubts
        notices = [Notice.from_error(problem, Severity.WARNING) for problem in problems]
        self._notices.set(notices + doubts)

    def _cameras_seeing(self) -> List[str]:
        return self._collector.cameras_seeing(rospy.get_time(), self._params.seen_timeout)

    def _find_doubts(self, drawn: DrawnBorder) -> List[Notice]:
        """Returns the doubts about a drawing."""
        doubts = {}
        chain = drawn.chain
        if chain is not None and chain.left_out_spots:
            doubts["strokes_left_out"] = {"spots": str(chain.left_out_spots)}
        # an unseen piece may hide a right-angled corner, which is at most half of the piece's length away from it
        if chain is not None and chain.longest_unseen_gap > 0.5 * self._params.extraction.eps:
            doubts["piece_unseen"] = {"length": f"{chain.longest_unseen_gap:.1f}"}
        if drawn.competing_dwell is not None:
            doubts["seed_held_elsewhere"] = {"seconds": f"{drawn.competing_dwell.seconds:.0f}"}
        return [Notice(code, Severity.WARNING, values=values) for code, values in doubts.items()]

    def _tick(self, state_changed: bool) -> bool:
        """Extracts and publishes the border so far if there is a reason to; returns whether there was."""
        with self._lock:
            now = time.monotonic()
            is_due = self._has_new_spots or now - self._published >= HEARTBEAT_PERIOD
            self._has_new_spots = False
            is_growing = is_due and bool(self._collector.state.collects)
            if not (state_changed or is_growing) or not self._collector.interaction_id:
                return False
            snapshot = self._collector.snapshot()
            live = self._live
        self._published = now
        # after a change of state the published chain must be current
        drawn = live.update(snapshot, time.monotonic, force=state_changed)
        with self._lock:
            if snapshot.interaction_id != self._collector.interaction_id:
                return True  # another interaction has begun since the snapshot
            self._progress.publish(self._progress_message(snapshot, drawn))
            if snapshot.may_clear:  # the last spots have been shown by now
                self._collector.clear()
        return True

    def _progress_message(self, snapshot: CollectedSpots, drawn: DrawnBorder) -> BorderProgress:
        message = BorderProgress()
        message.header.stamp = rospy.get_rostime()
        message.header.frame_id = names.MAP_FRAME
        message.interaction_id = snapshot.interaction_id
        message.border_spots, message.seed_spots, message.ignored_spots = snapshot.counts
        shown = subsample_evenly(snapshot.border)
        message.points = points_from_array(shown["points"])
        message.point_cameras = bytes(np.minimum(shown["cameras"], 255).astype(np.uint8))
        message.cameras = snapshot.cameras
        message.cameras_seeing_spot = self._cameras_seeing()
        chain, seed = drawn.chain, drawn.seed
        if chain is not None:
            message.chain = points_from_array(chain.points)
            message.closed = chain.closed
            message.left_out_spots = chain.left_out_spots
            message.left_out = points_from_array(subsample_evenly(chain.left_out))
            message.code, message.message = "ok", chain.reason
            message.values = values_from_mapping(chain.closure.values)
        if seed is not None:
            message.has_seed = True
            message.seed = Point(*seed, 0.0)
        missing = drawn.chain_error
        if missing is None and snapshot.state == SEED:
            missing = drawn.seed_error
        if missing is not None:
            message.code, message.message = missing.code, missing.message
            message.values = values_from_mapping(missing.values)
        return message

    def _on_get_drawn_border(self, request) -> GetDrawnBorderResponse:
        with self._lock:
            snapshot = self._collector.snapshot()
            is_incomplete = self._collector.is_incomplete
            live = self._live
        interaction = request.interaction_id or snapshot.interaction_id
        try:
            if not interaction or interaction != snapshot.interaction_id:
                raise CodedError("unknown_interaction", interaction=interaction)
            if is_incomplete:
                raise CodedError("drawing_lost")
            drawn = live.update(snapshot, time.monotonic, force=True)
            missing = drawn.chain_error or drawn.seed_error
            if missing is not None:
                raise missing
        except Exception as error:
            refusal = error if isinstance(error, CodedError) else CodedError("extraction_failed", what=repr(error))
            log = rospy.loginfo if refusal is error else rospy.logerr
            log("%s: no border: %s", rospy.get_name(), refusal)
            values = values_from_mapping(refusal.values)
            return GetDrawnBorderResponse(code=refusal.code, message=refusal.message, values=values)
        chain = drawn.chain
        values = {"vertices": len(chain.points), "length": f"{chain.length:.2f}", "reason": chain.reason}
        sentence = sentences.translate("drawn_border_ready", values)
        rospy.loginfo("%s: border of %d spots: %s", rospy.get_name(), snapshot.counts[0], sentence)
        points = points_from_array(chain.points)
        kind = VirtualBorder.POLYGON if chain.closed else VirtualBorder.SEPARATING_CURVE
        seed = Point(*drawn.seed, 0.0)
        border = VirtualBorder(points=points, kind=kind, seed=seed, occupancy=1.0, enabled=True)
        return GetDrawnBorderResponse(True, "ok", sentence, values_from_mapping(values), border)

    def close(self) -> None:
        """Ends the worker."""
        self._timer.close()
        self._worker.join(1.0)  # a running worker would publish notices again
        self._notices.close()


def subsample_evenly(rows: np.ndarray) -> np.ndarray:
    """Returns at most MAX_SHOWN of the rows, evenly spaced, including the first and the last."""
    if len(rows) <= MAX_SHOWN:
        return rows
    return rows[np.linspace(0, len(rows) - 1, MAX_SHOWN).astype(int)]


def build() -> BorderFusionNode:
    """Reads the parameters and makes the node."""
    return BorderFusionNode(parameters.read(FusionParams))
