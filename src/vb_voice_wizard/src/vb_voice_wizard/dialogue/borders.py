"""Passes the drawn border on: fetches it, shows what saving would do before anyone says "save", and has it added."""

from __future__ import annotations

import dataclasses
import threading
import time
from typing import Any, Callable, Dict, List, Optional, Type

import numpy as np
import rospy
from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_core.ros import node, services
from vb_core.ros.messages import BorderPreviewArray, array_from_points, mapping_from_values, values_from_mapping
from vb_core.ros.preview_service import PreviewBorderArray, PreviewBorderArrayResponse
from vb_core.vocabulary import REDO
from vb_msgs.msg import BorderIssue, BorderProgress, VirtualBorder, VirtualBorderArray
from vb_msgs.srv import AddBorder, GetDrawnBorder, ListBorders, UndoRedo

from vb_voice_wizard.dialogue.preview_scheduler import DrawingWarnings, PreviewInputs, PreviewScheduler, to_key

# [s] wall time: a person waits, a busy machine is slow; extraction and integration take well under 1 s
SERVICE_TIMEOUT, RESPONSE_TIMEOUT = 2.0, 5.0


class BorderServices:
    """Calls the services of border_fusion and map_integrator, each with a timeout.

    Args:
        occupancy: occupancy of every border.

    Every method raises CodedError: "no_service" if the service is absent (nothing was sent), "no_response" if it
    did not answer (the request may or may not have been carried out), or the service's own error.
    """

    def __init__(self, occupancy: float) -> None:
        self._occupancy = occupancy

    def fetch_drawn_border(self, interaction_id: str) -> VirtualBorder:
        """Fetches the border as drawn, ready to be added."""
        drawn = self._call(names.GET_DRAWN_BORDER, GetDrawnBorder, "$border_fusion", interaction_id=interaction_id)
        border = _checked(drawn).border
        border.id = ""
        border.occupancy = self._occupancy
        border.enabled = True
        return border

    def add(self, border: VirtualBorder, source: str, interaction_id: str) -> str:
        """Adds the border of an interaction to the map, once, however often it is sent; returns its id."""
        fields = {"frame_id": names.MAP_FRAME, "source": source, "request_id": interaction_id}
        return _checked(self._call(names.ADD_BORDER, AddBorder, border=border, **fields)).id

    def change(self, command: str, request_id: str) -> None:
        """Undoes the newest change of the borders ("undo"), or redoes it ("redo"); once, however often it is sent."""
        _checked(self._call(names.UNDO_REDO, UndoRedo, redo=command == REDO, request_id=request_id))

    def fetch_borders(self) -> Dict[str, VirtualBorder]:
        """Fetches all borders, by their ids."""
        return {border.id: border for border in self._call(names.LIST_BORDERS, ListBorders).borders.borders}

    def preview(self, border: VirtualBorder) -> PreviewBorderArrayResponse:
        """Asks what adding the border would do; an error is in the response."""
        return self._call(names.PREVIEW_BORDER, PreviewBorderArray, border=border, frame_id=names.MAP_FRAME)

    def _call(self, name: str, service: Type, answering_node: str = "$map_integrator", **fields: Any) -> Any:
        return services.call(
            name, service, service._request_class(**fields), answering_node, SERVICE_TIMEOUT, RESPONSE_TIMEOUT
        )


def _checked(response: Any) -> Any:
    """Returns a response that reports success; raises the service's own error otherwise."""
    if not response.success:
        raise CodedError(response.code, response.message, **mapping_from_values(response.values))
    return response


