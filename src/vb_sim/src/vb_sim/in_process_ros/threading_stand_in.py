"""Runs tasks that take turns instead of threads, and replaces threading, time and queue in the modules of nodes.

The clock advances when all tasks wait.
"""

from __future__ import annotations

import contextlib
import heapq
import queue as real_queue
import sys
import threading as real_threading
import time as real_time
from collections import deque
from functools import partial
from types import FunctionType, SimpleNamespace
from typing import Any, Callable, Deque, Dict, Iterator, List, Optional, Tuple

import greenlet

_LIBRARIES = ("tf2_ros", "actionlib", "dynamic_reconfigure")
_REAL = {"threading": real_threading, "time": real_time, "queue": real_queue}
MIN_TIMEOUT_NS = (
    1000  # [ns] a shorter wait, as for the last 2e-13 s of a period, would not advance the clock and not end
)


class Task(greenlet.greenlet):
    """One thread of a node."""

    scheduler: Any = None  # of the task's run
    owner: Any = None  # the task's node; tasks that the task starts inherit it
    waits = 0  # number of the task's waits; a wake-up that was meant for an earlier wait has no effect


class Scheduler:
    """Runs tasks one at a time, in an order that depends only on what they do.

    Attributes:
        now_ns: the time [ns].
        closed: the run is over, every task is being ended.
    """

    def __init__(self, start_ns: int) -> None:
        self.now_ns = start_ns
        self.closed = False
        self._hub = greenlet.getcurrent()
        self._ready: Deque[Tuple[Task, int]] = deque()
        self._due: List[Tuple[int, int, Callable[[], None]]] = []  # (time [ns], sequence number, what is called then)
        self._count = 0
        self._tasks: List[Task] = []
        self._fault: Optional[BaseException] = None

    def spawn(self, work: Callable[[], Any], owner: Any = None) -> Task:
        """Starts a task at the next turn. An exception in it ends the run."""
        task = Task(lambda *_: self._guarded(work), parent=self._hub)
        task.scheduler = self
        task.owner = owner if owner is not None else getattr(greenlet.getcurrent(), "owner", None)
        if len(self._tasks) > 2000:
            self._tasks = [task for task in self._tasks if not task.dead]
        self._tasks.append(task)
        self._ready.append((task, 0))
        return task

    def _guarded(self, work: Callable[[], Any]) -> None:
        try:
            work()
        except greenlet.GreenletExit:
            pass
        except BaseException as error:
            self.fault(error)

    def fault(self, error: BaseException) -> None:
        """Ends the run with an error. Of several, the first counts, unless an interruption follows."""
        if not self.closed and (self._fault is None or not isinstance(error, Exception)):
            self._fault = error

    def wait(self, timeout_ns: Optional[int] = None) -> bool:
        """Suspends the task until `wake`, or for a time [ns]. Returns whether it was woken."""
        task = greenlet.getcurrent()
        if not isinstance(task, Task):
            raise RuntimeError("only a node can wait in a run within one process")
        if task.scheduler is not self:
            # without this check, the task would end as if its own run were over, and nobody would know why
            raise RuntimeError("something was kept from an earlier run in this process: a lock, a queue or a function")
        if self.closed:
            raise greenlet.GreenletExit
        task.waits += 1
        if timeout_ns is not None:
            give_up = partial(self._resume, task, task.waits, False)
            self.call_later(max(int(timeout_ns), MIN_TIMEOUT_NS), give_up)
        return bool(self._hub.switch())

    def wake(self, task: Task) -> None:
        """Makes a suspended task continue at its next turn."""
        self._ready.append((task, task.waits))

    def call_later(self, delay_ns: int, work: Callable[[], None]) -> None:
        """Calls a short function after a time [ns]. It must not wait."""
        self._count += 1
        heapq.heappush(self._due, (self.now_ns + delay_ns, self._count, work))

    def run(self, is_over: Callable[[], bool], until_ns: int) -> None:
        """Runs the tasks until `is_over` returns true, a time [ns] is reached or nothing is left to do.

        Raises:
            what a task raised.
        """
        while not is_over() and self.now_ns < until_ns:
            if self._ready:
                task, waits = self._ready.popleft()
                self._resume(task, waits, True)
            elif self._due:
                self.now_ns, _, work = heapq.heappop(self._due)
                work()
            else:
                return
            if self._fault is not None:
                raise self._fault

    def _resume(self, task: Task, waits: int, woken: bool) -> None:
        if not task.dead and task.waits == waits:
            task.waits += 1  # anything else that would end this wait comes too late
            task.switch(woken)

    def close(self) -> None:
        """Ends every task."""
        self.closed = True
        for task in self._tasks:
            while not task.dead:
                task.throw(greenlet.GreenletExit)
        self._tasks.clear()


