"""What happened, for the page's history and for studies."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any, Deque, Dict, List

import rospy

from vb_core.errors import ParameterError
from vb_core.files import append_line

_EVENTS = 100  # of the history that the page shows


class EventHistory:
    """The history: the newest events in memory, all of them in a file, one JSON object a line."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._events: Deque[Dict[str, Any]] = deque(maxlen=_EVENTS)
        try:
            with open(str(path), encoding="utf-8") as file:
                lines = deque(file, maxlen=_EVENTS)
        except FileNotFoundError:
            lines = deque()
        except OSError as error:
            raise ParameterError("events_file", f"{path} cannot be read: {error}") from None
        self.recalled: List[Dict[str, Any]] = []
        for line in lines:
            try:
                event = json.loads(line)
                self._events.append({key: event[key] for key in ("at", "code", "values", "source")})
                self.recalled.append(event)
            except (ValueError, TypeError, KeyError):
                continue  # a line that was cut off by a power failure

    def add(self, code: str, values: Dict[str, Any], source: str, **more: Any) -> List[Dict[str, Any]]:
        """Writes an event and returns those that the page shows."""
        event = {"at": round(time.time(), 1), "code": code, "values": values, "source": source}
        with self._lock:
            try:
                append_line(
                    self._path,
                    json.dumps({**event, "ros_time": rospy.get_time(), **more}, ensure_ascii=False),
                    private=True,
                )
            except OSError as error:
                rospy.logerr_throttle(10.0, f"{rospy.get_name()}: the history is not written: {error}")
            self._events.append(event)
            return list(self._events)

    def shown(self) -> List[Dict[str, Any]]:
        """Returns the events that the page shows at the start."""
        return list(self._events)
