"""Calls the services of border_fusion and map_integrator that bring a drawn border into the map."""

from __future__ import annotations

from typing import Any, Dict, Tuple, Type

from vb_core import names
from vb_core.errors import CodedError
from vb_core.interaction_tables import REDO
from vb_core.ros import services
from vb_core.ros.messages import mapping_from_values
from vb_core.ros.preview_service import NumpyPreviewBorder, NumpyPreviewBorderResponse
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import AddBorder, GetDrawnBorder, ListBorders, UndoRedo

# in wall time, because a person waits; extraction and integration take much less than 1 s on a computer that is not busy
SERVICE_TIMEOUT = 2.0  # [s] until the service exists
RESPONSE_TIMEOUT = 5.0  # [s] until the service has answered


class BorderServices:
    """Fetches the drawn border, previews it and adds it to the map. Each call has a timeout.

    Args:
        occupancy: 0 .. 1, occupancy of every border.

    Every method raises CodedError: "no_service" if there is no such service (and nothing was sent), "no_response" if it
    did not answer (the request may have been carried out or not), or the error that the service reports.
    """

    def __init__(self, occupancy: float) -> None:
        self._occupancy = occupancy

    def fetch_drawn_border(self, interaction_id: str) -> VirtualBorder:
        """Fetches the border as drawn, ready to be added."""
        drawn = self._call(names.GET_DRAWN_BORDER, GetDrawnBorder, "border_fusion", interaction_id=interaction_id)
        border = _require_success(drawn).border
        border.occupancy = self._occupancy
        border.enabled = True
        return border

    def add(self, border: VirtualBorder, source: str, interaction_id: str) -> str:
        """Adds the border of an interaction to the map, only once even if called again. Returns the border's id."""
        fields = {"frame_id": names.MAP_FRAME, "source": source, "request_id": interaction_id}
        response = self._call(names.ADD_BORDER, AddBorder, border=border, **fields)
        return _require_success(response).id

    def change(self, command: str, request_id: str) -> None:
        """Undoes the newest change of the borders ("undo") or redoes it ("redo"), only once for each request id."""
        _require_success(self._call(names.UNDO_REDO, UndoRedo, redo=command == REDO, request_id=request_id))

    def fetch_borders(self) -> Dict[str, VirtualBorder]:
        """Fetches all borders, by their ids."""
        response = self._call(names.LIST_BORDERS, ListBorders)
        return {border.id: border for border in response.borders.borders}

    def preview(self, interaction_id: str) -> Tuple[VirtualBorder, NumpyPreviewBorderResponse]:
        """Fetches the border as drawn, and asks what adding it would do. If it would be refused, the response says so."""
        border = self.fetch_drawn_border(interaction_id)
        answer = self._call(names.PREVIEW_BORDER, NumpyPreviewBorder, border=border, frame_id=names.MAP_FRAME)
        return border, answer

    @staticmethod
    def _call(name: str, service: Type, answering_node: str = "map_integrator", **fields: Any) -> Any:
        request = service._request_class(**fields)
        return services.call(name, service, request, {"who_code": answering_node}, SERVICE_TIMEOUT, RESPONSE_TIMEOUT)


def _require_success(response: Any) -> Any:
    """Returns the response if it reports success. Otherwise raises the error that it reports."""
    if not response.success:
        raise CodedError(response.code, response.message, **mapping_from_values(response.values))
    return response
