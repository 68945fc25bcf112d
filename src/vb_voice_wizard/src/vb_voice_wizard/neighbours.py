"""What the interaction manager asks of border_fusion and map_integrator, each within a known time."""
from __future__ import annotations

from typing import Any, Type

from vb_core import names
from vb_core.errors import CodedError
from vb_core.ros import messages, services
from vb_msgs.msg import VirtualBorder
from vb_msgs.srv import AddBorder, AddBorderRequest, GetCandidate, GetCandidateRequest, PreviewBorderRequest

UNANSWERED = ("no_service", "no_answer")  # codes of a neighbour that is away; any other is its own refusal


class Neighbours:
    """Asks the neighbours.

    Args:
        border_name, occupancy: of every border.
        wait_s, answer_s: [s] wall time, how long a neighbour that is away, and its answer, are waited for.

    Every method raises CodedError: "no_service" if the neighbour is away (nothing was sent), "no_answer" if it
    did not answer (the request may have been done or not), or the neighbour's own refusal.
    """

    def __init__(self, border_name: str, occupancy: float, wait_s: float, answer_s: float) -> None:
        self._border_name = border_name
        self._occupancy = occupancy
        self._wait_s = wait_s
        self._answer_s = answer_s

    def candidate(self, interaction_id: str) -> VirtualBorder:
        """The border as drawn, ready to be added."""
        request = GetCandidateRequest(interaction_id=interaction_id)
        response = self._ask(names.CANDIDATE, GetCandidate, request, "The border fusion")
        if not response.success:
            raise CodedError(response.code, response.message)
        border = response.border
        border.id = ""
        border.name = self._border_name
        border.occupancy = self._occupancy
        border.enabled = True
        return border

    def add(self, border: VirtualBorder, source: str) -> str:
        """Adds the border to the map; gives its id."""
        request = AddBorderRequest(border=border, frame_id=names.MAP_FRAME, source=source)
        response = self._ask(names.ADD_BORDER, AddBorder, request, "The map integrator")
        if not response.success:
            raise CodedError(response.code, response.message)
        return response.id

    def preview(self, border: VirtualBorder) -> messages.PreviewBorderArrayResponse:
        """What adding the border would do; a refusal is in the response."""
        request = PreviewBorderRequest(border=border, frame_id=names.MAP_FRAME)
        return self._ask(names.PREVIEW_BORDER, messages.PreviewBorderArray, request, "The map integrator")

    def _ask(self, name: str, service: Type, request: Any, who: str) -> Any:
        return services.call(name, service, request, who, self._wait_s, self._answer_s)
