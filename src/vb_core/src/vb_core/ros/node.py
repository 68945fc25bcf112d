"""Start-up, shutdown and threads of a node."""

from __future__ import annotations

import collections
import contextlib
import ctypes
import gc
import inspect
import socket
import sys
import threading
import time
from pathlib import Path
from typing import Any, Callable, Deque, Generic, Iterable, List, Optional, TypeVar

import rosgraph
import rosgraph.network
import rospy
from rospy.impl.paramserver import get_param_server_cache

from vb_core import files
from vb_core.errors import CodedError

T = TypeVar("T")

_failures: List[CodedError] = []


def run_node(name: str, build: Callable[[], Any]) -> None:
    """Runs a node until it is shut down; with --help prints its interface instead, without a ROS master.

    Args:
        name: the node's default name.
        build: makes the node's object, whose class's docstring is the interface. A `CodedError` from it, for instance a
            bad parameter, is logged as one line, and the process exits with status 1, as after `shut_down_with_error`.
    """
    if {"-h", "--help"} & set(sys.argv[1:]):
        print(_interface(name, build))
        return
    _share_heap()
    rospy.init_node(name)
    _log_without_registering()
    try:
        node = build()
    except CodedError as error:
        rospy.logfatal("%s: %s", rospy.get_name(), error)
        sys.exit(1)
    except rospy.ROSInterruptException:
        return
    _freeze_startup_objects()
    if hasattr(node, "close"):
        rospy.on_shutdown(node.close)
    if rospy.get_param("/use_sim_time", False):
        log_missing_input("the time on /clock, because /use_sim_time is set", _clock_runs)
    rospy.spin()
    if _failures:
        sys.exit(1)


def _log_without_registering() -> None:
    """Keeps rospy from asking the ROS master for a parameter at each logged line.

    As long as the parameter is not set, rospy subscribes to it under the node's name. If a node that has been replaced
    by another of the same name logs one more line while it ends, the master takes it for the newer of the two and stops
    the other one. This happened about once in seventy replacements.
    """
    name = "/rosout_disable_topics_generation"
    get_param_server_cache().set(name, bool(rospy.get_param(name, False)))


def _freeze_startup_objects() -> None:
    """Excludes the objects made so far, which live as long as the node, from Python's garbage collection.

    The collector would halt all threads while it goes through them. For 30 to 60 ms, or several times as long on a busy
    computer, no stop would be answered and no image searched.
    """
    gc.collect()
    gc.freeze()


def _interface(name: str, build: Callable[[], Any]) -> str:
    """Describes a node without starting it: its class's docstring, and where its parameters are."""
    # with postponed evaluation an annotation is the class's name
    returned = build.__annotations__.get("return", "")
    class_ = build.__globals__.get(returned) if isinstance(returned, str) else returned
    text = inspect.getdoc(class_) or inspect.getdoc(sys.modules[build.__module__]) or ""
    values = Path(build.__code__.co_filename).resolve().parents[2] / "config" / f"{name}.yaml"
    parameters = f"\n\nParameters and their defaults: {values}" if values.is_file() else ""
    return f"{name}\n\n{text}{parameters}"


def wait_for_publishers(subscribers: Iterable[rospy.Subscriber], timeout: float) -> None:
    """Waits until subscribers are connected to as many publishers as the master knows, `timeout` seconds at most.

    To be called before a measurement of some seconds: on a busy computer it takes a while to connect.
    """
    published = dict(rosgraph.Master(rospy.get_name()).getSystemState()[0])
    expected = [(subscriber, len(published.get(subscriber.resolved_name, ()))) for subscriber in subscribers]
    wait_until(lambda: all(subscriber.get_num_connections() >= count for subscriber, count in expected), timeout)


def wait_until(condition: Callable[[], bool], timeout: float, period: float = 0.05) -> bool:
    """Waits until a condition holds. Returns False after `timeout` of wall time or at shutdown."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline and not rospy.is_shutdown():
        if condition():
            return True
        time.sleep(period)
    return condition()


def has_exited(master: rosgraph.Master, name: str) -> bool:
    """Returns whether a registered node no longer answers at its address: the master lists killed nodes too.

    A node that hangs has not exited: it may continue at any time.
    """
    try:
        host, port = rosgraph.network.parse_http_host_and_port(master.lookupNode(name))
        socket.create_connection((host, port), timeout=1.0).close()
    except (ConnectionRefusedError, rosgraph.MasterException):
        return True
    except (OSError, ValueError):
        return False
    return False


def keep_private(*paths: Path) -> None:
    """Makes files readable by their owner only, as `files.restrict_to_owner` does, and logs which ones others could read.

    Raises:
        CodedError: "file_not_private".
    """
    for path in filter(files.restrict_to_owner, paths):
        rospy.logwarn("%s: others could read %s; from now on only its owner can", rospy.get_name(), path)


def shut_down_with_error(error: CodedError) -> None:
    """Ends a running node that cannot do its work: logs a line, and `run_node` exits with status 1."""
    rospy.logfatal("%s: %s", rospy.get_name(), error)
    _failures.append(error)
    rospy.signal_shutdown(error.code)


_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8  # malloc.h


def _tune_malloc(option: int, value: int) -> None:
    """Sets an option of glibc's malloc. With another C library nothing changes."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(option, value)


