"""Connects this system to the smart home's hub by MQTT."""

from __future__ import annotations

import json
import re
import threading
import time
import traceback
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Set, Tuple

import rospy
from vb_msgs.msg import DetectorStatus, InteractionState, VirtualBorder, VirtualBorderArray
from vb_msgs.srv import SetBorderEnabled, SetBorderEnabledRequest

from vb_core import names, sentences
from vb_core.errors import CodedError, ParameterError
from vb_core.rate_limiter import RateLimiter
from vb_core.notices import Notice, Severity
from vb_core.capabilities import effective_commands
from vb_core.interaction_tables import COMMANDS
from vb_core.parameters import Parameters, param
from vb_core.ros import messages, node, parameters, services
from vb_core.ros.commands import CommandSender, send
from vb_core.ros.messages import NumpyOccupancyGrid
from vb_core.ros.notices import NoticeListener, NoticePublisher
from vb_core.ros.robot_status import CapabilitiesListener
from vb_mqtt import entities
from vb_mqtt.broker_connection import MqttClient, read_connection
from vb_mqtt.entities import CONFIRM, INTEGRATOR, MANAGER, MONITOR, OFFLINE, ONLINE, LabEntities, entity_key
from vb_mqtt.incoming_requests import BURST, RATE, Inbox, MqttRequest

SOURCE = "home_assistant"
SWITCH_BORDER = (
    "switch_border"  # stands for the switching of a border in the queue of commands, which keeps their order
)
_PERIOD = 1.0  # [s] between two rounds of publishing, in which silent nodes are found too
_SILENCE = 4.0  # [s] after which a node is silent; a detector publishes once a second, the manager ten times
_GRACE = 5.0  # [s] without a connection to the broker, after which a notice is published


@dataclass(frozen=True)
class MqttParams(Parameters):
    """The node's parameters; config/mqtt.yaml explains them."""

    broker: str = param("127.0.0.1")
    connection_file: str = param("~/.ros/virtual_borders/mqtt.yaml")
    device: str = param("virtual_borders")
    language: str = param("en", choices=sentences.languages())
    cameras: list = param([])

    def __post_init__(self) -> None:
        super().__post_init__()
        if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", self.device):
            raise ParameterError("device", f"expected up to 40 letters, digits, _ and -, got {self.device!r}")


