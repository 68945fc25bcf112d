"""Replaces rospy for nodes that run within one process: names, topics, services, parameters, time."""

from __future__ import annotations

import contextlib
import logging
from collections import defaultdict
from functools import partial
from typing import Any, Callable, Dict, Iterator, List, Mapping, Tuple

import genpy
import greenlet
import rosgraph.masterapi
import rosgraph.names
import rosmaster.paramserver
import rospy

from vb_sim.in_process_ros.connections import Publisher, Service, ServiceProxy, Subscriber, Timer, Topic
from vb_sim.in_process_ros.threading_stand_in import Scheduler, StandIns, replace_temporarily

_CONNECTIONS = (Publisher, Subscriber, Service, ServiceProxy, Timer)
LOG = logging.getLogger("vb_sim.nodes")
_LEVELS = {word: getattr(logging, word.upper()) for word in ("debug", "info", "warn", "error", "fatal")}
_LEVELS["err"] = logging.ERROR


class Node:
    """One node of the graph.

    Args:
        name: the node's name with its namespace, for instance "/robot1/move_base".
        remappings: the launch file's remappings of names.
    """

    def __init__(self, name: str, remappings: Mapping[str, str]) -> None:
        self.name = name
        self.remappings = {
            rosgraph.names.resolve_name(key, name): rosgraph.names.resolve_name(value, name)
            for key, value in remappings.items()
        }

    def resolve(self, name: str) -> str:
        """Resolves a name in the node's namespace, and remaps it."""
        full = rosgraph.names.resolve_name(name, self.name)
        return self.remappings.get(full, full)


class Graph:
    """All nodes of one run. `installed` makes rospy use them. Transport options, such as tcp_nodelay, have no effect.

    Args:
        scheduler: runs the nodes' tasks.
        delays: [s] that a topic's messages or a service's answers take, by resolved name.

    Attributes:
        parameters: the ROS master's own parameter server; takes resolved names.
        topics, services: by resolved name.
        delays_ns: [ns] the same as `delays`.
    """

    def __init__(self, scheduler: Scheduler, delays: Mapping[str, float]) -> None:
        self.scheduler = scheduler
        self.parameters = rosmaster.paramserver.ParamDictionary(None)
        self.services: Dict[str, Service] = {}
        self.topics: Dict[str, Topic] = defaultdict(Topic)
        self.delays_ns = {name: int(seconds * 1e9) for name, seconds in delays.items()}
        self._stand_ins = StandIns(scheduler)
        self._sleepers: List[Tuple[Any, Any]] = []

    # ------------------------------------------------------------- for a run
    def start(self, node: Node, main: Callable[[], Any]) -> None:
        """Starts a node. `main` does what its executable would do."""
        self.scheduler.spawn(main, node)

    @contextlib.contextmanager
    def installed(self) -> Iterator[None]:
        """Replaces rospy, and in all nodes' modules threading and time, with this graph's stand-ins."""
        previous_clock = rospy.rostime._rostime_initialized, rospy.rostime._rostime_current
        with replace_temporarily(self._replacements()):
            rospy.rostime.set_rostime_initialized(True)
            rospy.rostime._set_rostime(rospy.Time(0))
            self._stand_ins.replace()
            try:
                yield
            finally:
                self.scheduler.close()
                self._stand_ins.restore()
                rospy.rostime._rostime_initialized, rospy.rostime._rostime_current = previous_clock

    def set_clock(self, now: genpy.Time) -> None:
        """Sets the clock to a message of /clock, for all nodes."""
        rospy.rostime._set_rostime(now)
        due = [entry for entry in self._sleepers if entry[0] <= now]
        if due:
            self._sleepers = [entry for entry in self._sleepers if entry[0] > now]
            for _, task in due:
                self.scheduler.wake(task)

    @property
    def node(self) -> Node:
        """The node whose task is running."""
        return getattr(greenlet.getcurrent(), "owner", None) or _NOBODY

    def sleep(self, duration: Any) -> None:
        """Sleeps as rospy.sleep does, by /clock."""
        seconds = duration if isinstance(duration, genpy.Duration) else genpy.Duration.from_sec(duration)
        if seconds > genpy.Duration(0):
            self._sleepers.append((rospy.get_rostime() + seconds, greenlet.getcurrent()))
            self.scheduler.wait()

    def _replacements(self) -> Dict[Any, Dict[str, Any]]:
        """Returns what replaces the names of modules and classes."""
        functions = _Rospy(self, self._stand_ins)
        names = {name: getattr(functions, name) for name in dir(functions) if not name.startswith("_")}
        names.update({kind.__name__: partial(kind, self) for kind in _CONNECTIONS})
        for word, level in _LEVELS.items():
            names[f"log{word}"] = names[f"log{word}_once"] = partial(functions.log, level)
            names[f"log{word}_throttle"] = lambda _period, *args, level=level: functions.log(level, *args)
        return {
            rospy: {name: value for name, value in names.items() if hasattr(rospy, name)},
            rospy.rostime: {"wallsleep": lambda seconds: self.scheduler.wait(int(max(seconds, 0.0) * 1e9))},
            rospy.timer: {"sleep": self.sleep},
            rospy.core: {"is_shutdown": lambda: self.scheduler.closed},
            # if there is a real master, it knows another graph
            rosgraph.masterapi.Master: {
                "getSystemState": lambda _master: self._system_state(),
                "getTopicTypes": lambda _master: self._topic_types(),
                # vb_core's has_exited takes "" for an address; tf2_ros looks up a debugging service
                "lookupNode": lambda _master, _name: "",
                "lookupService": lambda _master, _name: "",
            },
        }

    def _system_state(self) -> List[List[Tuple[str, List[str]]]]:
        publishers = {name: topic.publishers for name, topic in self.topics.items()}
        subscribers = {name: topic.subscribers for name, topic in self.topics.items()}
        services = {name: [service] for name, service in self.services.items()}
        return [
            [(name, [user.node.name for user in users]) for name, users in by_name.items() if users]
            for by_name in (publishers, subscribers, services)
        ]

    def _topic_types(self) -> List[Tuple[str, str]]:
        published = {name: topic for name, topic in self.topics.items() if topic.publishers}
        return [(name, topic.publishers[0].type) for name, topic in published.items()]


