"""Carries out the page's requests by calling interaction manager, map integrator and robot monitor. Needs a node.

Each action has a method of the same name, which returns the answer to the request, or raises a `CodedError`.
"""

from __future__ import annotations

import asyncio
import copy
from typing import Any, Callable, Dict, Mapping, Optional

from geometry_msgs.msg import Point
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import AddBorder, CommandRequest, ConfirmMap, RemoveBorder, RenameBorder, SendRobot
from vb_msgs.srv import SetBorderEnabled, UndoRedo, UpdateBorder

from vb_core import names
from vb_core.errors import CodedError
from vb_core.interaction_tables import REDO, UNDO
from vb_core.ros import services
from vb_core.ros.commands import CommandSender, send
from vb_core.ros.messages import mapping_from_values
from vb_core.ros.preview_service import NumpyPreviewBorder
from vb_web.action_parser import ActionRequest
from vb_web.page_messages import apply_draft, issues_section, region_uri
from vb_web.page_view import answer_from_error, make_answer, json_number

_TIMEOUT = 20.0  # [s] for an answer; on a busy computer, a preview of 16 million cells takes half a second
_MONITOR = {"who_code": "robot_monitor"}
_CHANGES = {  # services that change a stored border; their fields have the same names as those of the request
    "update": (names.UPDATE_BORDER, UpdateBorder),
    "rename": (names.RENAME_BORDER, RenameBorder),
    "enable": (names.SET_BORDER_ENABLED, SetBorderEnabled),
    "remove": (names.REMOVE_BORDER, RemoveBorder),
}


class ActionExecutor:
    """Carries out requests. Thread safe.

    Args:
        find_border: returns the stored border with an id, or None.
        has_manager: returns whether an interaction manager is connected.
        make_invitation: returns the addresses and codes with which a phone can log in.
    """

    def __init__(
        self,
        find_border: Callable[[str], Optional[VirtualBorder]],
        has_manager: Callable[[], bool],
        make_invitation: Callable[[], Dict[str, Any]],
    ) -> None:
        self._find_border = find_border
        self._has_manager = has_manager
        self._make_invitation = make_invitation
        self._command_sender = CommandSender("page", self._on_answer)

    def carry_out(self, request: ActionRequest, source: str) -> Dict[str, Any]:
        """Carries out a request and returns the answer. Raises a CodedError if it was not carried out."""
        return getattr(self, f"_{request.action}")(request, source)

    # ------------------------------------------------------------- commands
    def command(self, request: ActionRequest, source: str) -> "asyncio.Future[Dict[str, Any]]":
        """Starts to carry out a command. Returns a future of the answer in the calling thread's event loop."""
        command = request.values["command"]
        future = asyncio.get_event_loop().create_future()
        is_without_manager = command in (UNDO, REDO) and not self._has_manager()
        is_accepted = self._command_sender.submit(
            command,
            future,
            given_at=request.arrived - request.values["age"],
            source=source,
            seen_stop=request.values["seen_stop"],
            # chosen by the browser, so that a request that it repeats after a restart of this node is carried out once
            identity=request.id,
            carry_out=_undo_or_redo if is_without_manager else send,
        )
        if not is_accepted:
            future.set_result(answer_from_error(CodedError("page_too_fast")))
        return future

    def _on_answer(self, _request: Any, future: "asyncio.Future[Dict[str, Any]]", response: Any, error: Any) -> None:
        result = _answer(response) if error is None else answer_from_error(error)
        future.get_loop().call_soon_threadsafe(future.set_result, result)

    # ------------------------------------------------------------- borders
    def _copy_stored(self, border_id: str) -> VirtualBorder:
        border = self._find_border(border_id)
        if border is None:
            raise CodedError("page_no_border")
        return copy.deepcopy(border)

    def _preview(self, request: ActionRequest, _source: str) -> Dict[str, Any]:
        border_id = request.values["border"]
        stored = self._copy_stored(border_id) if border_id else VirtualBorder(enabled=True)
        border = apply_draft(request.values["draft"], stored)
        response = _call(names.PREVIEW_BORDER, NumpyPreviewBorder, border=border, frame_id=names.MAP_FRAME)
        return {
            **_answer(response),
            "area": json_number(response.area_m2, 2),
            "parts": int(response.free_parts),
            "region": region_uri(response.region) if response.success else "",
        }

    def _add(self, request: ActionRequest, source: str) -> Dict[str, Any]:
        border = apply_draft(request.values["draft"], VirtualBorder(enabled=True, occupancy=1.0))
        fields = {"border": border, "frame_id": names.MAP_FRAME, "source": source, "request_id": request.id}
        response = _call(names.ADD_BORDER, AddBorder, **fields)
        return {**_answer(response), "border": response.id}

    def _change(self, request: ActionRequest, source: str) -> Dict[str, Any]:
        fields = dict(request.values)
        stored = self._copy_stored(fields.pop("border"))
        if "draft" in fields:
            fields["border"] = apply_draft(fields.pop("draft"), stored)
            fields["frame_id"] = names.MAP_FRAME
        else:
            fields["id"] = stored.id
        revision = fields.pop("revision")
        service_name, service = _CHANGES[request.action]
        return _answer(_call(service_name, service, source=source, expected_revision=revision, **fields))

    _update = _rename = _enable = _remove = _change

    def _confirm_map(self, request: ActionRequest, source: str) -> Dict[str, Any]:
        same, other = ConfirmMap._request_class.SAME_PLACE, ConfirmMap._request_class.OTHER_PLACE
        fields = {"answer": same if request.values["same"] else other, "map_id": request.values["map_id"]}
        return _answer(_call(names.CONFIRM_MAP, ConfirmMap, source=source, **fields))

    # ------------------------------------------------------------- robots
    def _send(self, request: ActionRequest, _source: str) -> Dict[str, Any]:
        goal = Point(*request.values["goal"], 0.0)
        return _answer(_call(names.SEND_ROBOT, SendRobot, _MONITOR, robot=request.values["robot"], goal=goal))

    def _halt(self, request: ActionRequest, _source: str) -> Dict[str, Any]:
        return _answer(_call(names.SEND_ROBOT, SendRobot, _MONITOR, robot=request.values["robot"], halt=True))

    def _invite(self, _request: ActionRequest, _source: str) -> Dict[str, Any]:
        return {**make_answer("ok", True, {}, ""), **self._make_invitation()}


def _call(
    service_name: str, service: Any, answering_node: Mapping[str, str] = services.INTEGRATOR, **fields: Any
) -> Any:
    """Calls a service with a request that has these fields."""
    request = service._request_class(**fields)
    return services.call(service_name, service, request, answering_node, response_timeout=_TIMEOUT)


def _undo_or_redo(request: CommandRequest) -> Any:
    return _call(names.UNDO_REDO, UndoRedo, redo=request.command == REDO, request_id=request.id)


def _answer(response: Any) -> Dict[str, Any]:
    code = response.code or ("ok" if response.success else "page_not_done")
    result = make_answer(code, bool(response.success), mapping_from_values(response.values), response.message)
    if hasattr(response, "issues"):
        result["issues"] = issues_section(response.issues)
    return result