def _share_heap() -> None:
    """Makes all threads of this process use one heap.

    rospy receives each connection in a separate thread. By default glibc gives up to eight threads per core a heap
    each, which keeps the memory of the largest messages it ever held. A detector grew by 18 MiB each time its camera's
    driver was restarted. The threads hardly ever allocate at the same time, as Python runs only one of them at a time.
    """
    _tune_malloc(_M_ARENA_MAX, 1)


def disable_heap_trimming() -> None:
    """Makes this process keep the memory of an image for the next one; for nodes that handle many images.

    By default glibc returns blocks of that size to the system, which then clears the next image's pages one by one.
    This takes three quarters of the time needed to receive 1080p images.
    """
    # the largest glibc accepts; rospy receives into buffers of half that size
    _tune_malloc(_M_MMAP_THRESHOLD, 32 << 20)
    _tune_malloc(_M_TRIM_THRESHOLD, 128 << 20)


class Queue(Generic[T]):
    """A bounded queue for a worker: no item is skipped, order is kept."""

    def __init__(self, size: int = 1000) -> None:
        self._condition = threading.Condition()
        self._items: Deque[T] = collections.deque()
        self._size = size
        self._closed = False

    def put(self, item: T) -> bool:
        """Adds an item. Returns False if too many wait already, which the caller must report."""
        with self._condition:
            if len(self._items) >= self._size:
                return False
            self._items.append(item)
            self._condition.notify_all()
            return True

    def get(self) -> Optional[T]:
        """Waits for the oldest item, removes it and returns it. Returns None once the queue is closed and empty."""
        with self._condition:
            self._condition.wait_for(lambda: self._items or self._closed)
            item = self._items.popleft() if self._items else None
            self._condition.notify_all()
            return item

    def close(self) -> None:
        """Closes the queue. `get` still returns the waiting items, and then None."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()


class Mailbox(Queue[T]):
    """A queue of the newest items, usually only one. If it is full, a new item replaces the oldest, which is counted.

    A subscriber's callback puts items, and a worker thread gets them, so slow work never makes a queue grow.

    Args:
        on_added: called when an item was added and none dropped for it; for a worker that serves several mailboxes.
        size: number of items that may wait.
    """

    def __init__(self, on_added: Callable[[], Any] = lambda: None, size: int = 1) -> None:
        super().__init__(size)
        self._on_added = on_added
        self.received = 0
        self.dropped = 0

    def put(self, item: T) -> bool:
        """Stores an item, in place of the oldest one if the mailbox is full."""
        with self._condition:
            self.received += 1
            is_full = len(self._items) == self._size
            if is_full:
                self.dropped += 1
                self._items.popleft()
            super().put(item)
        if not is_full:
            self._on_added()
        return True

    def wait_until_taken(self) -> None:
        """Waits until the worker has got all items, or the mailbox is closed. Only for a source that can wait."""
        with self._condition:
            self._condition.wait_for(lambda: not self._items or self._closed)

    def close(self) -> None:
        """Drops all items and wakes up the waiting thread. `get` then returns None."""
        with self._condition:
            self._items.clear()
            super().close()


MIN_POLL_PERIOD = 0.002  # [s] of wall time between two readings of simulated time
MAX_PACE = 20.0  # simulated seconds per second of wall time


class WakeTimer:
    """Wakes a worker when it is notified, or after a period of wall or simulated time, whichever ends first.

    Unlike a rospy.Timer, it also wakes the worker while simulated time stands still. Where simulated time runs faster
    than wall time, other nodes expect the work as often in simulated time.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._due = 0.0  # [s] of simulated time
        self._pace = 1.0  # simulated seconds per second of wall time, as measured in the last wait
        self._wake = threading.Event()
        self._closed = False

    def notify(self) -> None:
        """Makes the worker stop waiting."""
        self._wake.set()

    def get(self) -> Optional[bool]:
        """Waits. Returns whether it was notified, or None once closed."""
        if rospy.rostime.is_wallclock():
            woken = not self._closed and self._wake.wait(self._period)
        else:
            woken = self._get_simulated()
        if woken:  # a notification that arrives just after a timeout is left for the next wait
            self._wake.clear()
        return None if self._closed else woken

    def _get_simulated(self) -> bool:
        """Waits in simulated time, as `get` does in wall time. Returns whether the worker was notified."""
        began, began_simulated = time.monotonic(), rospy.get_time()
        if not 0.0 <= self._due - began_simulated <= self._period:
            # no wait preceded this one, the last one ended too late, or time has jumped
            self._due = began_simulated + self._period
        wall, now = began, began_simulated
        woken = False
        while not (self._closed or woken) and wall < began + self._period and now < self._due:
            remaining_time = max((self._due - now) / self._pace, MIN_POLL_PERIOD)
            woken = self._wake.wait(min(began + self._period - wall, remaining_time))
            wall, now = time.monotonic(), rospy.get_time()
        self._due += self._period
        if wall > began:
            self._pace = min(max((now - began_simulated) / (wall - began), 1.0), MAX_PACE)
        return woken

    def close(self) -> None:
        """Wakes up the worker. `get` then returns None."""
        self._closed = True
        self._wake.set()