_NOBODY = Node("/study", {})


class _Rospy:
    """rospy's functions for the node whose task is running: each method replaces the function of the same name."""

    def __init__(self, graph: Graph, stand_ins: StandIns) -> None:
        self._graph, self._scheduler, self._stand_ins = graph, graph.scheduler, stand_ins
        self.sleep = graph.sleep

    def init_node(self, *_: Any, **__: Any) -> None:
        # in modules that the node has imported since
        self._stand_ins.replace()

    # ------------------------------------------------------------- names
    def get_name(self) -> str:
        return self._graph.node.name

    get_caller_id = get_name

    def resolve_name(self, name: str, caller_id: Any = None) -> str:
        return self._graph.node.resolve(name)

    # ------------------------------------------------------------- parameters
    def get_param(self, name: str, *default: Any) -> Any:
        try:
            return self._graph.parameters.get_param(self.resolve_name(name))
        except KeyError:
            if not default:
                raise KeyError(name) from None
            return default[0]

    def set_param(self, name: str, value: Any) -> None:
        self._graph.parameters.set_param(self.resolve_name(name), value)

    def has_param(self, name: str) -> bool:
        return self._graph.parameters.has_param(self.resolve_name(name))

    def delete_param(self, name: str) -> None:
        self._graph.parameters.delete_param(self.resolve_name(name))

    def search_param(self, name: str) -> Any:
        return self._graph.parameters.search_param(self.get_name(), name)

    # ------------------------------------------------------------- waiting and shutdown
    def spin(self) -> None:
        self._scheduler.wait()

    def wait_for_service(self, name: str, timeout: Any = None) -> None:
        full = self.resolve_name(name)
        waited = 0.0
        limit = timeout.to_sec() if isinstance(timeout, genpy.Duration) else timeout
        while full not in self._graph.services:
            if limit is not None and waited >= limit:
                raise rospy.ROSException(f"timeout exceeded while waiting for service {full}")
            self._scheduler.wait(20_000_000)
            waited += 0.02

    def is_shutdown(self) -> bool:
        return self._scheduler.closed

    def signal_shutdown(self, reason: str) -> None:
        if not self._scheduler.closed:
            self._scheduler.fault(RuntimeError(f"{self.get_name()} ended: {reason}"))

    def on_shutdown(self, _closer: Any) -> None:
        """Does nothing: a run that is over leaves nothing to close."""

    def log(self, level: int, text: Any, *values: Any, **_: Any) -> None:
        if not self._scheduler.closed:
            LOG.log(level, text, *values)
