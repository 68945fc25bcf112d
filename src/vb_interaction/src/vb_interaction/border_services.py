"""Calls the services of border_fusion and map_integrator on the way of a drawn border to the map."""

from __future__ import annotations

from typing import Any, Dict, Tuple, Type

from vb_core import names
from vb_core.errors import CodedError
from vb_core.interaction_tables import REDO
from vb_core.ros import services
from vb_core.ros.messages import mapping_from_values
from vb_core.ros.preview_service import PreviewBorderArray, PreviewBorderArrayResponse
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import AddBorder, GetDrawnBorder, ListBorders, UndoRedo

# in wall time, as a person waits; extraction and integration take well under 1 s unless the machine is busy
SERVICE_TIMEOUT = 2.0  # [s] until the service exists
RESPONSE_TIMEOUT = 5.0  # [s] until the service has answered


class BorderServices:
    """Fetches the drawn border, previews it and adds it to the map. Each call has a timeout.

    Args:
        occupancy: 0 .. 1, occupancy of every border.

    Every method raises CodedError: "no_service" if the service is absent (nothing was sent), "no_response" if it
    did not answer (the request may or may not have been carried out), or the service's own error.
    """

    def __init__(self, occupancy: float) -> None:
        self._occupancy = occupancy

    def fetch_drawn_border(self, interaction_id: str) -> VirtualBorder:
        """Fetches the border as drawn, ready to be added."""
        drawn = self._call(names.GET_DRAWN_BORDER, GetDrawnBorder, "border_fusion", interaction_id=interaction_id)
        border = _checked(drawn).border
        border.occupancy = self._occupancy
        border.enabled = True
        return border

    def add(self, border: VirtualBorder, source: str, interaction_id: str) -> str:
        """Adds the border of an interaction to the map and returns its id. However often it is sent, it is added once."""
        fields = {"frame_id": names.MAP_FRAME, "source": source, "request_id": interaction_id}
        return _checked(self._call(names.ADD_BORDER, AddBorder, border=border, **fields)).id

    def change(self, command: str, request_id: str) -> None:
        """Undoes the newest change of the borders ("undo") or redoes it ("redo"), once for each request id."""
        _checked(self._call(names.UNDO_REDO, UndoRedo, redo=command == REDO, request_id=request_id))

    def fetch_borders(self) -> Dict[str, VirtualBorder]:
        """Fetches all borders, by their ids."""
        return {border.id: border for border in self._call(names.LIST_BORDERS, ListBorders).borders.borders}

    def preview(self, interaction_id: str) -> Tuple[VirtualBorder, PreviewBorderArrayResponse]:
        """Fetches the border as drawn, and asks what adding it would do. A refusal to add it is in the response."""
        border = self.fetch_drawn_border(interaction_id)
        answer = self._call(names.PREVIEW_BORDER, PreviewBorderArray, border=border, frame_id=names.MAP_FRAME)
        return border, answer

    @staticmethod
    def _call(name: str, service: Type, answering_node: str = "map_integrator", **fields: Any) -> Any:
        request = service._request_class(**fields)
        return services.call(name, service, request, {"who_code": answering_node}, SERVICE_TIMEOUT, RESPONSE_TIMEOUT)


def _checked(response: Any) -> Any:
    """Returns a response that reports success. Raises the service's own error otherwise."""
    if not response.success:
        raise CodedError(response.code, response.message, **mapping_from_values(response.values))
    return response
