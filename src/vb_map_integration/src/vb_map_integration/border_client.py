"""What all other input methods do with a border: preview, then commit, by the map integrator's services."""

from __future__ import annotations

from typing import Any, NamedTuple, Tuple, Type
from uuid import uuid4

from std_srvs.srv import Trigger, TriggerRequest
from vb_msgs.srv import (
    AddBorder,
    AddBorderRequest,
    PreviewBorderRequest,
    RemoveBorder,
    RemoveBorderRequest,
    SetBorderEnabled,
    SetBorderEnabledRequest,
    UpdateBorder,
    UpdateBorderRequest,
)

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import services
from vb_core.ros.preview_service import PreviewBorderArray
from vb_map_integration.border import VirtualBorder
from vb_map_integration.borders.border_messages import issues_from_messages, message_from_border
from vb_map_integration.borders.issues import Issue

# [s] a preview of 16 million cells takes half a second on a busy computer
_TIMEOUT = 20.0


class ServiceResult(NamedTuple):
    """The map integrator's answer; an absent service counts as a failure too.

    Attributes:
        success, code, message: as in the services.
        issues: of the check.
        id: of the border.
        area_m2: [m^2] that it restricts, if requested.
    """

    success: bool
    code: str
    message: str
    issues: Tuple[Issue, ...] = ()
    id: str = ""
    area_m2: float = 0.0


class BorderClient:
    """Calls the map integrator.

    Args:
        source: who asks, for the records.
        frame_id: of the borders' points.
    """

    def __init__(self, source: str, frame_id: str = names.MAP_FRAME) -> None:
        self._source = source
        self._frame_id = frame_id

    def preview(self, border: VirtualBorder) -> ServiceResult:
        """Asks what saving would do; changes nothing."""
        message = message_from_border(border)
        request = PreviewBorderRequest(border=message, frame_id=self._frame_id)
        return self._call(names.PREVIEW_BORDER, PreviewBorderArray, request)

    def save(self, border: VirtualBorder, revision: int = 0) -> ServiceResult:
        """Previews, and if that finds no error, adds the border or, if it has an id, replaces the stored one.

        Args:
            revision: of the borders that the person saw when editing; it fails if there is another one. 0: any.
        """
        checked = self.preview(border)
        if not checked.success:
            return checked
        if border.id:
            return self.update(border, revision)._replace(id=border.id, area_m2=checked.area_m2)
        message = message_from_border(border)
        request = AddBorderRequest(
            border=message,
            frame_id=self._frame_id,
            source=self._source,
            request_id=str(uuid4()),
            disabled=not border.enabled,
            expected_revision=revision,
        )
        return self._call(names.ADD_BORDER, AddBorder, request)._replace(area_m2=checked.area_m2)

    def update(self, border: VirtualBorder, revision: int = 0) -> ServiceResult:
        """Replaces the stored border of the same id."""
        message = message_from_border(border)
        request = UpdateBorderRequest(
            border=message, frame_id=self._frame_id, source=self._source, expected_revision=revision
        )
        return self._call(names.UPDATE_BORDER, UpdateBorder, request)

    def set_enabled(self, border_id: str, enabled: bool, revision: int = 0) -> ServiceResult:
        """Switches a border on or off."""
        request = SetBorderEnabledRequest(border_id, enabled, self._source, revision)
        return self._call(names.SET_BORDER_ENABLED, SetBorderEnabled, request)

    def remove(self, border_id: str, revision: int = 0) -> ServiceResult:
        """Removes a border."""
        request = RemoveBorderRequest(id=border_id, source=self._source, expected_revision=revision)
        return self._call(names.REMOVE_BORDER, RemoveBorder, request)

    def trigger(self, name: str) -> ServiceResult:
        """Calls undo, redo or clear."""
        return self._call(name, Trigger, TriggerRequest())

    def _call(self, name: str, service: Type, request: Any) -> ServiceResult:
        try:
            response = services.call(name, service, request, "the map integrator", response_timeout=_TIMEOUT)
        except CodedError as error:
            return ServiceResult(False, error.code, error.message)
        return ServiceResult(
            response.success,
            getattr(response, "code", ""),
            response.message,
            issues_from_messages(getattr(response, "issues", ())),
            getattr(response, "id", ""),
            getattr(response, "area_m2", 0.0),
        )
