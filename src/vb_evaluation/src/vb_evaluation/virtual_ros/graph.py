"""Replaces rospy for nodes that run within one process: names, topics, services, parameters, time."""

from __future__ import annotations

import contextlib
import io
import logging
from collections import deque
from typing import Any, Callable, Deque, Dict, Iterator, List, Mapping, Optional, Tuple

import genpy
import greenlet
import rosgraph.masterapi
import rosgraph.names
import rosmaster.paramserver
import rospy
import rospy.impl.tcpros_service
import rospy.msg

from vb_evaluation.virtual_ros.scheduler import Scheduler
from vb_evaluation.virtual_ros.stand_ins import StandIns, WaitQueue, master_stand_ins, replaced

LOG = logging.getLogger("vb_evaluation.nodes")
_LEVELS = {
    "debug": logging.DEBUG,
    "info": logging.INFO,
    "warn": logging.WARNING,
    "err": logging.ERROR,
    "error": logging.ERROR,
    "fatal": logging.CRITICAL,
}


class Node:
    """One node of the graph.

    Args:
        name: with its namespace, "/robot1/move_base".
        remappings: of names, as the launch file has them.
    """

    def __init__(self, name: str, remappings: Mapping[str, str]) -> None:
        self.name = name
        self.remappings = {
            rosgraph.names.resolve_name(key, name): rosgraph.names.resolve_name(value, name)
            for key, value in remappings.items()
        }

    def resolve(self, name: str) -> str:
        """Resolves a name as the node means it."""
        full = rosgraph.names.resolve_name(name, self.name)
        return self.remappings.get(full, full)


class _Delivery:
    """A message on its way: packed once, and unpacked once for each type that is wanted."""

    def __init__(self, data: bytes, header: Dict[str, str]) -> None:
        self._data, self._header = data, header
        self._messages: Dict[type, Any] = {}

    def message(self, kind: type) -> Any:
        found = self._messages.get(kind)
        if found is None:
            found = self._messages[kind] = kind()
            found.deserialize(self._data)
            found._connection_header = self._header
        return found


class _Topic:
    def __init__(self) -> None:
        self.subscribers: List[Subscriber] = []
        self.publishers: List[Publisher] = []


