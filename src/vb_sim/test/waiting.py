"""Waiting for conditions in rostests; the limits are wall time, generous for a loaded machine."""

import threading
import time

import rospy


def wait_until(condition, limit=30.0):
    """Whether the condition became true before the limit [s]."""
    end = time.monotonic() + limit
    while time.monotonic() < end and not rospy.is_shutdown():
        if condition():
            return True
        time.sleep(0.02)
    return bool(condition())


class Latest:
    """The newest message of a topic, and how many came."""

    def __init__(self, topic, kind):
        self._lock = threading.Lock()
        self.message, self.count, self.all = None, 0, []
        self.subscriber = rospy.Subscriber(topic, kind, self._take, queue_size=100)

    def _take(self, message):
        with self._lock:
            self.message, self.count = message, self.count + 1
            self.all.append(message)

    def next(self, limit=30.0):
        """The next message that comes."""
        before = self.count
        assert wait_until(lambda: self.count > before, limit), f"nothing came on {self.subscriber.name}"
        return self.message

    def until(self, condition, limit=30.0):
        """The first message from now on that fulfils a condition."""
        assert wait_until(
            lambda: self.message is not None and condition(self.message), limit
        ), f"never on {self.subscriber.name}"
        return self.message
