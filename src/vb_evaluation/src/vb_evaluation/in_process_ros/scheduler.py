"""Runs tasks that take turns, and a clock that advances when all of them wait."""

from __future__ import annotations

import heapq
from collections import deque
from typing import Any, Callable, Deque, List, Optional, Tuple

import greenlet

# [ns] the shortest wait. A thread that waits for what rounding left of its last wait (2e-13 s) would otherwise do so
# for ever: simulated time advances only when all wait.
MIN_TIMEOUT_NS = 1000


class Task(greenlet.greenlet):
    """One thread of a node.

    Attributes:
        scheduler: of the run that it belongs to.
        owner: the node that it belongs to; tasks that it starts inherit it.
        waits: number of its waits; a wake-up for an earlier one has no effect.
    """

    scheduler: Any = None
    owner: Any = None
    waits = 0


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
        # (time [ns], sequence number, task, number of its wait that ends), or (time, sequence number, None, function)
        self._due: List[Tuple[int, int, Optional[Task], Any]] = []
        self._count = 0
        self._tasks: List[Task] = []
        self._fault: Optional[BaseException] = None

    def spawn(self, work: Callable[[], Any], owner: Any = None) -> Task:
        """Starts a task at the next turn; an exception in it ends the run."""
        task = Task(lambda *_: self._guarded(work), parent=self._hub)
        task.scheduler = self
        task.owner = owner if owner is not None else getattr(greenlet.getcurrent(), "owner", None)
        if len(self._tasks) > 2000:
            self._tasks = [known for known in self._tasks if not known.dead]
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
        """Ends the run with an error: the first one, which only an interruption replaces."""
        if not self.closed and (self._fault is None or not isinstance(error, Exception)):
            self._fault = error

    def wait(self, timeout_ns: Optional[int] = None) -> bool:
        """Suspends the task until `wake`, or for a time [ns]; returns whether it was woken."""
        task = greenlet.getcurrent()
        if not isinstance(task, Task):
            raise RuntimeError("only a node can wait in a run within one process")
        if task.scheduler is not self:
            # otherwise it would end as if its own run were over, and the reason why it does not answer would be lost
            raise RuntimeError("something was kept from an earlier run in this process: a lock, a queue or a function")
        if self.closed:
            raise greenlet.GreenletExit
        task.waits += 1
        if timeout_ns is not None:
            self._push(max(int(timeout_ns), MIN_TIMEOUT_NS), task, task.waits)
        return bool(self._hub.switch())

    def wake(self, task: Task) -> None:
        """Makes a suspended task continue at its next turn."""
        self._ready.append((task, task.waits))

    def call_later(self, delay_ns: int, work: Callable[[], None]) -> None:
        """Calls a short function after a time [ns]; it must not wait."""
        self._push(delay_ns, None, work)

    def _push(self, delay_ns: int, task: Optional[Task], what: Any) -> None:
        self._count += 1
        heapq.heappush(self._due, (self.now_ns + delay_ns, self._count, task, what))

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
                due, _, task, what = heapq.heappop(self._due)
                if task is None:
                    self.now_ns = due
                    what()
                elif not task.dead and task.waits == what:
                    self.now_ns = due
                    self._resume(task, what, False)
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