class Graph:
    """All nodes of one run; `installed` makes rospy answer for it. What nodes say about connections has no meaning here.

    Args:
        scheduler: of its tasks.
        delays: resolved topic or service to seconds that its messages or answers take.

    Attributes:
        parameters: the ROS master's own server of parameters; takes resolved names.
    """

    def __init__(self, scheduler: Scheduler, delays: Mapping[str, float]) -> None:
        self.scheduler = scheduler
        self.parameters = rosmaster.paramserver.ParamDictionary(None)
        self.services: Dict[str, Service] = {}
        self.closers: List[Callable[[], None]] = []
        self._delays = {name: int(seconds * 1e9) for name, seconds in delays.items()}
        self._topics: Dict[str, _Topic] = {}
        self._stand_ins = StandIns(scheduler)
        self._sleepers: List[Tuple[Any, Any]] = []

    # ------------------------------------------------------------- for a run
    def start(self, node: Node, main: Callable[[], Any]) -> None:
        """Begins a node: what its executable would do."""
        self.scheduler.spawn(main, node)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Replaces rospy, and threading and time in all nodes' modules, by this graph's."""
        before = rospy.rostime._rostime_initialized, rospy.rostime._rostime_current
        with replaced(self._replacements()):
            rospy.rostime.set_rostime_initialized(True)
            rospy.rostime._set_rostime(rospy.Time(0))
            self._stand_ins.replace()
            try:
                yield
            finally:
                self.scheduler.close()
                self._stand_ins.restore()
                rospy.rostime._rostime_initialized, rospy.rostime._rostime_current = before

    def delay_of(self, name: str) -> int:
        """Returns the time [ns] that a topic's messages or a service's answers take."""
        return self._delays.get(name, 0)

    def topic(self, name: str) -> _Topic:
        """Returns a topic by its resolved name."""
        return self._topics.setdefault(name, _Topic())

    def set_clock(self, now: genpy.Time) -> None:
        """Sets the clock to a message of /clock, for all nodes."""
        rospy.rostime._set_rostime(now)
        due = [entry for entry in self._sleepers if entry[0] <= now]
        if due:
            self._sleepers = [entry for entry in self._sleepers if entry[0] > now]
            for _, task in due:
                self.scheduler.wake(task)

    # ------------------------------------------------------------- names and parameters
    @property
    def node(self) -> Node:
        """Returns the node whose task is running."""
        return getattr(greenlet.getcurrent(), "owner", None) or _NOBODY

    def _get_param(self, name: str, *default: Any) -> Any:
        try:
            return self.parameters.get_param(self.node.resolve(name))
        except KeyError:
            if not default:
                raise KeyError(name) from None
            return default[0]

    # ------------------------------------------------------------- time
    def sleep(self, duration: Any) -> None:
        """Sleeps as rospy.sleep does, by /clock."""
        seconds = duration if isinstance(duration, genpy.Duration) else genpy.Duration.from_sec(duration)
        if seconds > genpy.Duration(0):
            self._sleepers.append((rospy.get_rostime() + seconds, greenlet.getcurrent()))
            self.scheduler.wait()

    def spin(self) -> None:
        """Waits as rospy.spin does."""
        self.scheduler.wait()

    def _wait_for_service(self, name: str, timeout: Any = None) -> None:
        full, waited = self.node.resolve(name), 0.0
        limit = timeout.to_sec() if isinstance(timeout, genpy.Duration) else timeout
        while full not in self.services:
            if limit is not None and waited >= limit:
                raise rospy.ROSException(f"timeout exceeded while waiting for service {full}")
            self.scheduler.wait(20_000_000)
            waited += 0.02

    def _shut_down(self, reason: str) -> None:
        if not self.scheduler.closed:
            self.scheduler.fault(RuntimeError(f"{self.node.name} ended: {reason}"))

    def _logger(self, level: int) -> Callable[..., None]:
        def log(text: Any, *values: Any, **_: Any) -> None:
            if not self.scheduler.closed:
                LOG.log(level, text, *values)

        return log

    def _replacements(self) -> Dict[Any, Dict[str, Any]]:
        def bound(kind: type) -> Callable[..., Any]:
            return lambda *given, **named: kind(self, *given, **named)

        names: Dict[str, Any] = {
            "init_node": lambda *_, **__: self._stand_ins.replace(),
            "get_name": lambda: self.node.name,
            "get_caller_id": lambda: self.node.name,
            "get_namespace": lambda: rosgraph.names.namespace(self.node.name),
            "resolve_name": lambda name, caller_id=None: self.node.resolve(name),
            "remap_name": lambda name: name,
            "Publisher": bound(Publisher),
            "Subscriber": bound(Subscriber),
            "Service": bound(Service),
            "ServiceProxy": bound(ServiceProxy),
            "Timer": bound(Timer),
            "wait_for_service": self._wait_for_service,
            "sleep": self.sleep,
            "spin": self.spin,
            "is_shutdown": lambda: self.scheduler.closed,
            "signal_shutdown": self._shut_down,
            "on_shutdown": self.closers.append,
            "get_param": self._get_param,
            "set_param": lambda name, value: self.parameters.set_param(self.node.resolve(name), value),
            "has_param": lambda name: self.parameters.has_param(self.node.resolve(name)),
            "delete_param": lambda name: self.parameters.delete_param(self.node.resolve(name)),
            "search_param": lambda name: self.parameters.search_param(self.node.name, name),
        }
        for word, level in _LEVELS.items():
            names[f"log{word}"] = names[f"log{word}_once"] = self._logger(level)
            names[f"log{word}_throttle"] = lambda _period, *given, level=level: self._logger(level)(*given)
        names = {name: value for name, value in names.items() if hasattr(rospy, name)}

        return {
            rospy: names,
            rospy.rostime: {"wallsleep": lambda seconds: self.scheduler.wait(int(max(seconds, 0.0) * 1e9))},
            rospy.timer: {"sleep": self.sleep},
            rospy.core: {"is_shutdown": lambda: self.scheduler.closed},
            rosgraph.masterapi.Master: master_stand_ins(self._topics, self.services),
        }


_NOBODY = Node("/study", {})


class Publisher:
    """rospy.Publisher."""

    def __init__(self, graph: Graph, name: str, data_class: type, *_: Any, latch: bool = False, **__: Any) -> None:
        self._graph, self.node = graph, graph.node
        self.resolved_name = self.name = graph.node.resolve(name)
        self.data_class, self.type = data_class, data_class._type
        self._header = {"callerid": graph.node.name, "topic": self.resolved_name, "type": self.type}
        self._latch = latch
        self.latched: Optional[_Delivery] = None
        self._sequence = 0
        self._topic = graph.topic(self.resolved_name)
        self._topic.publishers.append(self)
        self._delay = graph.delay_of(self.resolved_name)

    def publish(self, *given: Any, **named: Any) -> None:
        """Packs the message and sends it to everybody."""
        message = rospy.msg.args_kwds_to_message(self.data_class, given, named)
        if message._has_header:
            self._sequence += 1
            message.header.seq = self._sequence
        if self.resolved_name == "/clock":
            self._graph.set_clock(message.clock)
            return
        if not self._topic.subscribers and not self._latch:
            return
        buffer = io.BytesIO()
        message.serialize(buffer)
        delivery = _Delivery(buffer.getvalue(), self._header)
        if self._latch:
            self.latched = delivery
        for subscriber in self._topic.subscribers:
            self.send(subscriber, delivery)

    def send(self, subscriber: "Subscriber", delivery: _Delivery) -> None:
        """Sends a message to one subscriber."""
        if self._delay:
            self._graph.scheduler.later(self._delay, lambda: subscriber.put(delivery))
        else:
            subscriber.put(delivery)

    def get_num_connections(self) -> int:
        """Returns how many listen."""
        return len(self._topic.subscribers)

    def unregister(self) -> None:
        """Ends it."""
        if self in self._topic.publishers:
            self._topic.publishers.remove(self)


class Subscriber:
    """rospy.Subscriber: its own task calls the callback for one message after the other."""

    def __init__(
        self,
        graph: Graph,
        name: str,
        data_class: type,
        callback: Optional[Callable] = None,
        callback_args: Any = None,
        queue_size: Optional[int] = None,
        **_: Any,
    ) -> None:
        self.node = graph.node
        self.resolved_name = self.name = self.node.resolve(name)
        self.kind, self._callback, self._extra = data_class, callback, callback_args
        size = queue_size if queue_size is not None and queue_size > 0 else None
        self._queue: Deque[_Delivery] = deque(maxlen=size)
        self._over = False
        self._line = WaitQueue(graph.scheduler)
        self._topic = graph.topic(self.resolved_name)
        self._topic.subscribers.append(self)
        graph.scheduler.spawn(self._work)
        for publisher in self._topic.publishers:
            if publisher.latched is not None:
                publisher.send(self, publisher.latched)

    def put(self, delivery: _Delivery) -> None:
        """Queues a message; if there are too many, the oldest ones are lost, as in rospy."""
        if not self._over:
            self._queue.append(delivery)
            self._line.wake()

    def _work(self) -> None:
        while not self._over:
            if not self._queue:
                self._line.wait()
                continue
            message = self._queue.popleft().message(self.kind)
            if self._callback is not None:
                self._callback(message, *([] if self._extra is None else [self._extra]))

    def unregister(self) -> None:
        """Ends it."""
        self._over = True
        if self in self._topic.subscribers:
            self._topic.subscribers.remove(self)
        self._line.wake()

    def get_num_connections(self) -> int:
        """Returns how many publish."""
        return len(self._topic.publishers)


class Service:
    """rospy.Service."""

    def __init__(self, graph: Graph, name: str, service_class: Any, handler: Callable[[Any], Any], **_: Any) -> None:
        self._graph, self.node = graph, graph.node
        self.resolved_name = graph.node.resolve(name)
        self.kind, self.handler = service_class, handler
        graph.services[self.resolved_name] = self

    def shutdown(self, reason: str = "") -> None:
        """Ends it."""
        self._graph.services.pop(self.resolved_name, None)


class ServiceProxy:
    """rospy.ServiceProxy."""

    def __init__(self, graph: Graph, name: str, service_class: Any, **_: Any) -> None:
        self._graph = graph
        self.resolved_name, self._kind = graph.node.resolve(name), service_class

    def __call__(self, *given: Any, **named: Any) -> Any:
        """As `call`."""
        return self.call(*given, **named)

    def call(self, *given: Any, **named: Any) -> Any:
        """Calls the service, and waits for the answer.

        Raises:
            rospy.ServiceException: if no node offers it, or the service raised it.
        """
        request = rospy.msg.args_kwds_to_message(self._kind._request_class, given, named)
        service, scheduler = self._graph.services.get(self.resolved_name), self._graph.scheduler
        if service is None:
            raise rospy.ServiceException(f"service [{self.resolved_name}] unavailable")
        asked = _repacked(request, service.kind._request_class)
        caller, answers = greenlet.getcurrent(), []

        def serve() -> None:
            try:
                answers.append(
                    rospy.impl.tcpros_service.convert_return_to_response(
                        service.handler(asked), service.kind._response_class
                    )
                )
            except rospy.ServiceException as error:
                answers.append(error)
            delay = self._graph.delay_of(self.resolved_name)
            if delay:
                scheduler.wait(delay)
            scheduler.wake(caller)

        scheduler.spawn(serve, service.node)
        scheduler.wait()
        if isinstance(answers[0], rospy.ServiceException):
            raise answers[0]
        return _repacked(answers[0], self._kind._response_class)

    def close(self) -> None:
        """Ends it."""


def _repacked(message: Any, kind: type) -> Any:
    buffer = io.BytesIO()
    message.serialize(buffer)
    result = kind()
    result.deserialize(buffer.getvalue())
    return result


class Timer:
    """rospy.Timer."""

    def __init__(
        self, graph: Graph, period: Any, callback: Callable[[Any], Any], oneshot: bool = False, **_: Any
    ) -> None:
        self._graph, self._period, self._callback, self._once = graph, period, callback, oneshot
        self._over = False
        graph.scheduler.spawn(self._run)

    def _run(self) -> None:
        expected = rospy.get_rostime() + self._period
        while not self._over:
            self._graph.sleep(expected - rospy.get_rostime())
            if self._over:
                return
            now = rospy.get_rostime()
            self._callback(rospy.timer.TimerEvent(expected, expected, now, now, None))
            if self._once:
                return
            # as rospy: from the last time that it was due, unless it cannot keep up
            expected = max(expected + self._period, rospy.get_rostime() - self._period)

    def shutdown(self) -> None:
        """Ends it."""
        self._over = True
