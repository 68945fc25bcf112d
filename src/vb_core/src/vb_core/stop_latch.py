"""The stop of all robots, which persists through crashes and full disks until a person releases it.

The latch generates a new number for each stop. Only a `resume` that names the newest number releases the stop, because
its sender has seen that stop. A command given before a stop can therefore never release it, however late it arrives.
`StopLatch` answers commands in the interaction manager, and each robot obeys the `HeldStops` in its driver.

A robot holds every stop that it has received until a latch that knows all of these stops says that robots may drive. So
a stop holds even if the latch never received it, or has lost its file; the robot then reports the stop.

>>> latch, robot = StopLatch(), HeldStops()
>>> robot.add("1a")                        # a button's stop reaches the robot ...
>>> robot.update_from_latch(latch.stopped, latch.stops)
>>> robot.stopped                           # ... and holds, although the latch does not know of it yet
True
>>> latch.stop("1a", "button"), latch.resume("an older number"), latch.resume(latch.number)
(True, False, True)
>>> robot.update_from_latch(latch.stopped, latch.stops)
>>> robot.stopped
False
"""

from __future__ import annotations

import contextlib
import json
import os
import threading
import uuid
from pathlib import Path
from typing import Any, List, Optional, Sequence, Tuple

from vb_core.errors import CodedError
from vb_core.files import write_atomically

MAX_KNOWN_STOPS = 32  # stops that the latch remembers: a robot that missed more of them counts as stopped again
MAX_HELD_STOPS = 4  # stops that a robot holds one by one; those of eight robots are MAX_KNOWN_STOPS


def new_id() -> str:
    """Generates an id or a number for a stop that differs from all earlier ones, even forgotten ones."""
    return uuid.uuid4().hex[:12]


class _Stored:
    """State that is kept in a file. If the file cannot be read or written, that counts as a stop. Thread safe.

    Args:
        path: the file; None keeps the state in memory only.

    Attributes:
        lost: whether it counts as stopped because its file was damaged or could not be written.
        stored: whether the last `store` succeeded.
    """

    def __init__(self, path: Optional[Path]) -> None:
        self._path = path
        self._lock, self._writing = threading.Lock(), threading.Lock()
        self._written: Any = None
        self.lost = False
        self.stored = True
        readable = True
        try:
            if path is not None:
                self._restore(json.loads(path.read_bytes()))
        except FileNotFoundError:
            pass
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            readable = False
        if not readable or not self.store():
            self._stop_in_doubt()
            self.lost = True
            self.store()

    def _restore(self, content: Any) -> None:
        raise NotImplementedError

    def _content(self) -> Any:
        raise NotImplementedError

    def _stop_in_doubt(self) -> None:
        raise NotImplementedError

    def store(self) -> bool:
        """Writes the state to the file, durably. Returns False if that is not possible.

        A full disk has no room for a new file. Then the old file is emptied, since an empty file counts as a stop.
        """
        with self._writing:
            with self._lock:
                content = self._content()
            if self._path is not None and content != self._written:
                try:
                    write_atomically(self._path, json.dumps(content).encode("utf-8"))
                    self._written = content
                except CodedError:
                    self._written = None
                    _empty(self._path)
                self.stored = self._written is not None
            return self.stored


class StopLatch(_Stored):
    """The stop of all robots.

    Attributes:
        number: number of the newest stop; set even before the first stop, so that every command can name it.
        stops: ids of the latest stops, as given by their senders, the newest last.
        stopped, stopped_by: whether the newest stop is in force, and who gave the first of the stops in force.
    """

    def __init__(self, path: Optional[Path] = None) -> None:
        self.number = new_id()
        self.stops: Tuple[str, ...] = ()
        self.stopped = False
        self.stopped_by = ""
        super().__init__(path)

    def stop(self, identity: str, sender: str) -> bool:
        """Stops all robots. Ignores a known stop and returns False, since one press may arrive twice."""
        with self._lock:
            if identity in self.stops:
                return False
            self.stopped_by = self.stopped_by if self.stopped else sender
            self.number = new_id()
            self.stops = (*self.stops, identity)[-MAX_KNOWN_STOPS:]
            self.stopped = True
            return True

    def snapshot(self) -> Tuple[bool, str, str, Tuple[str, ...]]:
        """Returns a consistent snapshot: whether robots are stopped, by whom, the number and the stops."""
        with self._lock:
            return self.stopped, self.stopped_by, self.number, self.stops

    def resume(self, seen_number: str) -> bool:
        """Releases the stop if `seen_number` is the newest number. Returns whether robots may drive now."""
        with self._lock:
            if seen_number == self.number:
                self.stopped = False
                self.stopped_by = ""
                self.lost = False
            return not self.stopped

    def _restore(self, content: Any) -> None:
        number, *stops = _check_ids([content["number"], *content["stops"]])
        stopped, stopped_by = content["stopped"], content["by"]
        if not isinstance(stopped, bool):
            raise ValueError("not a stop")
        self.number = number
        self.stops = tuple(stops)
        self.stopped = stopped
        self.stopped_by = str(stopped_by)

    def _content(self) -> Any:
        return {"number": self.number, "stops": list(self.stops), "stopped": self.stopped, "by": self.stopped_by}

    def _stop_in_doubt(self) -> None:
        self.stop(new_id(), self.stopped_by or "interaction_manager")


class HeldStops(_Stored):
    """The stops that one robot holds: it has received them, and no latch that knows all of them has released them.

    Attributes:
        ids: the stops' ids.
    """

    def __init__(self, path: Optional[Path] = None) -> None:
        self.ids: Tuple[str, ...] = ()
        self._latch_stopped = False  # whether the latch's newest message says stopped
        super().__init__(path)

    @property
    def stopped(self) -> bool:
        """Whether the robot must stand still."""
        return self._latch_stopped or bool(self.ids)

    @property
    def persisted_ids(self) -> Tuple[str, ...]:
        """The held stops that survive the process: those in the file, or all if the file cannot be written."""
        stored_ids = self._written
        if stored_ids is None:
            return self.ids
        return tuple(identity for identity in self.ids if identity in stored_ids)

    def add(self, identity: str) -> None:
        """Adds a stop. If there are too many, one new stop replaces all of them."""
        with self._lock:
            if identity not in self.ids:
                self.ids = (*self.ids, identity) if len(self.ids) < MAX_HELD_STOPS else (new_id(),)

    def update_from_latch(self, stopped: bool, stops: Sequence[str]) -> None:
        """Applies the latch's message: whether robots are stopped, and which stops it knows, the newest last."""
        if stopped and stops:
            self.add(stops[-1])
        with self._lock:
            self._latch_stopped = stopped
            if not stopped and set(self.ids) <= set(stops):
                self.ids = ()
                self.lost = False

    def _restore(self, content: Any) -> None:
        self.ids = tuple(_check_ids(content))

    def _content(self) -> Any:
        return list(self.ids)

    def _stop_in_doubt(self) -> None:
        self.add(new_id())


def _check_ids(values: Any) -> List[str]:
    if not isinstance(values, list) or not all(isinstance(value, str) and value for value in values):
        raise ValueError("expected a list of ids")
    return values


def _empty(path: Path) -> None:
    """Empties a file in place, if possible."""
    with contextlib.suppress(OSError), open(str(path), "r+b") as file:
        file.truncate()
        os.fsync(file.fileno())
