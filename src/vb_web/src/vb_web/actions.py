"""Carries out what the page asks for, by the services of interaction manager and map integrator. Needs a node.

The idea: one table from action to method; each returns an answer with code and values, or raises a `CodedError`.
"""

from __future__ import annotations

import asyncio
import copy
import threading
from typing import Any, Callable, Dict, Optional

import rospy
from geometry_msgs.msg import Point
from vb_msgs.msg import StudyEvent, VirtualBorder
from vb_msgs.srv import AddBorder, ConfirmMap, RemoveBorder, RenameBorder, SendRobot, SetBorderEnabled, UndoRedo
from vb_msgs.srv import UpdateBorder

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import services
from vb_core.ros.commands import CommandSender
from vb_core.ros.messages import mapping_from_values
from vb_core.ros.preview_service import PreviewBorderArray
from vb_web.action_requests import Request
from vb_web.ros_view import apply_draft, issues_section, region_uri
from vb_web.view import rounded

# [s] a preview of 16 million cells takes half a second on a busy computer
_TIMEOUT = 20.0
_INTEGRATOR = "$map_integrator"
_MONITOR = "$robot_monitor"
_UNREACHED = ("no_service", "no_response")


class ActionHandler:
    """Carries out requests; thread safe.

    Args:
        borders: returns the stored border of an id, or None.
        manager_there: whether there is an interaction manager; robots_there: whether there is a robot's driver.
        on_study: receives the operator's marks.
        invite: returns what a phone needs to log in.
    """

    def __init__(
        self,
        borders: Callable[[str], Optional[VirtualBorder]],
        manager_there: Callable[[], bool],
        robots_there: Callable[[], bool],
        on_study: Callable[[StudyEvent], None],
        invite: Callable[[], Dict[str, Any]],
    ) -> None:
        self._borders, self._manager_there, self._robots_there = borders, manager_there, robots_there
        self._on_study, self._give_invitation = on_study, invite
        self._lock = threading.Lock()
        self.participant, self.condition = "", ""
        self._orders = CommandSender("page", self._on_answer)
        self._orders.connect()
        self._study_out = rospy.Publisher(names.STUDY_EVENTS, StudyEvent, queue_size=50)

    def carry_out(self, request: Request, source: str) -> Dict[str, Any]:
        """Carries out a request and returns its answer.

        Raises:
            CodedError: if it was not carried out.
        """
        return getattr(self, f"_{request.action}")(request, source)

    # ------------------------------------------------------------- commands
    async def command(self, request: Request, source: str) -> Dict[str, Any]:
        """Carries out a command, without a thread of its own.

        Raises:
            CodedError: if it was not carried out.
        """
        command, loop = request.values["command"], asyncio.get_event_loop()
        if command in ("undo", "redo") and not self._manager_there():
            return await loop.run_in_executor(None, self._undo_or_redo, request)
        answered = loop.create_future()
        # the browser's id: a request repeated after the page was restarted is carried out once
        if not self._orders.put(
            command,
            answered,
            given=request.arrived - request.values["age"],
            source=source,
            seen_stop=request.values["seen_stop"],
            identity=request.id,
        ):
            raise CodedError("page_too_fast")
        answer, error = await answered
        if error is None:
            return _answer(answer)
        if command != "stop" or error.code not in _UNREACHED:
            raise error
        # robots that heard it keep it, and tell the manager once it is running
        if not self._robots_there():
            raise CodedError("page_stop_unheard") from error
        return {"ok": True, "code": "page_stop_sent", "values": {}, "message": ""}

    @staticmethod
    def _on_answer(_request: Any, answered: Any, *answer: Any) -> None:
        answered.get_loop().call_soon_threadsafe(answered.set_result, answer)

    @staticmethod
    def _undo_or_redo(request: Request) -> Dict[str, Any]:
        name = names.UNDO if request.values["command"] == "undo" else names.REDO
        return _answer(_call(name, UndoRedo, request_id=request.id))

    # ------------------------------------------------------------- borders
    def _stored(self, border_id: str) -> VirtualBorder:
        border = self._borders(border_id)
        if border is None:
            raise CodedError("page_no_border")
        return copy.deepcopy(border)

    def _preview(self, request: Request, _source: str) -> Dict[str, Any]:
        known = request.values["border"]
        border = apply_draft(request.values["draft"], self._stored(known) if known else VirtualBorder(enabled=True))
        response = _call(names.PREVIEW_BORDER, PreviewBorderArray, border=border, frame_id=names.MAP_FRAME)
        return {
            **_answer(response),
            "area": rounded(response.area_m2, 2),
            "parts": int(response.free_parts),
            "region": region_uri(response.region) if response.success else "",
        }

    def _add(self, request: Request, source: str) -> Dict[str, Any]:
        border = apply_draft(request.values["draft"], VirtualBorder(enabled=True, occupancy=1.0))
        fields = {"border": border, "frame_id": names.MAP_FRAME, "source": source, "request_id": request.id}
        response = _call(names.ADD_BORDER, AddBorder, **fields)
        return {**_answer(response), "border": response.id}

    def _update(self, request: Request, source: str) -> Dict[str, Any]:
        border = apply_draft(request.values["draft"], self._stored(request.values["border"]))
        return self._change(names.UPDATE_BORDER, UpdateBorder, request, source, border=border, frame_id=names.MAP_FRAME)

    def _rename(self, request: Request, source: str) -> Dict[str, Any]:
        return self._change(names.RENAME_BORDER, RenameBorder, request, source, name=request.values["name"])

    def _enable(self, request: Request, source: str) -> Dict[str, Any]:
        enabled = request.values["enabled"]
        return self._change(names.SET_BORDER_ENABLED, SetBorderEnabled, request, source, enabled=enabled)

    def _remove(self, request: Request, source: str) -> Dict[str, Any]:
        return self._change(names.REMOVE_BORDER, RemoveBorder, request, source)

    def _change(self, which: str, service: Any, request: Request, source: str, **fields: Any) -> Dict[str, Any]:
        stored = self._stored(request.values["border"])  # only ids that are there get through
        if "border" not in fields:
            fields["id"] = stored.id
        return _answer(_call(which, service, source=source, expected_revision=request.values["revision"], **fields))

    def _confirm_map(self, request: Request, source: str) -> Dict[str, Any]:
        places = ConfirmMap._request_class
        answer = places.SAME_PLACE if request.values["same"] else places.OTHER_PLACE
        fields = {"answer": answer, "source": source, "map_id": request.values["map_id"]}
        return _answer(_call(names.CONFIRM_MAP, ConfirmMap, **fields))

    # ------------------------------------------------------------- robots
    def _send(self, request: Request, _source: str) -> Dict[str, Any]:
        goal = Point(*request.values["goal"], 0.0)
        return _answer(_call(names.SEND_ROBOT, SendRobot, _MONITOR, robot=request.values["robot"], goal=goal))

    def _halt(self, request: Request, _source: str) -> Dict[str, Any]:
        return _answer(_call(names.SEND_ROBOT, SendRobot, _MONITOR, robot=request.values["robot"], halt=True))

    # ------------------------------------------------------------- study
    def _study(self, request: Request, source: str) -> Dict[str, Any]:
        with self._lock:
            self.participant, self.condition = request.values["participant"], request.values["condition"]
        return self._record("study", "", source)

    def _mark(self, request: Request, source: str) -> Dict[str, Any]:
        return self._record("mark", request.values["text"], source)

    def _record(self, kind: str, text: str, source: str) -> Dict[str, Any]:
        with self._lock:
            event = StudyEvent(
                kind=kind, participant=self.participant, condition=self.condition, text=text, source=source
            )
        event.header.stamp = rospy.Time.now()
        self._study_out.publish(event)
        self._on_study(event)
        return {"ok": True, "code": "page_noted", "values": {}, "message": ""}

    def _invite(self, _request: Request, _source: str) -> Dict[str, Any]:
        return {"ok": True, "code": "ok", "values": {}, "message": "", **self._give_invitation()}


def _call(which: str, service: Any, who: str = _INTEGRATOR, **fields: Any) -> Any:
    """Calls a service with a request of these fields."""
    return services.call(which, service, service._request_class(**fields), who, response_timeout=_TIMEOUT)


def _answer(response: Any) -> Dict[str, Any]:
    found: Dict[str, Any] = {
        "ok": bool(response.success),
        "code": response.code or ("ok" if response.success else "page_not_done"),
        "values": mapping_from_values(response.values),
        "message": response.message,
    }
    if hasattr(response, "issues"):
        found["issues"] = issues_section(response.issues)
    return found
