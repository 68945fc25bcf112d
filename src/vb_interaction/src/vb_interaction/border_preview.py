"""Previews what saving would do, lists the doubts about a drawing, and provides the border that is saved."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import Callable, List, Optional, Sequence, Set, Tuple

import numpy as np
import rospy
from vb_core import names, sentences
from vb_core.errors import CodedError
from vb_core.notices import Notice, Severity
from vb_core.ros import node, services
from vb_core.ros.preview_service import NumpyPreviewBorderResponse
from vb_core.ros.messages import NumpyBorderPreview, array_from_points, mapping_from_values, values_from_mapping
from vb_msgs.msg import BorderIssue, BorderProgress, VirtualBorder, VirtualBorderArray

from vb_interaction.border_services import BorderServices

PREVIEW_PERIOD = 0.5  # [s] between two previews, which is faster than people read
RETRY_DELAY = 2.0  # [s] after which a service that did not answer is called again
VISIBLE_MOVE = 0.02  # [m] a smaller move of a vertex or seed changes nothing visible, because a map cell is larger
MAX_TIME_SHARE = 0.25  # share of the time that previews may take, because the same computer searches the images
# codes of notices: a stroke is not in the border, no camera saw a piece of it, the pointer was also held still elsewhere
DOUBTS = ("strokes_left_out", "piece_unseen", "seed_held_elsewhere")


# ------------------------------------------------------------------ what a preview depends on
def comparison_key(points: np.ndarray) -> bytes:
    """Returns a key of points (N, 2) [m], which changes when a point moves visibly. It is b"" if there are no points."""
    return np.round(points / VISIBLE_MOVE).astype(np.int32).tobytes()


@dataclass(frozen=True)
class PreviewInputs:
    """Everything that a preview depends on. Equal inputs give previews that look the same.

    Attributes:
        interaction_id: id of the current interaction, or "" if there is none.
        chain, seed: `comparison_key` of the border and of the seed as drawn so far, in the map frame.
        borders: stamp [s] and revision of the stored borders, of which one changes with the map or a border in it.
        missing_reason: why there is no border or no seed, if that is known.
        warnings: further reasons to doubt the drawing (`DrawingWarnings`).
    """

    interaction_id: str = ""
    chain: bytes = b""
    seed: bytes = b""
    borders: Tuple[float, int] = (0.0, 0)
    missing_reason: Notice = Notice("")
    warnings: Tuple[Notice, ...] = ()

    @property
    def is_complete(self) -> bool:
        """Whether there is something to preview."""
        return bool(self.interaction_id and self.chain and self.seed)


class DrawingWarnings:
    """Collects the notices that give a reason to doubt the drawing. Not thread safe.

    While a camera has an error, the spots that it should see are missing in the line or misplaced, and they remain so
    when the camera works again. Therefore a camera's error makes the drawing doubtful until the interaction ends.
    """

    def __init__(self) -> None:
        self.all: Tuple[Notice, ...] = ()  # the current warnings, then one for each camera that had an error before
        self._failed_cameras: Set[str] = set()  # all cameras that had an error since the drawing began

    def update(self, notices: Sequence[Notice], is_new_drawing: bool = False) -> None:
        """Selects the notices that concern the drawing. A new drawing begins without the errors that are already over."""
        current = []
        for notice in notices:
            if notice.code in DOUBTS or (notice.camera and notice.severity is Severity.ERROR):
                current.append(notice)
        faulty_cameras = {notice.camera for notice in current if notice.camera}
        if is_new_drawing:
            self._failed_cameras = set()
        self._failed_cameras |= faulty_cameras
        for camera in sorted(self._failed_cameras - faulty_cameras):
            values = {"camera": camera}
            current.append(Notice("camera_failed_meanwhile", Severity.WARNING, camera=camera, values=values))
        self.all = tuple(current)


class PreviewScheduler:
    """Decides when the next preview is due.

    It uses wall time, because it limits the share of the computer's time that previews take.
    """

    def __init__(self) -> None:
        self.shown: Optional[PreviewInputs] = None  # the inputs of the last preview
        self._not_before = float("-inf")
        self._retry_at: Optional[float] = None

    def delay(self, inputs: PreviewInputs, now: float) -> Optional[float]:
        """Returns the time [s] until a preview of these inputs is due, 0 for now, or None if they need no preview."""
        if self.shown is None or inputs.interaction_id != self.shown.interaction_id:
            return 0.0
        if inputs == self.shown:
            return None if self._retry_at is None else max(0.0, self._retry_at - now)
        return max(0.0, self._not_before - now)

    def record_preview(self, inputs: PreviewInputs, started: float, now: float, answered: bool) -> None:
        """Records that a preview was made.

        Args:
            inputs: the inputs of the preview.
            started, now: [s] times at which the work on the preview began and ended.
            answered: False if a service did not answer; the preview is then tried again after RETRY_DELAY.
        """
        self.shown = inputs
        self._retry_at = None if answered else now + RETRY_DELAY
        pause = (now - started) * (1.0 / MAX_TIME_SHARE - 1.0)
        self._not_before = max(started + PREVIEW_PERIOD, now + pause)


# ------------------------------------------------------------------ previews
class PreviewPublisher:
    """Publishes /virtual_borders/preview (vb_msgs/BorderPreview, latched) from its own thread.

    The `on_*` methods only store their inputs, so that a command never waits for a preview. Through `get` and `close`,
    an instance is the source of its own worker (vb_core.ros.node.Worker).

    Args:
        services: calls the nodes that have the drawing and the map.
        list_notices: returns all current notices. Those that concern the drawing become issues of the preview.
    """

    def __init__(self, services: BorderServices, list_notices: Callable[[], List[Notice]]) -> None:
        self._services = services
        self._list_notices = list_notices
        self._scheduler = PreviewScheduler()
        self._condition = threading.Condition()
        self._interaction_id = ""
        self._is_saving = False
        self._progress = BorderProgress()
        self._borders = (0.0, 0)
        self._warnings = DrawingWarnings()
        self._closed = False
        self._shown = NumpyBorderPreview()
        self._publisher = rospy.Publisher(names.PREVIEW, NumpyBorderPreview, queue_size=1, latch=True)
        node.Worker(self, self._publish_preview)

    def on_interaction(self, interaction_id: str, saving: bool) -> None:
        """Stores the id of the current interaction, or "", and whether it is being saved. Then no preview is made."""
        with self._condition:
            self._is_saving = saving
            self._warnings.update(self._list_notices(), is_new_drawing=interaction_id != self._interaction_id)
            self._interaction_id = interaction_id
            self._condition.notify()

    def on_progress(self, message: BorderProgress) -> None:
        """Stores the drawing so far."""
        with self._condition:
            self._progress = message
            self._condition.notify()

    def on_borders(self, message: VirtualBorderArray) -> None:
        """Stores the stamp and revision of the stored borders, which are sent again whenever the map changes."""
        with self._condition:
            self._borders = (message.header.stamp.to_sec(), message.revision)
            self._condition.notify()

    def _current_inputs(self) -> PreviewInputs:
        """Returns the inputs of a preview that is made now. Needs the lock."""
        interaction_id = self._interaction_id
        warnings = self._warnings.all
        drawn = self._progress
        if not interaction_id or drawn.interaction_id != interaction_id:
            return PreviewInputs(interaction_id, borders=self._borders, warnings=warnings)
        missing_reason = Notice("seed_not_drawn", message=sentences.translate("seed_not_drawn"))
        if drawn.code != "ok":
            missing_reason = Notice(drawn.code, values=mapping_from_values(drawn.values), message=drawn.message)
        chain = comparison_key(array_from_points(drawn.chain))
        seed_points = [drawn.seed] if drawn.has_seed else []
        seed = comparison_key(array_from_points(seed_points))
        return PreviewInputs(interaction_id, chain, seed, self._borders, missing_reason, warnings)

    def is_doubtful(self, interaction_id: str) -> bool:
        """Returns whether a save should be confirmed, because the preview has issues or the drawing has warnings."""
        with self._condition:
            shown = self._shown
            can_save = shown.interaction_id == interaction_id and shown.available and shown.success
            has_doubts = bool(can_save and shown.issues) or bool(self._warnings.all)
            return interaction_id != "" and has_doubts

    def fetch_border_to_save(self, interaction_id: str) -> VirtualBorder:
        """Returns the border that was previewed. Fetches the drawn border if there is no preview, or more was drawn since.

        From now on, no preview is made until `on_interaction` reports that the interaction is not being saved.

        Raises:
            CodedError: "no_service", "no_response", or why there is no border.
        """
        with self._condition:
            self._is_saving = True
            is_unchanged = self._current_inputs() == self._scheduler.shown
            if is_unchanged and self._interaction_id == interaction_id and self._shown.available:
                return self._shown.border
        return self._services.fetch_drawn_border(interaction_id)

    # ------------------------------------------------------------------ the worker
    def get(self) -> Optional[PreviewInputs]:
        """Waits for inputs that need a preview, and returns them. Returns None once closed. For the worker only."""
        with self._condition:
            while not self._closed:
                inputs = self._current_inputs()
                delay = None if self._is_saving else self._scheduler.delay(inputs, time.monotonic())
                if delay == 0.0:
                    return inputs
                self._condition.wait(delay)
        return None

    def close(self) -> None:
        """Ends the worker."""
        with self._condition:
            self._closed = True
            self._condition.notify()

    def _publish_preview(self, inputs: PreviewInputs) -> None:
        """Makes a preview, and publishes it unless the interaction has ended or is being saved meanwhile."""
        started = time.monotonic()
        answered = True
        reason = inputs.missing_reason
        checked = None
        if inputs.is_complete:
            try:
                checked = self._services.preview(inputs.interaction_id)
            except CodedError as error:
                answered = error.code not in services.UNANSWERED
                reason = Notice.from_error(error, Severity.INFO)
        preview = _make_preview(inputs, reason, checked)
        with self._condition:
            if self._interaction_id == inputs.interaction_id and not self._is_saving:
                self._publisher.publish(preview)
                self._shown = preview
                self._scheduler.record_preview(inputs, started, time.monotonic(), answered)


def _make_preview(
    inputs: PreviewInputs, reason: Notice, checked: Optional[Tuple[VirtualBorder, NumpyPreviewBorderResponse]]
) -> NumpyBorderPreview:
    """Makes a preview's message from a border and the map integrator's answer, or else an empty one with the reason."""
    preview = NumpyBorderPreview(interaction_id=inputs.interaction_id)
    preview.header.stamp = rospy.Time.now()
    preview.header.frame_id = names.MAP_FRAME
    if checked is None:
        preview.code = reason.code
        preview.message = reason.message
        preview.values = values_from_mapping(reason.values)
        preview.region.data = np.zeros(0, np.int8)
        return preview
    preview.border, answer = checked
    for name in ("success", "code", "message", "values", "area_m2", "free_parts", "region"):
        setattr(preview, name, getattr(answer, name))
    preview.available = True
    preview.issues = [*answer.issues, *map(_issue_from_warning, inputs.warnings)]
    preview.border.area_m2 = answer.area_m2
    return preview


def _issue_from_warning(warning: Notice) -> BorderIssue:
    values = values_from_mapping(warning.values)
    return BorderIssue(severity=BorderIssue.WARNING, code=warning.code, message=warning.sentence(), values=values)
