"""Shows what saving would do before anyone says "save"."""

from __future__ import annotations

import dataclasses
import threading
import time
from typing import Callable, List, Optional

import numpy as np
import rospy
from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_core.ros import node, services
from vb_core.ros.messages import NumpyBorderPreview, array_from_points, mapping_from_values, values_from_mapping
from vb_msgs.msg import BorderIssue, BorderProgress, VirtualBorder, VirtualBorderArray

from vb_voice_wizard.border_services import BorderServices
from vb_voice_wizard.preview.preview_scheduler import DrawingWarnings, PreviewInputs, PreviewScheduler, comparison_key


class PreviewPublisher:
    """Publishes /virtual_borders/preview (vb_msgs/BorderPreview, latched) from its own thread.

    The `on_*` methods only store their inputs, so that a command never waits for a preview. `get` and `close` make it
    the source of its own worker (vb_core.ros.node.Worker).

    Args:
        services: calls the nodes that have the drawing and the map.
        list_notices: returns all current notices. Those that concern the drawing are listed among the preview's issues.
    """

    def __init__(self, services: BorderServices, list_notices: Callable[[], List[Notice]]) -> None:
        self._services = services
        self._list_notices = list_notices
        self._scheduler = PreviewScheduler()
        self._condition = threading.Condition()
        self._inputs = PreviewInputs()
        self._warnings = DrawingWarnings()
        self._progress: Optional[BorderProgress] = None
        self._is_saving = False
        self._closed = False
        self._shown = NumpyBorderPreview()
        self._publisher = rospy.Publisher(names.PREVIEW, NumpyBorderPreview, queue_size=1, latch=True)
        node.Worker(self, self._publish_preview)

    # ------------------------------------------------------------------ inputs
    def on_interaction(self, interaction_id: str, saving: bool) -> None:
        """Stores the current interaction, "" for none, and whether it is being saved. While it is, no preview is made."""
        with self._condition:
            self._is_saving = saving
            self._warnings.update(self._list_notices())
            if interaction_id != self._inputs.interaction_id:
                self._warnings.start()
                self._inputs = PreviewInputs(interaction_id, borders=self._inputs.borders)
                self._apply_progress()
            self._inputs = dataclasses.replace(self._inputs, warnings=self._warnings.all)
            self._condition.notify()

    def on_progress(self, message: BorderProgress) -> None:
        """Stores the drawing so far."""
        with self._condition:
            self._progress = message
            self._apply_progress()
            self._condition.notify()

    def on_borders(self, message: VirtualBorderArray) -> None:
        """Stores the revision of the borders in the map, which are sent again whenever the map changes."""
        with self._condition:
            borders = (message.header.stamp.to_sec(), message.revision)
            self._inputs = dataclasses.replace(self._inputs, borders=borders)
            self._condition.notify()

    def _apply_progress(self) -> None:
        """Adds the newest drawing to the inputs, if it is the current interaction's. Needs the lock."""
        message = self._progress
        if message is None or not message.interaction_id or message.interaction_id != self._inputs.interaction_id:
            return
        missing_reason = Notice("seed_not_drawn", message=sentences.translate("seed_not_drawn"))
        if message.code != "ok":
            missing_reason = Notice(message.code, values=mapping_from_values(message.values), message=message.message)
        chain = comparison_key(array_from_points(message.chain))
        seed = comparison_key(array_from_points([message.seed] if message.has_seed else []))
        self._inputs = dataclasses.replace(self._inputs, chain=chain, seed=seed, missing_reason=missing_reason)

    def is_doubtful(self, interaction_id: str) -> bool:
        """Returns whether a save should be confirmed, as the preview has issues or the drawing has warnings."""
        with self._condition:
            shown = self._shown
            has_issues = shown.interaction_id == interaction_id and shown.available and shown.success and shown.issues
            return bool(interaction_id and (has_issues or self._inputs.warnings))

    def border_to_save(self, interaction_id: str) -> VirtualBorder:
        """Returns the border that was previewed. Fetches the drawn one if more was drawn since, or nothing previewed.

        Raises:
            CodedError: "no_service", "no_response", or why there is no border.
        """
        with self._condition:
            is_current = self._inputs.interaction_id == interaction_id and self._inputs == self._scheduler.shown
            if is_current and self._shown.available:
                return self._shown.border
        return self._services.fetch_drawn_border(interaction_id)

    # ------------------------------------------------------------------ the worker
    def get(self) -> Optional[PreviewInputs]:
        """Waits for inputs that need a preview. Returns None once closed. For the worker only."""
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

    def _publish_preview(self, inputs: PreviewInputs) -> None:
        """Makes and publishes a preview, which is obsolete if the interaction then has ended or is being saved."""
        started = time.monotonic()
        answered = True
        preview = _empty_preview(inputs, inputs.missing_reason)
        if inputs.is_complete:
            try:
                preview = self._make_preview(inputs)
            except CodedError as error:
                answered = error.code not in services.UNANSWERED
                preview = _empty_preview(inputs, Notice.from_error(error, Severity.INFO))
        with self._condition:
            if self._inputs.interaction_id == inputs.interaction_id and not self._is_saving:
                self._publisher.publish(preview)
                self._shown = preview
                self._scheduler.record_preview(inputs, started, time.monotonic(), answered)

    def _make_preview(self, inputs: PreviewInputs) -> NumpyBorderPreview:
        border = self._services.fetch_drawn_border(inputs.interaction_id)
        answer = self._services.preview(border)
        border.area_m2 = answer.area_m2
        preview = _empty_preview(inputs, Notice(answer.code, message=answer.message))
        preview.values = answer.values
        preview.available = True
        preview.success = answer.success
        preview.issues = [*answer.issues, *map(_issue_from_warning, inputs.warnings)]
        preview.border = border
        preview.region = answer.region
        preview.area_m2 = answer.area_m2
        preview.free_parts = answer.free_parts
        return preview


def _empty_preview(inputs: PreviewInputs, reason: Notice) -> NumpyBorderPreview:
    """Makes a preview without a border, whose code and sentence give the reason."""
    preview = NumpyBorderPreview(interaction_id=inputs.interaction_id, code=reason.code, message=reason.message)
    preview.values = values_from_mapping(reason.values)
    preview.header.stamp = rospy.Time.now()
    preview.header.frame_id = names.MAP_FRAME
    preview.region.data = np.zeros(0, np.int8)
    return preview


def _issue_from_warning(warning: Notice) -> BorderIssue:
    values = values_from_mapping(warning.values)
    return BorderIssue(severity=BorderIssue.WARNING, code=warning.code, message=warning.sentence(), values=values)
