"""Stand-ins for the nodes beside the interaction manager: border_fusion and map_integrator."""

import contextlib
import threading

import rospy
from geometry_msgs.msg import Point
from vb_msgs import srv
from vb_msgs.msg import VirtualBorder


def point(x, y):
    return Point(float(x), float(y), 0.0)


class StubNeighbors:
    """Stubs of border_fusion and map_integrator, as far as tests need them."""

    def __init__(self) -> None:
        self.candidate = srv.GetDrawnBorderResponse(success=True, code="ok")
        self.candidate.border.points = [point(0, 0), point(1, 0), point(1, 1)]
        self.candidate.border.seed = point(0.5, 0.5)
        self.add = srv.AddBorderResponse(success=True, code="ok", id="b1")
        self.preview = srv.PreviewBorderResponse(success=True, code="ok", area_m2=0.5, free_parts=1)
        self.preview.region.info.width, self.preview.region.info.height = 2, 1
        self.preview.region.data = [100, 0]
        self.before = {"preview": lambda: None, "add": lambda: None}  # called before these services answer
        self.candidates, self.added, self.previews = [], [], []
        self.services = []

    def offer(self) -> None:
        """Starts the services; one border, "Nursery", can be undone once."""
        self.undone = 0
        self.services += [
            rospy.Service("/virtual_borders/preview_border", srv.PreviewBorder, self._on_preview),
            rospy.Service("/virtual_borders/get_drawn_border", srv.GetDrawnBorder, self._on_candidate),
            rospy.Service("/virtual_borders/add_border", srv.AddBorder, self._on_add),
            rospy.Service("/virtual_borders/undo_redo", srv.UndoRedo, self._on_undo),
            rospy.Service("/virtual_borders/list_borders", srv.ListBorders, self._on_list),
        ]

    def _on_undo(self, _request):
        if self.undone:
            return srv.UndoRedoResponse(code="nothing_to_undo")
        self.undone += 1
        return srv.UndoRedoResponse(success=True, code="ok")

    def _on_list(self, _request):
        response = srv.ListBordersResponse()
        if not self.undone:
            response.borders.borders.append(VirtualBorder(id="b1", name="Nursery"))
        return response

    def withdraw(self) -> None:
        """Stops the services."""
        for service in self.services:
            service.shutdown()
        self.services = []

    def _on_candidate(self, request):
        self.candidates.append(request)
        return self.candidate

    def _on_preview(self, request):
        self.before["preview"]()
        self.previews.append(request)
        return self.preview

    def _on_add(self, request):
        self.before["add"]()
        self.added.append(request)
        return self.add

    @contextlib.contextmanager
    def refusing(self, name, code):
        """Has the service `candidate`, `add` or `preview` refuse what is asked, until the block ends."""
        accepted = getattr(self, name)
        setattr(self, name, type(accepted)(success=False, code=code, message="Refused."))
        try:
            yield
        finally:
            setattr(self, name, accepted)

    @contextlib.contextmanager
    def hanging(self, name):
        """Has the service `add` or `preview` answer only after the block; yields an event that is set when it is called."""
        called, ended = threading.Event(), threading.Event()

        def hang():
            called.set()
            ended.wait(60)

        proceed, self.before[name] = self.before[name], hang
        try:
            yield called
        finally:
            self.before[name] = proceed
            ended.set()
