"""Carries out what the page asks for, by the services of interaction manager and map integrator. Needs a node.

The idea: one table from action to method; each returns an answer with code and values, or raises a `CodedError`.
"""

from __future__ import annotations

import copy
import threading
from typing import Any, Callable, Dict, Optional

import rospy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger, TriggerRequest
from vb_msgs.msg import StudyEvent, VirtualBorder
from vb_msgs.srv import (
    AddBorder,
    AddBorderRequest,
    ConfirmMap,
    ConfirmMapRequest,
    PreviewBorderRequest,
    RemoveBorder,
    RemoveBorderRequest,
    RenameBorder,
    RenameBorderRequest,
    SetBorderEnabled,
    SetBorderEnabledRequest,
    UpdateBorder,
    UpdateBorderRequest,
)

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import services
from vb_core.ros.commands import make_request, send
from vb_core.ros.messages import mapping_from_values
from vb_core.ros.preview_service import PreviewBorderArray
from vb_web.action_requests import Request
from vb_web.ros_view import apply_draft, issues_section, region_uri
from vb_web.view import rounded

# [s] a command that waited longer than this for a busy manager surprises people: it is not carried out any more
COMMAND_VALIDITY = 5.0
# [s] a preview of 16 million cells takes half a second on a busy computer
_TIMEOUT = 20.0
_INTEGRATOR = "$map_integrator"
_SENT = {"stop": "page_stop_sent", "resume": "page_resume_sent"}
_UNREACHED = ("no_service", "no_response")


class ActionHandler:
    """Carries out requests; thread safe.

    Args:
        borders: returns the stored border of an id, or None.
        manager_there: whether there is an interaction manager.
        on_study: receives the operator's marks.
        invite: returns what a phone needs to log in.
    """

    def __init__(
        self,
        borders: Callable[[str], Optional[VirtualBorder]],
        manager_there: Callable[[], bool],
        on_study: Callable[[StudyEvent], None],
        invite: Callable[[], Dict[str, Any]],
    ) -> None:
        self._borders, self._manager_there, self._on_study, self._give_invitation = (
            borders,
            manager_there,
            on_study,
            invite,
        )
        self._lock = threading.Lock()
        self.participant, self.condition = "", ""
        self._stop = rospy.Publisher(names.STOP, Bool, queue_size=5)
        self._unheard_stop = ""  # who pressed stop while the manager was away
        self._study_out = rospy.Publisher(names.STUDY_EVENTS, StudyEvent, queue_size=50)

    def carry_out(self, request: Request, source: str) -> Dict[str, Any]:
        """Carries out a request and returns its answer.

        Raises:
            CodedError: if it was not carried out.
        """
        return getattr(self, f"_{request.action}")(request, source)

    # ------------------------------------------------------------- commands
    def _command(self, request: Request, source: str) -> Dict[str, Any]:
        command = request.values["command"]
        if command in ("stop", "resume"):
            self._unheard_stop = ""
        if command == "stop":
            # robots hear this themselves: it works without any other node
            self._stop.publish(Bool(True))
        elif command in ("undo", "redo") and not self._manager_there():
            return self._trigger(names.UNDO if command == "undo" else names.REDO)
        wanted = make_request(command, source, COMMAND_VALIDITY)
        wanted.id = request.id  # the browser's: a request repeated after the page was restarted is carried out once
        try:
            return _answer(send(wanted))
        except CodedError as error:
            if command in ("stop", "resume") and error.code in _UNREACHED:
                if command == "stop":
                    self._unheard_stop = source
                else:
                    # not before: a manager that hears this and the command would be told to resume twice
                    self._stop.publish(Bool(False))
                return {"ok": True, "code": _SENT[command], "values": {}, "message": ""}
            raise

    def repeat_stop(self) -> None:
        """Repeats a stop that only the robots received to the manager, once it is running, so that displays show it."""
        source = self._unheard_stop
        if source and self._manager_there():
            try:
                send(make_request("stop", source, COMMAND_VALIDITY))
            except CodedError:
                return  # asked again at the next call
            self._unheard_stop = ""

    @staticmethod
    def _trigger(name: str) -> Dict[str, Any]:
        response = services.call(name, Trigger, TriggerRequest(), _INTEGRATOR)
        code = "page_done" if response.success else "page_not_done"
        return {
            "ok": response.success,
            "code": code,
            "values": {"reason": response.message},
            "message": response.message,
        }

    # ------------------------------------------------------------- borders
    def _stored(self, border_id: str) -> VirtualBorder:
        border = self._borders(border_id)
        if border is None:
            raise CodedError("page_no_border")
        return copy.deepcopy(border)

    def _preview(self, request: Request, _source: str) -> Dict[str, Any]:
        known = request.values["border"]
        border = apply_draft(request.values["draft"], self._stored(known) if known else VirtualBorder(enabled=True))
        wanted = PreviewBorderRequest(border=border, frame_id=names.MAP_FRAME)
        response = services.call(
            names.PREVIEW_BORDER, PreviewBorderArray, wanted, _INTEGRATOR, response_timeout=_TIMEOUT
        )
        return {
            **_answer(response),
            "area": rounded(response.area_m2, 2),
            "parts": int(response.free_parts),
            "region": region_uri(response.region) if response.success else "",
        }

    def _add(self, request: Request, source: str) -> Dict[str, Any]:
        border = apply_draft(request.values["draft"], VirtualBorder(enabled=True, occupancy=1.0))
        wanted = AddBorderRequest(border=border, frame_id=names.MAP_FRAME, source=source, request_id=request.id)
        response = services.call(names.ADD_BORDER, AddBorder, wanted, _INTEGRATOR, response_timeout=_TIMEOUT)
        return {**_answer(response), "border": response.id}

    def _update(self, request: Request, source: str) -> Dict[str, Any]:
        border = apply_draft(request.values["draft"], self._stored(request.values["border"]))
        wanted = UpdateBorderRequest(border=border, frame_id=names.MAP_FRAME)
        return self._change(names.UPDATE_BORDER, UpdateBorder, wanted, request, source)

    def _rename(self, request: Request, source: str) -> Dict[str, Any]:
        wanted = RenameBorderRequest(name=request.values["name"])
        return self._change(names.RENAME_BORDER, RenameBorder, wanted, request, source)

    def _enable(self, request: Request, source: str) -> Dict[str, Any]:
        wanted = SetBorderEnabledRequest(enabled=request.values["enabled"])
        return self._change(names.SET_BORDER_ENABLED, SetBorderEnabled, wanted, request, source)

    def _remove(self, request: Request, source: str) -> Dict[str, Any]:
        return self._change(names.REMOVE_BORDER, RemoveBorder, RemoveBorderRequest(), request, source)

    def _change(self, name: str, service: Any, wanted: Any, request: Request, source: str) -> Dict[str, Any]:
        stored = self._stored(request.values["border"])  # only ids that are there get through
        if hasattr(wanted, "id"):
            wanted.id = stored.id
        wanted.source, wanted.expected_revision = source, request.values["revision"]
        return _answer(services.call(name, service, wanted, _INTEGRATOR, response_timeout=_TIMEOUT))

    def _confirm_map(self, request: Request, source: str) -> Dict[str, Any]:
        answer = ConfirmMapRequest.SAME_PLACE if request.values["same"] else ConfirmMapRequest.OTHER_PLACE
        wanted = ConfirmMapRequest(answer=answer, source=source)
        return _answer(services.call(names.CONFIRM_MAP, ConfirmMap, wanted, _INTEGRATOR, response_timeout=_TIMEOUT))

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
