"""The connections between the nodes of a `Graph`, with rospy's interfaces: topics, services and timers."""

from __future__ import annotations

import io
from collections import deque
from typing import TYPE_CHECKING, Any, Callable, Deque, Dict, List, Optional

import greenlet
import rospy
import rospy.msg
from rospy.impl.tcpros_service import convert_return_to_response

from vb_sim.in_process_ros.threading_stand_in import WaitQueue

if TYPE_CHECKING:
    from vb_sim.in_process_ros.rospy_stand_in import Graph


class Delivery:
    """A message in transit: serialised once, and deserialised once for each type that is asked for."""

    def __init__(self, message: Any, header: Dict[str, str]) -> None:
        buffer = io.BytesIO()
        message.serialize(buffer)
        self._data = buffer.getvalue()
        self._header = header
        self._messages: Dict[type, Any] = {}

    def message(self, kind: type) -> Any:
        """Returns the message, deserialised as this type."""
        message = self._messages.get(kind)
        if message is None:
            message = self._messages[kind] = kind()
            message.deserialize(self._data)
            message._connection_header = self._header
        return message


class Topic:
    """The publishers and subscribers of one topic."""

    def __init__(self) -> None:
        self.subscribers: List[Subscriber] = []
        self.publishers: List[Publisher] = []


class Publisher:
    """Replaces rospy.Publisher."""

    def __init__(self, graph: Graph, name: str, data_class: type, *_: Any, latch: bool = False, **__: Any) -> None:
        self._graph = graph
        self.node = graph.node
        self.resolved_name = self.name = graph.node.resolve(name)
        self.data_class = data_class
        self.type = data_class._type
        self._header = {"callerid": graph.node.name, "topic": self.resolved_name, "type": self.type}
        self._latch = latch
        self.latched: Optional[Delivery] = None
        self._sequence = 0
        self._topic = graph.topics[self.resolved_name]
        self._topic.publishers.append(self)
        self._delay = graph.delays_ns.get(self.resolved_name, 0)

    def publish(self, *args: Any, **kwargs: Any) -> None:
        """Serialises the message and sends it to all subscribers."""
        message = rospy.msg.args_kwds_to_message(self.data_class, args, kwargs)
        if message._has_header:
            self._sequence += 1
            message.header.seq = self._sequence
        if self.resolved_name == "/clock":
            self._graph.set_clock(message.clock)
            return
        if not self._topic.subscribers and not self._latch:
            return
        delivery = Delivery(message, self._header)
        if self._latch:
            self.latched = delivery
        for subscriber in self._topic.subscribers:
            self.send(subscriber, delivery)

    def send(self, subscriber: "Subscriber", delivery: Delivery) -> None:
        """Sends a message to one subscriber."""
        if self._delay:
            self._graph.scheduler.call_later(self._delay, lambda: subscriber.put(delivery))
        else:
            subscriber.put(delivery)

    def get_num_connections(self) -> int:
        """Returns the number of subscribers."""
        return len(self._topic.subscribers)


class Subscriber:
    """Replaces rospy.Subscriber: its own task calls the callback for one message after the other."""

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
        self.kind = data_class
        self._callback = callback
        self._extra = [] if callback_args is None else [callback_args]
        size = queue_size if queue_size is not None and queue_size > 0 else None
        self._queue: Deque[Delivery] = deque(maxlen=size)
        self._ended = False
        self._waiting = WaitQueue(graph.scheduler)
        self._topic = graph.topics[self.resolved_name]
        self._topic.subscribers.append(self)
        graph.scheduler.spawn(self._receive)
        for publisher in self._topic.publishers:
            if publisher.latched is not None:
                publisher.send(self, publisher.latched)

    def put(self, delivery: Delivery) -> None:
        """Queues a message. A full queue drops its oldest one, as in rospy."""
        if not self._ended:
            self._queue.append(delivery)
            self._waiting.wake()

    def _receive(self) -> None:
        while not self._ended:
            if not self._queue:
                self._waiting.wait()
                continue
            message = self._queue.popleft().message(self.kind)
            if self._callback is not None:
                self._callback(message, *self._extra)

    def unregister(self) -> None:
        """Ends the subscription."""
        self._ended = True
        if self in self._topic.subscribers:
            self._topic.subscribers.remove(self)
        self._waiting.wake()

    def get_num_connections(self) -> int:
        """Returns the number of publishers."""
        return len(self._topic.publishers)


class Service:
    """Replaces rospy.Service."""

    def __init__(self, graph: Graph, name: str, service_class: Any, handler: Callable[[Any], Any], **_: Any) -> None:
        self.node = graph.node
        self.kind = service_class
        self.handler = handler
        self.resolved_name = graph.node.resolve(name)
        graph.services[self.resolved_name] = self


class ServiceProxy:
    """Replaces rospy.ServiceProxy."""

    def __init__(self, graph: Graph, name: str, service_class: Any, **_: Any) -> None:
        self._graph = graph
        self.resolved_name = graph.node.resolve(name)
        self._kind = service_class

    def call(self, *args: Any, **kwargs: Any) -> Any:
        """Calls the service, and waits for the answer.

        Raises:
            rospy.ServiceException: if no node offers it, or the service raised it.
        """
        request = rospy.msg.args_kwds_to_message(self._kind._request_class, args, kwargs)
        service = self._graph.services.get(self.resolved_name)
        scheduler = self._graph.scheduler
        if service is None:
            raise rospy.ServiceException(f"service [{self.resolved_name}] unavailable")
        request_received = Delivery(request, {}).message(service.kind._request_class)
        caller = greenlet.getcurrent()
        answers = []

        def serve() -> None:
            try:
                reply = service.handler(request_received)
                answers.append(convert_return_to_response(reply, service.kind._response_class))
            except rospy.ServiceException as error:
                answers.append(error)
            delay = self._graph.delays_ns.get(self.resolved_name, 0)
            if delay:
                scheduler.wait(delay)
            scheduler.wake(caller)

        scheduler.spawn(serve, service.node)
        scheduler.wait()
        if isinstance(answers[0], rospy.ServiceException):
            raise answers[0]
        return Delivery(answers[0], {}).message(self._kind._response_class)

    __call__ = call


class Timer(rospy.Timer):
    """Replaces rospy.Timer: its thread is a task."""

    def __init__(self, graph: Graph, *args: Any, **kwargs: Any) -> None:
        self.start = lambda: graph.scheduler.spawn(self.run)
        super().__init__(*args, **kwargs)