def start_thread(work: Callable[..., None], *arguments: Any) -> threading.Thread:
    """Runs work in a separate thread. An exception ends the node, with a traceback; roslaunch then restarts it.

    Otherwise the node would run on without doing its work.
    """

    def run() -> None:
        try:
            work(*arguments)
        except BaseException:
            shut_down_with_error(CodedError("internal_error"))
            raise

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


class Worker:
    """A thread that handles the items of a Mailbox, Queue or WakeTimer one after the other, and survives a faulty item.

    A `CodedError` means a faulty item, and is logged. Exceptions of topics that close during shutdown are ignored. Any
    other exception is a fault of the node, which ends.
    """

    def __init__(self, source: Any, handle: Callable[[Any], None]) -> None:
        self._source = source
        self._handle = handle
        self._thread = start_thread(self._work)

    def join(self, timeout: float) -> None:
        """Waits until a closed source's last item is handled, at most for a time [s]."""
        self._thread.join(timeout)

    def _work(self) -> None:
        for item in iter(self._source.get, None):
            try:
                self._handle(item)
            except CodedError as error:
                rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: {error}")
            except rospy.ROSException:
                if not rospy.is_shutdown():
                    raise


LOG_DELAY = 5.0  # [s] of wall time before the first log line about waiting, and before the second
INPUT_TIMEOUT = 60.0  # [s] of wall time


def log_missing_input(input_name: str, arrived: Callable[[], bool], timeout: Optional[float] = None) -> None:
    """Watches, in a thread, whether an input arrives: logs what the node waits for, and gives up after a timeout.

    Args:
        input_name: the input's name in the log, for instance "the map on /map".
        arrived: returns whether it is there.
        timeout: [s] wall time after which the node ends with "input_timeout", so that roslaunch restarts it;
            None: never, because the node is useful without it or a restart would not help.
    """
    threading.Thread(target=_await, args=(input_name, arrived, timeout), daemon=True).start()


def _await(input_name: str, arrived: Callable[[], bool], timeout: Optional[float]) -> None:
    """Waits for an input, as `log_missing_input` explains, in the calling thread."""
    began = logged_at = time.monotonic()
    while not (arrived() or rospy.is_shutdown()):
        now = time.monotonic()
        if timeout is not None and now - began > timeout:
            shut_down_with_error(CodedError("input_timeout", what=input_name, seconds=round(now - began)))
            return
        if now - logged_at > LOG_DELAY:
            rospy.logwarn("%s waits for %s", rospy.get_name(), input_name)
            # the pause doubles each time, from 5 s to 10 s to 20 s
            logged_at = now + max(0.0, now - began - LOG_DELAY)
        time.sleep(0.02)


def wait_for_clock() -> None:
    """Waits for the first time on /clock if simulated time is used. Returns at once otherwise.

    If none comes within `INPUT_TIMEOUT`, the node ends with "input_timeout".
    """
    _await("the time on /clock, because /use_sim_time is set", _clock_runs, INPUT_TIMEOUT)


def _clock_runs() -> bool:
    return not rospy.get_rostime().is_zero()
