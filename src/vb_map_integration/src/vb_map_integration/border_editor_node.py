"""Node: borders whose vertices are dragged in RViz."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Callable, Dict, List, Sequence, Tuple

import numpy as np
import rospy
from interactive_markers.interactive_marker_server import InteractiveMarkerServer
from vb_msgs.msg import VirtualBorderArray
from visualization_msgs.msg import (
    InteractiveMarker,
    InteractiveMarkerControl,
    InteractiveMarkerFeedback,
    Marker,
    MenuEntry,
)

from vb_core import names
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_core.ros import node, parameters
from vb_map_integration.borders import draft_markers, editing
from vb_map_integration.border import VirtualBorder
from vb_map_integration.border_client import BorderClient, ServiceResult
from vb_map_integration.borders.border_messages import border_from_message

SERVER = "/virtual_borders/edit"
TOOL, NEW = "tool", "new"
# numbers of menu entries; fixed, so that other programs may send them too
SAVE, CANCEL, INSERT, REMOVE_VERTEX, EDIT, TOGGLE, DELETE, NEW_POLYGON, NEW_CURVE, UNDO, REDO = range(1, 12)
TITLES = {
    SAVE: "Save",
    CANCEL: "Cancel",
    INSERT: "Insert vertex behind",
    REMOVE_VERTEX: "Remove vertex",
    EDIT: "Edit",
    TOGGLE: "Enable or disable",
    DELETE: "Delete",
    NEW_POLYGON: "New polygon here",
    NEW_CURVE: "New separating curve here",
    UNDO: "Undo",
    REDO: "Redo",
}
_DRAFT_MENU, _STORED_MENU, _TOOL_MENU = (SAVE, CANCEL), (EDIT, TOGGLE, DELETE), (NEW_POLYGON, NEW_CURVE)


@dataclass(frozen=True)
class EditorParams(Parameters):
    """The editor's parameters."""

    frame_id: str = param(names.MAP_FRAME)
    simplification_tolerance: float = param(0.02, "m", low=0.0)
    new_border_size: float = param(1.0, "m", above=0.0)


