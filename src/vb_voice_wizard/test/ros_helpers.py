"""What the rostests of this package share: waiting with a deadline, starting nodes, and stub neighbours."""

from __future__ import annotations

import subprocess
import time

import rospy

from std_srvs.srv import Trigger, TriggerResponse
from vb_core.errors import CodedError
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import (
    AddBorder,
    AddBorderResponse,
    GetDrawnBorder,
    GetDrawnBorderResponse,
    ListBorders,
    ListBordersResponse,
    PreviewBorder,
    PreviewBorderResponse,
)


def wait_until(condition, what: str, timeout: float = 120.0):
    """Waits for a condition; gives its first true value, or fails with what was waited for."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError(f"waited {timeout:g} s in vain for: {what}")


class Newest:
    """Keeps a topic's messages. The first may come after the node's services: `message` waits for it."""

    def __init__(self, name: str, message_type) -> None:
        self.all = []
        self.subscriber = rospy.Subscriber(name, message_type, self.all.append, queue_size=100)

    @property
    def message(self):
        return wait_until(lambda: self.all and self.all[-1], f"a first message on {self.subscriber.name}")

    def wait(self, condition, what: str, timeout: float = 120.0):
        """Waits until the newest message fulfils a condition."""
        return wait_until(lambda: self.all and condition(self.all[-1]) and self.all[-1], what, timeout)


class Process:
    """A node in a process of its own that can be killed and started again."""

    def __init__(self, executable: str, *arguments: str, package: str = "vb_voice_wizard") -> None:
        self._command = ["rosrun", package, executable, *arguments]
        self.process = None
        self.start()

    def start(self) -> None:
        # rosrun would stay in between: exec makes the pid the node's own
        self.process = subprocess.Popen(["bash", "-c", 'exec "$@"', "-", *self._command])

    def kill(self) -> None:
        """The hard way, as a crash does it."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        """The polite way."""
        self.process.terminate()
        try:
            self.process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self.kill()


class StubNeighbors:
    """border_fusion and map_integrator, as far as this package needs them."""

    def __init__(self) -> None:
        self.candidate = GetDrawnBorderResponse(success=True, code="ok")
        self.candidate.border.points = [rospy_point(0, 0), rospy_point(1, 0), rospy_point(1, 1)]
        self.candidate.border.seed = rospy_point(0.5, 0.5)
        self.add = AddBorderResponse(success=True, code="ok", id="b1")
        self.preview = PreviewBorderResponse(success=True, code="ok", area_m2=0.5, free_parts=1)
        self.preview.region.info.width, self.preview.region.info.height = 2, 1
        self.preview.region.data = [100, 0]
        self.before_add = lambda: None
        self.candidates, self.added, self.previews = [], [], []
        self.services = []

    def offer(self, candidate: bool = True, add: bool = True, preview: bool = True) -> None:
        """Starts the services."""
        if preview:
            self.services.append(rospy.Service("/virtual_borders/preview_border", PreviewBorder, self._on_preview))
        if candidate:
            self.services.append(rospy.Service("/virtual_borders/get_drawn_border", GetDrawnBorder, self._on_candidate))
        if add:
            self.services.append(rospy.Service("/virtual_borders/add_border", AddBorder, self._on_add))

    def offer_undo(self) -> list:
        """Starts undo over one border, "Nursery", which can be taken back once; gives the services."""
        self.undone = 0
        return [
            rospy.Service("/virtual_borders/undo", Trigger, self._on_undo),
            rospy.Service("/virtual_borders/list_borders", ListBorders, self._on_list),
        ]

    def _on_undo(self, _request):
        if self.undone:
            return TriggerResponse(False, str(CodedError("nothing_to_undo")))
        self.undone += 1
        return TriggerResponse(True, "Nursery is gone.")

    def _on_list(self, _request):
        response = ListBordersResponse()
        if not self.undone:
            response.borders.borders.append(VirtualBorder(id="b1", name="Nursery"))
        return response

    def withdraw(self) -> None:
        """Stops them."""
        for service in self.services:
            service.shutdown()
        self.services = []

    def _on_candidate(self, request):
        self.candidates.append(request)
        return self.candidate

    def _on_preview(self, request):
        self.previews.append(request)
        return self.preview_answer(request)

    def preview_answer(self, _request):
        """A test may put another one in its place."""
        return self.preview

    def _on_add(self, request):
        self.before_add()
        self.added.append(request)
        return self.add


def rospy_point(x: float, y: float):
    from geometry_msgs.msg import Point

    return Point(float(x), float(y), 0.0)