class StandIns:
    """Stand-ins for the three modules, as far as nodes use them. All other names are the real ones.

    Args:
        scheduler: provides time and tasks.

    Attributes:
        modules: the stand-ins, by module name.
        restore: restores the modules' original contents.
    """

    def __init__(self, scheduler: Scheduler) -> None:
        self.modules = _modules(scheduler)
        self._undone = contextlib.ExitStack()
        self.restore = self._undone.close

    def replace(self) -> None:
        """Puts the stand-ins into all modules of nodes that have been imported so far."""
        for name, module in list(sys.modules.items()):
            package = name.split(".")[0]
            if package not in _LIBRARIES and (not package.startswith("vb_") or package == "vb_evaluation"):
                continue
            for attribute, real in _REAL.items():
                if module is not None and module.__dict__.get(attribute) is real:
                    self._undone.enter_context(replace_temporarily({module: {attribute: self.modules[attribute]}}))


def _modules(scheduler: Scheduler) -> Dict[str, SimpleNamespace]:
    def seconds() -> float:
        return scheduler.now_ns * 1e-9

    lock = partial(Lock, scheduler)
    names: Dict[str, Any] = {"_allocate_lock": lock, "Lock": lock, "_time": seconds}
    names["RLock"] = _copy_class(real_threading._RLock, **names, get_ident=greenlet.getcurrent)
    names["Condition"] = _copy_class(real_threading.Condition, **names)
    names["Event"] = _copy_class(real_threading.Event, **names)
    names["Thread"] = partial(Thread, scheduler, names["Event"])
    threading = SimpleNamespace(**{**vars(real_threading), **names})
    clock: Dict[str, Any] = dict.fromkeys(("time", "monotonic", "perf_counter"), seconds)
    clock["time_ns"] = lambda: scheduler.now_ns
    clock["sleep"] = lambda duration: scheduler.wait(round(max(duration, 0.0) * 1e9))
    queue_class = _copy_class(real_queue.Queue, threading=threading, time=seconds)
    return {
        "threading": threading,
        "time": SimpleNamespace(**{**vars(real_time), **clock}),
        "queue": SimpleNamespace(**{**vars(real_queue), "Queue": queue_class}),
    }


def _copy_class(kind: type, **others: Any) -> type:
    """Copies a standard-library class. The copy's methods use `others` instead of their module's locks and clock."""
    namespace = {**vars(sys.modules[kind.__module__]), **others}
    members = {name: value for name, value in vars(kind).items() if name not in ("__dict__", "__weakref__")}
    for name, value in members.items():
        if isinstance(value, FunctionType):
            members[name] = FunctionType(value.__code__, namespace, name, value.__defaults__)
    return type(kind.__name__, kind.__bases__, members)


class WaitQueue:
    """A first-in, first-out queue of waiting tasks, from which locks are built.

    Tasks take turns and yield only where they wait, so that nothing else needs protection.
    """

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._tasks: Deque[Task] = deque()

    def wait(self, timeout_ns: Optional[int] = None) -> bool:
        """Suspends the current task. Returns whether it was woken within a time [ns]."""
        task = greenlet.getcurrent()
        self._tasks.append(task)
        try:
            return self._scheduler.wait(timeout_ns)
        finally:
            # otherwise `wake` would wake a task that no longer waits, and the next in line would wait for ever
            if task in self._tasks:
                self._tasks.remove(task)

    def wake(self) -> None:
        """Wakes the task that has waited longest."""
        if self._tasks:
            self._scheduler.wake(self._tasks.popleft())


class Lock:
    """Replaces threading.Lock. Python's own reentrant locks, conditions, events and queues are built on it."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._waiting = WaitQueue(scheduler)
        self._is_held = False

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        """Acquires the lock, waiting until it is free."""
        # almost always free: one task runs at a time
        while self._is_held:
            if not blocking or not self._waiting.wait(None if timeout < 0 else round(timeout * 1e9)):
                return False
        self._is_held = True
        return True

    def release(self) -> None:
        """Releases the lock to the task that has waited longest."""
        self._is_held = False
        self._waiting.wake()

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: Any) -> None:
        self.release()


class Thread(real_threading.Thread):
    """Replaces threading.Thread by a task."""

    def __init__(self, scheduler: Scheduler, event_class: Any, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._scheduler = scheduler
        self._ended = event_class()
        self._task: Optional[Task] = None

    def start(self) -> None:
        """Starts the thread."""
        self._task = self._scheduler.spawn(self._run_and_tell)

    def _run_and_tell(self) -> None:
        try:
            self.run()
        finally:
            self._ended.set()

    def join(self, timeout: Optional[float] = None) -> None:
        """Waits until the thread has ended."""
        if not self._scheduler.closed:
            self._ended.wait(timeout)

    def is_alive(self) -> bool:
        """Returns whether the thread has started and not ended."""
        return self._task is not None and not self._ended.is_set()


@contextlib.contextmanager
def replace_temporarily(targets: Dict[Any, Dict[str, Any]]) -> Iterator[None]:
    """Replaces attributes of modules or classes, and restores them at the end."""
    with contextlib.ExitStack() as restore:
        for target, names in targets.items():
            for name, value in names.items():
                restore.callback(setattr, target, name, getattr(target, name))
                setattr(target, name, value)
        yield
