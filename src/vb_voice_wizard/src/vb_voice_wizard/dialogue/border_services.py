"""Calls the services of border_fusion and map_integrator for the interaction manager, each within a known time."""

from __future__ import annotations

from typing import Any, Dict, Type

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import messages, services
from vb_core.ros.preview_service import PreviewBorderArray, PreviewBorderArrayResponse
from vb_core.vocabulary import REDO
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import (
    AddBorder,
    AddBorderRequest,
    GetDrawnBorder,
    GetDrawnBorderRequest,
    ListBorders,
    ListBordersRequest,
    PreviewBorderRequest,
    UndoRedo,
    UndoRedoRequest,
)


_INTEGRATOR = "$map_integrator"

UNANSWERED = ("no_service", "no_response")  # codes of an absent service; any other is its own error


class BorderServices:
    """Calls the services.

    Args:
        occupancy: of every border.
        service_timeout, response_timeout: [s] wall time, how long to wait for an absent service, and for its answer.

    Every method raises CodedError: "no_service" if the service is absent (nothing was sent), "no_response" if it
    did not answer (the request may have been done or not), or the service's own error.
    """

    def __init__(self, occupancy: float, service_timeout: float, response_timeout: float) -> None:
        self._occupancy = occupancy
        self._service_timeout = service_timeout
        self._response_timeout = response_timeout

    def fetch_drawn_border(self, interaction_id: str) -> VirtualBorder:
        """Fetches the border as drawn, ready to be added."""
        request = GetDrawnBorderRequest(interaction_id=interaction_id)
        response = self._ask(names.GET_DRAWN_BORDER, GetDrawnBorder, request, "$border_fusion")
        _check(response)
        border = response.border
        border.id = ""
        border.occupancy = self._occupancy
        border.enabled = True
        return border

    def add(self, border: VirtualBorder, source: str, interaction_id: str) -> str:
        """Adds the border of an interaction to the map, once however often it is sent; returns its id."""
        request = AddBorderRequest(border=border, frame_id=names.MAP_FRAME, source=source, request_id=interaction_id)
        response = self._ask(names.ADD_BORDER, AddBorder, request, _INTEGRATOR)
        _check(response)
        return response.id

    def change(self, command: str, request_id: str) -> None:
        """Undoes the newest change of the borders ("undo"), or makes it again ("redo"); once however often it is sent."""
        request = UndoRedoRequest(redo=command == REDO, request_id=request_id)
        _check(self._ask(names.UNDO_REDO, UndoRedo, request, _INTEGRATOR))

    def fetch_borders(self) -> Dict[str, VirtualBorder]:
        """Fetches all borders, by their ids."""
        response = self._ask(names.LIST_BORDERS, ListBorders, ListBordersRequest(), _INTEGRATOR)
        return {border.id: border for border in response.borders.borders}

    def preview(self, border: VirtualBorder) -> PreviewBorderArrayResponse:
        """Asks what adding the border would do; an error is in the response."""
        request = PreviewBorderRequest(border=border, frame_id=names.MAP_FRAME)
        return self._ask(names.PREVIEW_BORDER, PreviewBorderArray, request, _INTEGRATOR)

    def _ask(self, name: str, service: Type, request: Any, who: str) -> Any:
        return services.call(name, service, request, who, self._service_timeout, self._response_timeout)


def _check(response: Any) -> None:
    if not response.success:
        raise CodedError(response.code, response.message, **messages.mapping_from_values(response.values))
