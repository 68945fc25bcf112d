"""Node: the page for phones and wall displays."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque
from functools import partial
from pathlib import Path
from typing import Any, Deque, Dict, List, NamedTuple, Optional

import rospy
from vb_msgs.msg import BorderPreview, BorderProgress, DetectorStatus, DriverState, InteractionState, LaserSpot
from vb_msgs.msg import VirtualBorder, VirtualBorderArray

from vb_core import names
from vb_core.border_changes import find_border_changes
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.capabilities import Capabilities
from vb_core.interaction_tables import DEFAULT
from vb_core.request_origin import is_loopback
from vb_core.ros import messages, node, parameters
from vb_core.ros.notices import NoticeListener
from vb_core.ros.robot_status import CapabilitiesListener
from vb_core.ros.transforms import TransformLookup
from vb_web import page_images, page_messages
from vb_web.access_control import Sessions, load_access_codes
from vb_web.action_executor import ActionExecutor
from vb_web.camera_images import CameraImages
from vb_web.action_parser import Bounds
from vb_web.server import PageParams, PageServer, page_urls
from vb_web.page_view import PageView, coarse_age, mark_borders, json_number

_POSE_PERIOD = 0.1  # [s] between two updates of the robots' poses
_HEALTH_PERIOD = 0.5  # [s] between two checks of what has fallen silent
_SILENCE_TIMEOUT = 4.0  # [s] without a message; detectors publish every second, robots' drivers more often
_SESSIONS = "page_sessions.json"  # beside the codes
_UNDER_WAY = ("saving", "changing")  # answers that precede the final one
_EVENTS = 100


class _ReceivedEntry(NamedTuple):
    """An entry of a section, and the time at which its newest message arrived."""

    received_at: float  # [s] monotonic clock
    entry: Dict[str, Any]

    def with_presence(self, now: float) -> Dict[str, Any]:
        is_present = now - self.received_at < _SILENCE_TIMEOUT
        return {**self.entry, "present": is_present}


class PageNode:
    """Serves the page: shows the system's state in browsers, and carries out operators' requests.

    Subscribed topics:
        /map, /virtual_borders/map (nav_msgs/OccupancyGrid)
        /virtual_borders/borders (vb_msgs/VirtualBorderArray), /virtual_borders/state (vb_msgs/InteractionState)
        /virtual_borders/progress (vb_msgs/BorderProgress), /virtual_borders/preview (vb_msgs/BorderPreview)
        /virtual_borders/spots (vb_msgs/LaserSpot), /virtual_borders/notices (vb_msgs/NoticeArray)
        /virtual_borders/detectors (vb_msgs/DetectorStatus), /virtual_borders/drivers (vb_msgs/DriverState)
        /virtual_borders/robots (vb_msgs/RobotStatusArray): what is connected, and thus what the page can offer
        /tf, /tf_static (tf2_msgs/TFMessage): the robots' and the cameras' poses
        <detector>/debug_image, /<camera>/image_raw (sensor_msgs/Image): only while a browser shows them
        /<camera>/image_raw/compressed (sensor_msgs/CompressedImage): only while a browser shows it
        /<camera>/camera_info (sensor_msgs/CameraInfo): only while a browser shows the camera's image
    Published topics:
        /virtual_borders/stop (vb_msgs/Stop): when Stop is pressed; it reaches robots without any other node.
    Services called:
        /virtual_borders/command (vb_msgs/Command), /virtual_borders/confirm_map (vb_msgs/ConfirmMap)
        /virtual_borders/preview_border (vb_msgs/PreviewBorder), /virtual_borders/add_border (vb_msgs/AddBorder)
        /virtual_borders/update_border (vb_msgs/UpdateBorder), /virtual_borders/remove_border (vb_msgs/RemoveBorder)
        /virtual_borders/rename_border (vb_msgs/RenameBorder), /virtual_borders/send_robot (vb_msgs/SendRobot)
        /virtual_borders/set_border_enabled (vb_msgs/SetBorderEnabled), /virtual_borders/undo_redo (vb_msgs/UndoRedo)
    Parameters:
        config/page.yaml
    """

    def __init__(self, params: PageParams) -> None:
        self._params = params
        self._lock = threading.Lock()
        self._borders_lock = threading.Lock()
        self._view = PageView()
        self._images = page_images.ImageCache()
        self._events: Deque[Dict[str, Any]] = deque(maxlen=_EVENTS)  # what the page shows as history
        self._grid: Optional[GridMap] = None
        self._borders: Optional[VirtualBorderArray] = None  # None until they are known
        self._border_marks: Dict[str, str] = {}  # by the border's id
        self._capabilities: Optional[Capabilities] = None  # None while it is not known what is connected
        self._has_stoppable_robot = False  # whether a robot that obeys Stop was connected since this node was started
        self._base_frames: Dict[str, str] = {}  # by robot
        self._last_answer: Any = None
        self._is_drawing = False
        self._state_at = time.monotonic()
        self._spots: Dict[str, Any] = {}  # each camera's newest spot
        self._notices_timer = node.WakeTimer(_HEALTH_PERIOD)  # the notices of a silent node expire without a message
        self._notices = NoticeListener(self._notices_timer.notify)
        self._cameras: Dict[str, _ReceivedEntry] = {}
        self._detectors: Dict[str, str] = {}  # namespaces by camera
        self._drivers: Dict[str, _ReceivedEntry] = {}  # by robot
        self._transforms = TransformLookup()
        self._camera_images = CameraImages(
            self._detectors.get, params.cameras, params.image_transport, lambda: self._grid, self._transforms
        )
        self._actions = ActionExecutor(
            lambda border_id: _index_borders(self._borders).get(border_id),
            lambda: self._connected(names.STATE),
            lambda: {"addresses": self._addresses, **self._codes},
        )
        self._subscribe()
        self._robots = CapabilitiesListener()
        self._serve()
        # the timers use wall time, which goes on when simulated time stops
        self._timers = {
            node.WakeTimer(_POSE_PERIOD): self._show_poses,
            node.WakeTimer(_HEALTH_PERIOD): self._show_health,
            self._notices_timer: self._show_notices,
        }
        for timer, show in self._timers.items():
            node.Worker(timer, lambda _woken, show=show: show())

    def _serve(self) -> None:
        """Starts the server and logs where the page is."""
        params = self._params
        codes_file = Path(params.codes_file).expanduser()
        self._codes: Dict[str, str] = {}
        sessions = None
        hint = ""
        if not is_loopback(params.address):
            sessions_file = codes_file.with_name(_SESSIONS)
            node.keep_private(codes_file, sessions_file, codes_file.with_name("page.key"))
            self._codes = load_access_codes(codes_file)
            sessions = Sessions(self._codes, sessions_file, partial(rospy.logwarn, "%s: %s", rospy.get_name()))
            hint = f"; its codes are in {codes_file}"

        def on_fault(_error: BaseException) -> None:
            node.shut_down_with_error(CodedError("internal_error"))

        self._server = PageServer(
            params, sessions, self._view, self._images, self._actions, self._camera_images, self._find_bounds, on_fault
        )
        self._server.start()
        self._addresses = page_urls(params, self._server.port, _own_addresses())
        rospy.loginfo("%s: the page is at %s%s", rospy.get_name(), " or ".join(self._addresses), hint)

    def close(self) -> None:
        """Ends threads and server."""
        for timer in self._timers:
            timer.close()
        self._maps.close()
        self._server.close()

    # ------------------------------------------------------------- inputs
    def _subscribe(self) -> None:
        """Subscribes to all topics. A separate worker draws the maps, because that would block a callback for too long."""
        self._maps: node.Mailbox = node.Mailbox()
        self._grids: Dict[str, Any] = {}  # the newest message of each topic
        node.Worker(self._maps, lambda _: self._draw_maps())
        large = {"queue_size": 1, "buff_size": 2**24, "tcp_nodelay": True}
        small = {"tcp_nodelay": True}
        self._subscribers = {
            topic: rospy.Subscriber(topic, kind, callback, **options)
            for topic, kind, callback, options in (
                (names.PHYSICAL_MAP, messages.NumpyOccupancyGrid, self._on_grid, large),
                (names.MAP_WITH_BORDERS, messages.NumpyOccupancyGrid, self._on_grid, large),
                (names.BORDERS, VirtualBorderArray, self._on_borders, {"queue_size": 2, **small}),
                (names.STATE, InteractionState, self._on_state, {"queue_size": 10, **small}),
                (names.PROGRESS, BorderProgress, self._on_progress, {"queue_size": 1, **small}),
                (names.PREVIEW, messages.NumpyBorderPreview, self._on_preview, large),
                (names.SPOTS, LaserSpot, self._on_spot, {"queue_size": 20, **small}),
                (names.DETECTORS, DetectorStatus, self._on_detector, {"queue_size": 20}),
                (names.DRIVERS, DriverState, self._on_driver, {"queue_size": 20}),
            )
        }

    def _on_grid(self, message: Any) -> None:
        self._grids[message._connection_header["topic"]] = message
        self._maps.put(True)

    def _draw_maps(self) -> None:
        grids = {topic: messages.grid_from_message(message) for topic, message in list(self._grids.items())}
        posterior = grids.get(rospy.resolve_name(names.MAP_WITH_BORDERS))
        prior = grids.get(rospy.resolve_name(names.PHYSICAL_MAP)) or posterior
        if prior is None:
            return
        self._grid = prior
        base = page_images.map_layer(prior)
        self._images.put("map", base)
        restricted = None
        if posterior is not None and posterior.same_geometry(prior):
            restricted = page_images.draw_restricted(prior, posterior)
            self._images.put("restricted", restricted)
        self._view.put("map", page_images.map_section(prior, base, restricted, floor=bool(self._params.cameras)))

    def _show_capabilities(self) -> None:
        """Shows what the connected robots can do. Browsers get a null section once that is no longer known."""
        message, capabilities = self._robots.current() or (None, None)
        changed = capabilities != self._capabilities
        self._capabilities = capabilities
        if message is not None and capabilities is not None:
            self._base_frames = {robot.robot: robot.frame for robot in message.robots}
            can_stop = "stop" in capabilities.commands
            self._has_stoppable_robot = self._has_stoppable_robot or can_stop
            # while a driver is being restarted, Stop must not vanish from under somebody's finger
            kept_commands = ("stop", "resume") if self._has_stoppable_robot and not can_stop else ()
            self._view.put("capabilities", page_messages.capabilities_section(capabilities, message, kept_commands))
            self._view.put("goals", page_messages.goals_section(message))
        elif changed:
            self._view.put("capabilities", None)
            self._view.put("goals", {})
        if changed:
            self._show_borders()

    def _on_borders(self, message: VirtualBorderArray) -> None:
        previous = self._borders
        self._borders = message
        self._show_borders()
        if previous is not None:
            for kind, border in find_border_changes(_index_borders(previous), _index_borders(message)):
                self._log_event(f"page_event_{kind}", {"border": border.name or border.id})

    def _show_borders(self) -> None:
        """Shows the newest borders. The lock keeps a slow thread from replacing them by an older list."""
        with self._borders_lock:
            if self._borders is None:
                return
            section = page_messages.borders_section(self._borders, self._capabilities)
            self._border_marks = mark_borders(self._border_marks, [border["id"] for border in section["list"]])
            for border in section["list"]:
                border["mark"] = self._border_marks[border["id"]]
            self._view.put("borders", section)

    def _on_state(self, message: InteractionState) -> None:
        section = page_messages.state_section(message)
        self._state_at = time.monotonic()
        self._view.put("state", section)
        self._is_drawing = section["name"] != DEFAULT.name
        if not self._is_drawing:
            self._view.put("progress", None)
        last = section["last"]
        answer = (last["command"], last["at"], last["code"])
        if last["code"] in _UNDER_WAY:
            return  # the history shows only the final answer
        if self._last_answer is not None and answer != self._last_answer and last["command"]:
            event = "page_event_command" if last["ok"] else "page_event_refused"
            values = {**last["values"], "command": last["command"], "code": last["code"]}
            self._log_event(event, values, last["source"])
        self._last_answer = answer

    def _on_progress(self, message: BorderProgress) -> None:
        self._view.put("progress", page_messages.progress_section(message) if self._is_drawing else None)

    def _on_preview(self, message: BorderPreview) -> None:
        self._view.put("preview", page_messages.preview_section(message))

    def _on_spot(self, message: LaserSpot) -> None:
        entry = page_messages.spot_entry(message)
        if entry is not None and message.header.frame_id.lstrip("/") == names.MAP_FRAME:
            # by the stamp, browsers distinguish a spot that does not move from a message that was sent again
            self._spots[message.camera] = [*entry, json_number(message.header.stamp.to_sec(), 3)]
            while len(self._spots) > 20:
                self._spots.pop(next(iter(self._spots)))
            self._view.put("spots", dict(self._spots))

    def _show_notices(self) -> None:
        self._view.put("notices", page_messages.notices_section(self._notices.current()[:30]))

    def _on_detector(self, message: DetectorStatus) -> None:
        with self._lock:
            self._detectors[message.camera] = message.detector
            self._cameras[message.camera] = _ReceivedEntry(time.monotonic(), page_messages.detector_entry(message))

    def _on_driver(self, message: DriverState) -> None:
        with self._lock:
            self._drivers[message.robot] = _ReceivedEntry(time.monotonic(), page_messages.driver_entry(message))

    # ------------------------------------------------------------- periodic checks
    def _show_poses(self) -> None:
        if not self._server.browsers:
            return
        poses = {}
        for robot, frame in self._base_frames.items():
            pose = self._transforms.pose_on_map(frame, _SILENCE_TIMEOUT)
            if pose is not None:
                poses[robot] = [json_number(value, 2) for value in pose]  # a robot that stands still is reported once
        self._view.put("robots", poses)

    def _show_health(self) -> None:
        self._show_capabilities()
        now = time.monotonic()
        with self._lock:
            cameras = [received.with_presence(now) for received in self._cameras.values()]
            drivers = {robot: received.with_presence(now) for robot, received in self._drivers.items()}
        self._view.put("cameras", sorted(cameras, key=lambda entry: entry["name"]))
        self._view.put("drivers", drivers)
        health = {"manager": self._connected(names.STATE), "integrator": self._connected(names.BORDERS)}
        self._view.put("health", {**health, "silent": coarse_age(now - self._state_at)})
        self._view.put("beat", int(now) // 2)  # tells browsers that they are still connected

    def _connected(self, topic: str) -> bool:
        return self._subscribers[topic].get_num_connections() > 0

    # ------------------------------------------------------------- history
    def _log_event(self, code: str, values: Dict[str, Any], source: str = "") -> None:
        with self._lock:
            self._events.append({"at": round(time.time(), 1), "code": code, "values": values, "source": source})
            events = list(self._events)
        self._view.put("events", events)

    # ------------------------------------------------------------- for the server
    def _find_bounds(self) -> Optional[Bounds]:
        if self._grid is None:
            return None
        corners = self._grid.corners()
        return corners.min(axis=0).tolist(), corners.max(axis=0).tolist()


def _index_borders(message: Optional[VirtualBorderArray]) -> Dict[str, VirtualBorder]:
    return {border.id: border for border in message.borders} if message is not None else {}


def _own_addresses() -> List[str]:
    """Returns this computer's address in the network, and its host name."""
    host_names: List[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        probe.connect(("192.0.2.1", 9))  # a documentation address; connecting a datagram socket sends nothing
        host_names.append(probe.getsockname()[0])
    return [*host_names, socket.gethostname()]


def build() -> PageNode:
    """Reads the parameters and makes the node."""
    return PageNode(parameters.read(PageParams))