class BorderEditorNode:
    """Edits borders in RViz with interactive markers; changes go through preview and commit.

    Each stored border has a ball at its seed, with a menu: edit, enable or disable, delete. While it is edited each
    vertex and the seed have a handle to be dragged, with a menu: save, cancel, insert or remove a vertex. When a
    handle is released the preview's answer is shown beside the seed. One more ball, which may be dragged anywhere,
    has a menu to make new borders.

    Subscribed topics:
        /virtual_borders/borders (vb_msgs/VirtualBorderArray)
        /virtual_borders/edit/feedback (visualization_msgs/InteractiveMarkerFeedback): from RViz's InteractiveMarkers
            display. Names of markers: ID, ID/VERTEX, ID/seed, ID/line, where ID is "new" for one that is not stored
            yet; "tool".
    Published topics:
        /virtual_borders/edit/update (visualization_msgs/InteractiveMarkerUpdate): handles of borders.
        /virtual_borders/edit/update_full (visualization_msgs/InteractiveMarkerInit, latched): all of them.
    Services called:
        /virtual_borders/preview_border (vb_msgs/PreviewBorder), /virtual_borders/add_border (vb_msgs/AddBorder)
        /virtual_borders/update_border (vb_msgs/UpdateBorder), /virtual_borders/remove_border (vb_msgs/RemoveBorder)
        /virtual_borders/set_border_enabled (vb_msgs/SetBorderEnabled)
        /virtual_borders/undo, /virtual_borders/redo (std_srvs/Trigger)
    Parameters:
        config/border_editor.yaml
    """

    def __init__(self, params: EditorParams) -> None:
        self._params = params
        self._client = BorderClient("border_editor", params.frame_id)
        self._lock = threading.RLock()
        self._stored: Dict[str, VirtualBorder] = {}
        self._drafts: Dict[str, VirtualBorder] = {}
        self._answers: Dict[str, ServiceResult] = {}
        # the revision whose borders are shown, and that in which each draft's border was as the person saw it
        self._revision = 0
        self._seen: Dict[str, int] = {}
        self._tool = np.zeros(2)
        self._steps: List[int] = []  # UNDO and REDO, each if there is something to undo or redo
        # service calls wait for their answers: not in a callback
        self._work: "node.Queue[Callable[[], None]]" = node.Queue()
        node.Worker(self._work, lambda work: work())
        self._server = InteractiveMarkerServer(SERVER)
        self._put_tool()
        self._server.applyChanges()
        rospy.Subscriber(names.BORDERS, VirtualBorderArray, self._on_borders, queue_size=1)

    def close(self) -> None:
        """Ends the worker."""
        self._work.close()

    # ------------------------------------------------------------- what comes in
    def _on_borders(self, message: VirtualBorderArray) -> None:
        stored = {}
        for one in message.borders:
            try:
                stored[one.id] = border_from_message(one)
            except CodedError as error:
                rospy.logwarn_throttle(5.0, f"{rospy.get_name()}: {error}")
        with self._lock:
            for key in set(self._stored) | set(stored):
                if self._stored.get(key) != stored.get(key):
                    self._erase(key)
            gone = [key for key in self._drafts if key != NEW and key not in stored]
            for key in gone:
                rospy.logwarn("%s: '%s' was deleted while it was edited", rospy.get_name(), self._drafts.pop(key).name)
            for key in self._drafts:
                if self._stored.get(key) == stored.get(key):
                    self._seen[key] = message.revision
            self._revision = message.revision
            self._stored = stored
            steps = [{"undo": UNDO, "redo": REDO}[command] for command in message.available_commands]
            if steps != self._steps:
                self._steps = steps
                self._put_tool()
            for key in stored:
                self._put(key)
            self._server.applyChanges()

    def _on_feedback(self, feedback: InteractiveMarkerFeedback) -> None:
        key, _, part = feedback.marker_name.partition("/")
        frame = feedback.header.frame_id.lstrip("/")
        if frame and frame != self._params.frame_id:
            text = "%s: set RViz's fixed frame to '%s', not '%s': the drag is ignored"
            rospy.logwarn(text, rospy.get_name(), self._params.frame_id, frame)
            return
        place = np.array([feedback.pose.position.x, feedback.pose.position.y])
        try:
            with self._lock:
                if feedback.event_type == InteractiveMarkerFeedback.MENU_SELECT:
                    self._on_menu(key, part, feedback.menu_entry_id)
                elif key == TOOL:
                    self._tool = place if np.isfinite(place).all() else self._tool
                elif feedback.event_type == InteractiveMarkerFeedback.POSE_UPDATE:
                    self._drag(key, part, place)
                elif feedback.event_type == InteractiveMarkerFeedback.MOUSE_UP and key in self._drafts:
                    self._put(key)
                    self._request_preview(key)
                self._server.applyChanges()
        except CodedError as error:
            rospy.logwarn("%s: %s", rospy.get_name(), error)
            with self._lock:
                if key in self._drafts:
                    self._put(key)  # the handle goes back to where its vertex is
                self._show_answer(key, ServiceResult(False, error.code, error.message))

    def _drag(self, key: str, part: str, place: np.ndarray) -> None:
        draft = self._drafts.get(key)
        if draft is None:
            return
        if part == "seed":
            self._drafts[key] = editing.move_seed(draft, place)
        elif part.isdigit() and int(part) < len(draft.points):
            moved = editing.move_vertex(draft, int(part), place)
            if len(moved.points) == len(draft.points):  # not dropped onto its neighbour
                self._drafts[key] = moved
        self._put_line(key)

    def _on_menu(self, key: str, part: str, entry: int) -> None:
        if key == TOOL:
            self._on_tool(entry)
            return
        draft, stored = self._drafts.get(key), self._stored.get(key)
        if draft is not None:
            if entry == SAVE:
                revision = self._seen.get(key, 0)
                self._work.put(lambda: self._save(key, draft, revision))
            elif entry == CANCEL:
                self._drop(key)
            elif entry in (INSERT, REMOVE_VERTEX) and part.isdigit() and int(part) < len(draft.points):
                change = editing.insert_vertex if entry == INSERT else editing.remove_vertex
                self._replace(key, change(draft, int(part)))
        elif stored is not None:
            if entry == EDIT:
                self._replace(key, editing.simplify(stored, self._params.simplification_tolerance))
            elif entry == TOGGLE:
                revision = self._revision
                self._work.put(lambda: self._report(self._client.set_enabled(key, not stored.enabled, revision)))
            elif entry == DELETE:
                revision = self._revision
                self._work.put(lambda: self._report(self._client.remove(key, revision)))

    def _on_tool(self, entry: int) -> None:
        if entry in (NEW_POLYGON, NEW_CURVE):
            self._replace(NEW, editing.new_border(self._tool, self._params.new_border_size, entry == NEW_POLYGON))
        elif entry in (UNDO, REDO):
            self._work.put(lambda: self._report(self._client.trigger(names.UNDO if entry == UNDO else names.REDO)))

    # ------------------------------------------------------------- drafts
    def _replace(self, key: str, draft: VirtualBorder) -> None:
        """Adopts a draft with another number of vertices: all its handles are rebuilt."""
        self._erase(key)
        if key not in self._drafts:
            self._seen[key] = 0 if key == NEW else self._revision
        self._drafts[key] = draft
        self._put(key)
        self._request_preview(key)

    def _drop(self, key: str) -> None:
        self._erase(key)
        self._drafts.pop(key, None)
        self._answers.pop(key, None)
        self._seen.pop(key, None)
        self._put(key)

    def _request_preview(self, key: str) -> None:
        draft = self._drafts[key]
        self._work.put(lambda: self._show_answer(key, self._client.preview(draft)))

    def _save(self, key: str, draft: VirtualBorder, revision: int) -> None:
        answer = self._client.save(draft, 0 if key == NEW else revision)
        self._report(answer)
        with self._lock:
            if answer.success and self._drafts.get(key) is draft:
                self._drop(key)
                self._server.applyChanges()
            else:
                self._show_answer(key, answer)

    def _report(self, answer: ServiceResult) -> None:
        log = rospy.loginfo if answer.success else rospy.logwarn
        log("%s: %s", rospy.get_name(), answer.message if answer.success else f"[{answer.code}] {answer.message}")

    def _show_answer(self, key: str, answer: ServiceResult) -> None:
        with self._lock:
            if key in self._drafts:
                self._answers[key] = answer
                self._put_line(key)
                self._server.applyChanges()

    # ------------------------------------------------------------- markers
    def _erase(self, key: str) -> None:
        draft = self._drafts.get(key)
        vertices = range(len(draft.points) if draft else 0)
        for name in [key, f"{key}/seed", f"{key}/line"] + [f"{key}/{index}" for index in vertices]:
            self._server.erase(name)

    def _put(self, key: str) -> None:
        """The markers of a border: its handles if it is edited, else one ball."""
        draft, stored = self._drafts.get(key), self._stored.get(key)
        if draft is not None:
            for index, point in enumerate(draft.points):
                menu = (*_DRAFT_MENU, INSERT, REMOVE_VERTEX)
                self._handle(f"{key}/{index}", point, draft_markers.ball_marker(draft_markers.DRAFT), menu)
            self._handle(f"{key}/seed", draft.seed, draft_markers.ball_marker(draft_markers.SEED, 0.15), _DRAFT_MENU)
            self._put_line(key)
        elif stored is not None:
            color = draft_markers.STORED if stored.enabled else draft_markers.SLEEPING
            ball = draft_markers.ball_marker(color, 0.15)
            self._handle(key, stored.seed, ball, _STORED_MENU, drag=False, description=stored.name)
            line = draft_markers.chain_marker(stored.points, stored.closed, color)
            self._insert(f"{key}/line", (0.0, 0.0), [_control(InteractiveMarkerControl.NONE, [line])])

    def _put_line(self, key: str) -> None:
        """The line of a border being edited, and the last preview's answer."""
        draft = self._drafts[key]
        answer = self._answers.get(key)
        markers = [draft_markers.chain_marker(draft.points, draft.closed, draft_markers.DRAFT)]
        if answer is not None:
            text = "; ".join([answer.message] + [found.message for found in answer.issues if answer.success])
            color = draft_markers.DRAFT if answer.success else draft_markers.REFUSED
            markers.append(draft_markers.text_marker(text, draft.seed, color))
        self._insert(f"{key}/line", (0.0, 0.0), [_control(InteractiveMarkerControl.NONE, markers)])

    def _put_tool(self) -> None:
        ball = draft_markers.ball_marker(draft_markers.SEED, 0.25)
        self._handle(TOOL, self._tool, ball, (*_TOOL_MENU, *self._steps), description="new border")

    def _handle(
        self,
        name: str,
        place: Sequence[float],
        ball: Marker,
        menu: Tuple[int, ...],
        drag: bool = True,
        description: str = "",
    ) -> None:
        controls = [_control(InteractiveMarkerControl.MENU, [ball])]
        if drag:
            plane = _control(InteractiveMarkerControl.MOVE_PLANE, [ball])
            # a control moves in the plane across its x axis: that is the floor once x points up
            plane.orientation.w = plane.orientation.y = 0.5**0.5
            controls.insert(0, plane)
        entries = [
            MenuEntry(id=entry, parent_id=0, title=TITLES[entry], command_type=MenuEntry.FEEDBACK) for entry in menu
        ]
        self._insert(name, place, controls, entries, description)

    def _insert(
        self,
        name: str,
        place: Sequence[float],
        controls: List[InteractiveMarkerControl],
        menu: Sequence[MenuEntry] = (),
        description: str = "",
    ) -> None:
        marker = InteractiveMarker(name=name, description=description, scale=0.4)
        marker.controls, marker.menu_entries = list(controls), list(menu)
        marker.header.frame_id = self._params.frame_id
        marker.pose.position.x, marker.pose.position.y = (float(value) for value in place)
        marker.pose.orientation.w = 1.0
        self._server.insert(marker, self._on_feedback)


def _control(mode: int, markers: List[Marker]) -> InteractiveMarkerControl:
    control = InteractiveMarkerControl(interaction_mode=mode, always_visible=True, markers=markers)
    control.orientation.w = 1.0
    return control


def build() -> BorderEditorNode:
    """Reads the parameters and makes the node."""
    return BorderEditorNode(parameters.read(EditorParams))