class Previewer:
    """Publishes /virtual_borders/preview (vb_msgs/BorderPreview, latched) from its own thread.

    The `on_*` methods only store; a command never waits for a preview.

    Args:
        services: the services to call.
        list_notices: returns all current notices; those that concern the drawing are issues of the preview, like
            those of the border's check.
    """

    def __init__(self, services: BorderServices, list_notices: Callable[[], List[Notice]]) -> None:
        self._services, self._list_notices = services, list_notices
        self._scheduler = PreviewScheduler()
        self._condition = threading.Condition()
        self._inputs = PreviewInputs()
        self._warnings = DrawingWarnings()
        self._progress: Optional[BorderProgress] = None
        self._is_saving = False
        self._closed = False
        self._shown = BorderPreviewArray()
        self._publisher = rospy.Publisher(names.PREVIEW, BorderPreviewArray, queue_size=1, latch=True)
        node.Worker(self, self._make)

    # ------------------------------------------------------------------ inputs
    def on_interaction(self, interaction_id: str, saving: bool) -> None:
        """Stores the current interaction, "" for none; called repeatedly.

        While it is being saved, no preview is made.
        """
        with self._condition:
            self._is_saving = saving
            self._warnings.update(self._list_notices())
            if interaction_id != self._inputs.interaction_id:
                self._warnings.start()
                self._inputs = PreviewInputs(interaction_id, borders=self._inputs.borders)
                self._take_progress()
            self._inputs = dataclasses.replace(self._inputs, warnings=self._warnings.all)
            self._condition.notify()

    def has_warning(self, interaction_id: str) -> bool:
        """Returns whether saving is doubtful: the preview has issues, or the drawing has warnings."""
        with self._condition:
            shown = self._shown
            doubtful = shown.interaction_id == interaction_id and shown.available and shown.success and shown.issues
            return bool(interaction_id and (doubtful or self._inputs.warnings))

    def on_progress(self, message: BorderProgress) -> None:
        """Stores the drawing so far."""
        with self._condition:
            self._progress = message
            self._take_progress()
            self._condition.notify()

    def on_borders(self, message: VirtualBorderArray) -> None:
        """Stores the revision of the borders in the map, which are sent again whenever the map changes."""
        with self._condition:
            borders = (message.header.stamp.to_sec(), message.revision)
            self._inputs = dataclasses.replace(self._inputs, borders=borders)
            self._condition.notify()

    def _take_progress(self) -> None:
        message = self._progress
        if message is None or not message.interaction_id or message.interaction_id != self._inputs.interaction_id:
            return
        missing = Notice("seed_not_drawn", message=sentences.translate("seed_not_drawn"))
        if message.code != "ok":
            missing = Notice(message.code, values=mapping_from_values(message.values), message=message.message)
        self._inputs = dataclasses.replace(
            self._inputs,
            chain=to_key(array_from_points(message.chain)),
            seed=to_key(array_from_points([message.seed] if message.has_seed else [])),
            missing=missing,
        )

    # ------------------------------------------------------------------ work
    def get(self) -> Optional[PreviewInputs]:
        """Waits for inputs that need a preview; None once closed. For the worker only."""
        with self._condition:
            while not self._closed:
                delay = None if self._is_saving else self._scheduler.delay(self._inputs, time.monotonic())
                if delay == 0.0:
                    return self._inputs
                self._condition.wait(delay)
        return None

    def close(self) -> None:
        """Ends the worker."""
        with self._condition:
            self._closed = True
            self._condition.notify()

    def _make(self, inputs: PreviewInputs) -> None:
        started, answered = time.monotonic(), True
        preview = self._empty(inputs, inputs.missing)
        if inputs.complete:
            try:
                preview = self._compute(inputs)
            except CodedError as error:
                answered = error.code not in services.UNANSWERED
                preview = self._empty(inputs, Notice.from_error(error, Severity.INFO))
        with self._condition:
            # if the interaction has ended or is being saved meanwhile, its preview is obsolete
            if self._inputs.interaction_id == inputs.interaction_id and not self._is_saving:
                self._publisher.publish(preview)
                self._shown = preview
                self._scheduler.record_preview(inputs, started, time.monotonic(), answered)

    def border_to_save(self, interaction_id: str) -> VirtualBorder:
        """Returns the border that was previewed; fetches the drawn one if more was drawn since, or nothing previewed.

        Raises:
            CodedError: "no_service", "no_response", or why there is no border.
        """
        with self._condition:
            current = self._inputs.interaction_id == interaction_id and self._inputs == self._scheduler.shown
            if current and self._shown.available:
                return self._shown.border
        return self._services.fetch_drawn_border(interaction_id)

    def _compute(self, inputs: PreviewInputs) -> BorderPreviewArray:
        border = self._services.fetch_drawn_border(inputs.interaction_id)
        answer = self._services.preview(border)
        border.area_m2 = answer.area_m2
        preview = self._empty(inputs, Notice(answer.code, message=answer.message))
        preview.values = answer.values
        preview.available, preview.success = True, answer.success
        preview.issues = [*answer.issues, *map(_issue, inputs.warnings)]
        preview.border, preview.region = border, answer.region
        preview.area_m2, preview.free_parts = answer.area_m2, answer.free_parts
        return preview

    @staticmethod
    def _empty(inputs: PreviewInputs, said: Notice) -> BorderPreviewArray:
        preview = BorderPreviewArray(interaction_id=inputs.interaction_id, code=said.code, message=said.message)
        preview.values = values_from_mapping(said.values)
        preview.header.stamp = rospy.Time.now()
        preview.header.frame_id = names.MAP_FRAME
        preview.region.data = np.zeros(0, np.int8)
        return preview


def _issue(warning: Notice) -> BorderIssue:
    return BorderIssue(
        severity=BorderIssue.WARNING,
        code=warning.code,
        message=warning.sentence(),
        values=values_from_mapping(warning.values),
    )
