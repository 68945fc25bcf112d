"""Converts notices to and from messages, publishes a node's notices, and keeps those that all nodes published."""

from __future__ import annotations

import math
import threading
import time
from typing import Any, Callable, Dict, Iterable, List, Tuple

import rospy

from vb_core import names
from vb_core.notices import REPEAT_PERIOD, ActiveNotices, Notice, Severity
from vb_core.ros import node
from vb_core.ros.messages import mapping_from_values, values_from_mapping
from vb_msgs.msg import Notice as NoticeMessage
from vb_msgs.msg import NoticeArray

LOG_PERIOD = 60.0  # [s] before an intermittent notice is logged again


def message_from_notice(notice: Notice) -> NoticeMessage:
    """Converts a notice to a message with its English sentence. Inverse of `notice_from_message`."""
    values = values_from_mapping(notice.values)
    converted = {"severity": int(notice.severity), "values": values, "message": notice.sentence()}
    return NoticeMessage(**{**vars(notice), **converted})


def notice_from_message(message: NoticeMessage) -> Notice:
    """Converts a message to a notice. Inverse of `message_from_notice`.

    An unknown severity counts as an error: it may come from a newer version.
    """
    return Notice(
        code=message.code,
        severity=Severity(min(message.severity, Severity.ERROR)),
        robot=message.robot,
        border_id=message.border_id,
        camera=message.camera,
        values=mapping_from_values(message.values),
        message=message.message,
    )


class NoticeListener:
    """Keeps the notices of all nodes. Its methods may be called from any thread.

    Notices are repeated in ROS time, so they expire in it: a simulation may be slow, or pause.

    Args:
        on_change: called after each message, from the subscriber's thread.
    """

    def __init__(self, on_change: Callable[[], None] = lambda: None) -> None:
        self._on_change = on_change
        self._lock = threading.Lock()
        self._active = ActiveNotices()
        self.subscriber = rospy.Subscriber(names.NOTICES, NoticeArray, self._on_notices, queue_size=50)

    def current(self) -> List[Notice]:
        """Returns the notices that hold now, most severe first."""
        with self._lock:
            return self._active.current(rospy.get_time())

    def _on_notices(self, message: NoticeArray) -> None:
        with self._lock:
            self._active.update(message.source, map(notice_from_message, message.notices), rospy.get_time())
        self._on_change()


class NoticePublisher:
    """Publishes notices on /virtual_borders/notices, at once and again every second.

    A warning or an error is also logged once for as long as it holds, because roslaunch's terminal shows only the log.

    Args:
        source: name of the reporter, if it is not the whole node.
    """

    def __init__(self, source: str = "") -> None:
        self._source = source or rospy.get_name()
        self._lock = threading.Lock()
        self._notices: List[Notice] = []
        self._logged: Dict[Tuple[Any, ...], float] = {}  # [s] wall time at which each last held
        self._publisher = rospy.Publisher(names.NOTICES, NoticeArray, queue_size=10, latch=True)
        self._timer = node.WakeTimer(REPEAT_PERIOD)
        node.Worker(self._timer, lambda _: self._publish())
        self._publish()

    def set(self, notices: Iterable[Notice]) -> None:
        """Replaces this source's notices. If none changes, nothing is sent before the next repetition."""
        notices = list(notices)
        with self._lock:
            if notices == self._notices:
                return
            self._notices = notices
        self._publish()

    def close(self) -> None:
        """Withdraws all notices."""
        self._timer.close()
        self.set([])

    def _publish(self) -> None:
        with self._lock:
            message = NoticeArray(source=self._source, notices=[message_from_notice(n) for n in self._notices])
            new_notices = self._take_new()
        message.header.stamp = rospy.Time.now()
        self._publisher.publish(message)
        for notice in new_notices:
            log = rospy.logerr if notice.severity is Severity.ERROR else rospy.logwarn
            log("%s: %s [%s]", self._source, notice.sentence(), notice.code)

    def _take_new(self) -> List[Notice]:
        """Records which notices hold. Returns the warnings and errors among them that did not within LOG_PERIOD."""
        now = time.monotonic()
        new_notices = []
        for notice in self._notices:
            # a warning that becomes an error counts as new
            key = (notice.code, notice.robot, notice.border_id, notice.camera, notice.severity)
            held_recently = now - self._logged.get(key, -math.inf) <= LOG_PERIOD
            if notice.severity >= Severity.WARNING and not held_recently:
                new_notices.append(notice)
            self._logged[key] = now
        self._logged = {key: logged_at for key, logged_at in self._logged.items() if now - logged_at <= LOG_PERIOD}
        return new_notices
