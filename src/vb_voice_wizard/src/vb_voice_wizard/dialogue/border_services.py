"""Calls the services of border_fusion and map_integrator for the interaction manager, each with a timeout."""

from __future__ import annotations

from typing import Any, Dict, Type

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import messages, services
from vb_core.ros.preview_service import PreviewBorderArray, PreviewBorderArrayResponse
from vb_core.vocabulary import REDO
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import AddBorder, GetDrawnBorder, ListBorders, UndoRedo

# [s] wall time: a person waits, a busy machine is slow; extraction and integration take well under 1 s
SERVICE_TIMEOUT, RESPONSE_TIMEOUT = 2.0, 5.0


class BorderServices:
    """Calls the services.

    Args:
        occupancy: of every border.

    Every method raises CodedError: "no_service" if the service is absent (nothing was sent), "no_response" if it
    did not answer (the request may or may not have been carried out), or the service's own error.
    """

    def __init__(self, occupancy: float) -> None:
        self._occupancy = occupancy

    def fetch_drawn_border(self, interaction_id: str) -> VirtualBorder:
        """Fetches the border as drawn, ready to be added."""
        drawn = self._ask(names.GET_DRAWN_BORDER, GetDrawnBorder, "$border_fusion", interaction_id=interaction_id)
        border = _checked(drawn).border
        border.id = ""
        border.occupancy = self._occupancy
        border.enabled = True
        return border

    def add(self, border: VirtualBorder, source: str, interaction_id: str) -> str:
        """Adds the border of an interaction to the map, once, however often it is sent; returns its id."""
        more = {"frame_id": names.MAP_FRAME, "source": source, "request_id": interaction_id}
        return _checked(self._ask(names.ADD_BORDER, AddBorder, border=border, **more)).id

    def change(self, command: str, request_id: str) -> None:
        """Undoes the newest change of the borders ("undo"), or redoes it ("redo"); once, however often it is sent."""
        _checked(self._ask(names.UNDO_REDO, UndoRedo, redo=command == REDO, request_id=request_id))

    def fetch_borders(self) -> Dict[str, VirtualBorder]:
        """Fetches all borders, by their ids."""
        return {border.id: border for border in self._ask(names.LIST_BORDERS, ListBorders).borders.borders}

    def preview(self, border: VirtualBorder) -> PreviewBorderArrayResponse:
        """Asks what adding the border would do; an error is in the response."""
        return self._ask(names.PREVIEW_BORDER, PreviewBorderArray, border=border, frame_id=names.MAP_FRAME)

    def _ask(self, name: str, service: Type, who: str = "$map_integrator", **fields: Any) -> Any:
        return services.call(name, service, service._request_class(**fields), who, SERVICE_TIMEOUT, RESPONSE_TIMEOUT)


def _checked(response: Any) -> Any:
    """Returns a response that reports success; raises the service's own error otherwise."""
    if not response.success:
        raise CodedError(response.code, response.message, **messages.mapping_from_values(response.values))
    return response