class MqttNode:
    """Shows this system in Home Assistant by MQTT discovery, and accepts commands from there.

    Subscribed topics:
        /map, /virtual_borders/map (nav_msgs/OccupancyGrid)
        /virtual_borders/borders (vb_msgs/VirtualBorderArray), /virtual_borders/state (vb_msgs/InteractionState)
        /virtual_borders/detectors (vb_msgs/DetectorStatus), /virtual_borders/robots (vb_msgs/RobotStatusArray)
        /virtual_borders/notices (vb_msgs/NoticeArray), /virtual_borders/drivers (vb_msgs/DriverState)
    Published topics:
        /virtual_borders/stop (vb_msgs/Stop): on `stop`; it reaches robots without any other node.
        /virtual_borders/notices (vb_msgs/NoticeArray): mqtt_not_connected.
    Services called:
        /virtual_borders/command (vb_msgs/Command), /virtual_borders/set_border_enabled (vb_msgs/SetBorderEnabled)
    Parameters:
        config/mqtt.yaml
    """

    def __init__(self, params: MqttParams) -> None:
        self._language = params.language
        self._lab = LabEntities(params.device, params.language, tuple(params.cameras))
        self._lock = threading.Lock()
        self._inbox = Inbox(time.time())
        self._answer_limiter = RateLimiter(RATE, BURST)
        self._refusal_counts: Dict[str, int] = {}  # by code
        self._description_topics: Set[str] = set()  # topics at which the broker has a description of an entity
        self._borders: Optional[Dict[str, VirtualBorder]] = None  # by key, or None if they are not known yet
        self._grids: Dict[str, Any] = {}  # the newest message of each topic
        self._is_question_open = False
        self._last_heard: Dict[str, float] = {}  # [s] on the monotonic clock, by node or camera
        self._previous_notices: Optional[Set[Tuple[str, ...]]] = None  # keys of the previous round's notices
        self._connected_at = time.monotonic()
        connection = read_connection(Path(params.connection_file).expanduser())
        subscriptions = {self._lab.topic(entities.COMMAND): self._on_message, self._lab.discovery: self._on_description}
        will = (self._lab.topic("availability"), OFFLINE.encode())
        self._broker = MqttClient(params.broker, connection, params.device, will, subscriptions, _on_fault)
        self._command_sender = CommandSender(SOURCE, self._on_answer)
        self._notice_publisher = NoticePublisher()
        self._notices = NoticeListener()
        self._robots = CapabilitiesListener()
        self._maps = node.Mailbox()
        self._publish_timer = node.WakeTimer(_PERIOD)
        self._subscribe()
        self._broker.put(will[0], ONLINE.encode())
        self._publish_all()
        node.Worker(self._maps, lambda _item: self._publish_map())
        node.Worker(self._publish_timer, lambda _woken: self._publish_all())
        self._broker.start()
        rospy.loginfo("%s: the broker is %s", rospy.get_name(), self._broker.address)

    def close(self) -> None:
        """Tells the hub that the system is offline, and ends the threads."""
        self._maps.close()
        self._publish_timer.close()
        self._broker.close()

    # ------------------------------------------------------------------ from the system
    def _subscribe(self) -> None:
        self._borders_subscriber = rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=2)
        for topic in (names.PHYSICAL_MAP, names.MAP_WITH_BORDERS):
            rospy.Subscriber(topic, NumpyOccupancyGrid, self._on_grid, queue_size=1, buff_size=2**24)
        rospy.Subscriber(names.STATE, InteractionState, self._on_state, queue_size=2, tcp_nodelay=True)
        rospy.Subscriber(names.DETECTORS, DetectorStatus, self._on_detector, queue_size=20)

    def _on_state(self, message: InteractionState) -> None:
        self._last_heard[MANAGER] = time.monotonic()
        self._put_state("state", entities.state_payload(message, self._language))
        self._put_state("stopped", entities.stop_payload(message))
        question = entities.question_payload(message, self._language)
        self._put_state("question", question)
        self._is_question_open = bool(question["answer"])
        self._put_health()

    def _on_borders(self, message: VirtualBorderArray) -> None:
        self._borders = {entity_key("border", border.id): border for border in message.borders}
        self._publish_timer.notify()
        self._maps.put(True)

    def _on_detector(self, message: DetectorStatus) -> None:
        self._last_heard["camera " + message.camera] = time.monotonic()

    def _on_grid(self, message: Any) -> None:
        self._grids[message._connection_header["topic"]] = message
        self._maps.put(True)

    def _publish_map(self) -> None:
        physical = self._grids.get(rospy.resolve_name(names.PHYSICAL_MAP))
        with_borders = self._grids.get(rospy.resolve_name(names.MAP_WITH_BORDERS))
        if physical is None or with_borders is None:
            return
        prior, posterior = map(messages.grid_from_message, (physical, with_borders))
        if prior.same_geometry(posterior):
            image = entities.map_png(prior, posterior, list((self._borders or {}).values()))
            self._broker.put(self._lab.topic("map"), image)

    # ------------------------------------------------------------------ to the broker
    def _put_state(self, key: str, value: Any) -> None:
        self._broker.put(self._lab.topic(key), _json(value))

    def _on_description(self, topic: str, payload: bytes, _retained: bool) -> None:
        with self._lock:
            change = self._description_topics.add if payload else self._description_topics.discard
            change(topic)
        self._publish_timer.notify()

    def _is_alive(self, sender: str) -> bool:
        return time.monotonic() - self._last_heard.get(sender, -1e9) < _SILENCE

    def _put_health(self) -> None:
        has_manager = self._is_alive(MANAGER)
        robots = self._robots.current()
        offered = effective_commands(robots[1], tuple(COMMANDS)) if robots is not None else COMMANDS
        health = {command: has_manager and command in offered for command in COMMANDS}
        health[MANAGER] = has_manager
        health[MONITOR] = robots is not None
        health[CONFIRM] = has_manager and self._is_question_open
        health[INTEGRATOR] = self._borders_subscriber.get_num_connections() > 0
        self._put_state("health", {key: ONLINE if is_online else OFFLINE for key, is_online in health.items()})

    def _publish_all(self) -> None:
        """Publishes all entities with their availability and problems, and the notices that are new."""
        robots = self._robots.current()
        borders = self._borders
        notices = self._notices.current()
        if robots is not None:
            robot_names = tuple(status.robot for status in robots[0].robots)
            self._lab = replace(self._lab, robots=robot_names)
        if borders is not None:
            border_names = {border.id: border.name for border in borders.values()}
            self._lab = replace(self._lab, borders=border_names)
        self._put_health()
        problems = {entity_key("camera", name): self._camera_problems(name, notices) for name in self._lab.cameras}
        for robot in self._lab.robots or ():
            lines = robots[1].robot_notices if robots is not None else ()
            problems[entity_key("robot", robot)] = entities.robot_problems(robot, lines, notices, self._language)
        for key, texts in problems.items():
            self._put_state(key, {"problem": bool(texts), "problems": sorted(set(texts))})
        for key, border in (borders or {}).items():
            self._put_state(key, entities.border_payload(border))
        self._describe()
        self._send_news(notices)
        self._watch_connection()

    def _camera_problems(self, camera: str, notices: List[Notice]) -> List[str]:
        warnings = [notice for notice in notices if notice.camera == camera and notice.severity]
        problems = [warning.sentence(self._language) for warning in warnings]
        if not self._is_alive("camera " + camera):
            problems.append(sentences.translate("mqtt_camera_silent", {"camera": camera}, self._language))
        return problems

    def _describe(self) -> None:
        for topic, config in entities.describe_entities(self._lab).items():
            self._broker.put(topic, _json(config))
        with self._lock:
            topics = list(self._description_topics)
        for topic in entities.find_stale_topics(self._lab, topics):
            self._broker.put(topic, b"")
            self._broker.put(self._lab.topic(entities.key_from_topic(topic)), b"")

    def _send_news(self, notices: List[Notice]) -> None:
        values = [entities.notice_payload(notice, self._language) for notice in notices]
        with self._lock:
            counts = dict(self._refusal_counts)
        self._put_state("notices", {"count": len(values), "notices": values[:20], "refused": counts})
        keys = ((notice.code, notice.robot, notice.border_id, notice.camera) for notice in notices)
        current = dict(zip(keys, values))
        for key, value in current.items():
            if self._previous_notices is not None and key not in self._previous_notices:
                self._broker.send(self._lab.topic(entities.NOTICE), _json(value))
        self._previous_notices = set(current)

    def _watch_connection(self) -> None:
        now = time.monotonic()
        if self._broker.connected and not self._broker.trouble:
            self._connected_at = now
        trouble = self._broker.trouble
        reason = {"reason": trouble} if trouble else {"reason_code": "mqtt_unreachable"}
        values = {"broker": self._broker.address, **reason}
        notice = Notice("mqtt_not_connected", Severity.WARNING, values=values)
        is_lost = now - self._connected_at > _GRACE
        self._notice_publisher.set([notice] if is_lost else [])

    # ------------------------------------------------------------------ requests from people
    def _on_message(self, _topic: str, payload: bytes, retained: bool) -> None:
        try:
            request = self._inbox.accept_request(payload, retained, time.time())
            if request is not None:
                self._carry_out(request)
        except CodedError as error:
            if retained:
                # deletes the message, which would otherwise arrive again at each connection
                self._broker.put(self._lab.topic(entities.COMMAND), b"")
            self._refuse(MqttRequest("", getattr(error, "sender_id", "")), error)

    def _carry_out(self, request: MqttRequest) -> None:
        is_accepted = self._command_sender.submit(
            request.command or SWITCH_BORDER,
            request,
            given_at=time.monotonic() - request.age,
            seen_stop=request.seen_stop,
            identity=request.id,
            carry_out=send if request.command else lambda _order: self._switch_border(request),
        )
        if not is_accepted:
            self._refuse(request, CodedError("mqtt_too_fast"))

    def _switch_border(self, request: MqttRequest) -> Any:
        border = (self._borders or {}).get(request.border)
        if border is None:
            raise CodedError("mqtt_no_border", border=request.border)
        order = SetBorderEnabledRequest(id=border.id, enabled=request.enabled, source=SOURCE)
        answer = services.call(names.SET_BORDER_ENABLED, SetBorderEnabled, order, services.INTEGRATOR)
        if answer.success:
            event = "page_event_enabled" if request.enabled else "page_event_disabled"
            answer.message = sentences.translate(event, {"border": border.name}, self._language)
        return answer

    def _on_answer(self, _order: Any, request: MqttRequest, answer: Any, error: Optional[CodedError]) -> None:
        if error is None:
            self._send_answer(request, answer.success, answer.code, messages.sentence_in(answer, self._language))
        else:
            self._refuse(request, error)

    def _refuse(self, request: MqttRequest, error: CodedError) -> None:
        with self._lock:
            self._refusal_counts[error.code] = self._refusal_counts.get(error.code, 0) + 1
        text = sentences.translate(error.code, error.values, self._language, error.message)
        self._send_answer(request, False, error.code, text)

    def _send_answer(self, request: MqttRequest, success: bool, code: str, text: str) -> None:
        request_name = request.command or request.border
        rospy.loginfo_throttle_identical(1.0, f"{rospy.get_name()}: {request_name or 'a message'}: {text} [{code}]")
        # the inbox has already limited the requests that have an id; the other answers are limited here
        if request.id or self._answer_limiter.allows("", time.time()):
            value = entities.answer_payload(request.sender_id, request_name, success, code, text)
            self._broker.send(self._lab.topic(entities.ANSWER), _json(value))


def _json(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True).encode("utf-8")


def _on_fault(error: Exception) -> None:
    if isinstance(error, rospy.ROSException) and rospy.is_shutdown():
        return
    rospy.logerr("mqtt: %s", "".join(traceback.format_exception(type(error), error, error.__traceback__)))
    node.shut_down_with_error(CodedError("internal_error"))


def build() -> MqttNode:
    """Reads the parameters and makes the node."""
    return MqttNode(parameters.read(MqttParams))
