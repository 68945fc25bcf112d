"""Converts messages to the display's content, and shapes to markers."""

from __future__ import annotations

from itertools import zip_longest
from typing import List, Optional, Sequence

import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from vb_core import names, sentences
from vb_core.notices import Notice, Severity
from vb_core.ros.messages import array_from_points, sentence_in
from vb_msgs.msg import BorderPreview, BorderProgress, BorderIssue, InteractionState, VirtualBorder
from visualization_msgs.msg import Marker

from vb_feedback.display import scene
from vb_feedback.display.text_panel import PanelNotice, PanelContent

_MAX_NOTICES = 3  # with more of them, the letters would be too small to be read from across the room
_KINDS = {
    scene.LINES: Marker.LINE_LIST,
    scene.POINTS: Marker.POINTS,
    scene.DISC: Marker.CYLINDER,
    scene.PLATE: Marker.CUBE,
    scene.TEXT: Marker.TEXT_VIEW_FACING,
}


def marker_from_shape(shape: scene.Shape) -> Marker:
    """Converts a shape to a marker. The stamp stays zero, so that RViz uses the latest transform of the frame."""
    marker = Marker(ns=shape.namespace, id=shape.number, type=_KINDS[shape.kind], action=Marker.ADD, text=shape.text)
    marker.header.frame_id = shape.frame or names.MAP_FRAME
    marker.frame_locked = bool(shape.frame)
    marker.pose.orientation.w = 1.0
    marker.lifetime = rospy.Duration.from_sec(shape.lifetime)
    tints = [ColorRGBA(*color, shape.alpha) for color in shape.colors]
    marker.color = tints[0]
    scale = marker.scale
    if shape.kind in (scene.LINES, scene.POINTS):
        marker.points = [Point(x, y, shape.z) for x, y in shape.points]
        if len(tints) == len(shape.points) > 1:
            marker.colors = tints
        scale.x = shape.size[0]
        scale.y = shape.size[0] if shape.kind == scene.POINTS else 0.0
        return marker
    marker.pose.position = Point(*shape.points[0], shape.z)
    if shape.kind == scene.TEXT:
        scale.z = shape.size[0]
    else:
        scale.x, scale.y, scale.z = shape.size[0], shape.size[-1], 0.01
    return marker


def panel_from_state(
    state: Optional[InteractionState],
    cameras_seeing_spot: Sequence[str],
    notices: Sequence[PanelNotice],
    has_map: bool,
    language: str,
) -> PanelContent:
    """Converts the state to the panel's content. Without a map, the content is only whether robots are stopped."""
    stopped = state is not None and state.stopped
    if not has_map:
        message = sentences.translate("display_waiting_map", {}, language)
        return PanelContent(message=message, stopped=stopped, language=language)
    if state is None:
        return PanelContent(language=language)
    return PanelContent(
        state=state.name,
        # in whole seconds, as they are displayed, so that the content does not change more often
        elapsed_s=int(state.guide_s + state.border_s + state.seed_s),
        commands=tuple(state.available_commands),
        success=state.last_success,
        message=sentence_in(state, language, "last_"),
        cameras_seeing_spot=tuple(cameras_seeing_spot),
        notices=tuple(notices),
        stopped=stopped,
        language=language,
    )


def drawing_from_progress(progress: BorderProgress) -> scene.Drawing:
    """Converts a progress message to plain values. The camera of a point is "" if it is unknown."""
    camera_names = dict(enumerate(progress.cameras))
    indices = bytes(progress.point_cameras)[: len(progress.points)]
    point_cameras = [camera_names.get(index, "") for _, index in zip_longest(progress.points, indices)]
    return scene.Drawing(
        points=scene.as_pairs(array_from_points(progress.points)),
        point_cameras=tuple(point_cameras),
        chain=scene.as_pairs(array_from_points(progress.chain)),
        closed=progress.closed,
        seed=(progress.seed.x, progress.seed.y) if progress.has_seed else None,
    )


def displayed_border_from_message(border: VirtualBorder, language: str = sentences.ENGLISH) -> scene.DisplayedBorder:
    """Converts a border message to plain values."""
    return scene.DisplayedBorder(
        name=sentences.border_name(border.name, language) or border.id,
        points=scene.as_pairs(array_from_points(border.points)),
        closed=border.kind == VirtualBorder.POLYGON,
        seed=(border.seed.x, border.seed.y),
        occupancy=border.occupancy,
        enabled=border.enabled,
        area_m2=border.area_m2,
        before=scene.as_pairs(array_from_points(border.before)),
        after=scene.as_pairs(array_from_points(border.after)),
    )


def select_notices(notices: Sequence[Notice], language: str) -> List[PanelNotice]:
    """Selects the first notices, which are the most severe ones. Each sentence is shown only once."""
    all_notices = [PanelNotice(notice.sentence(language), notice.severity >= Severity.WARNING) for notice in notices]
    return list(dict.fromkeys(all_notices))[:_MAX_NOTICES]


def preview_notices(preview: Optional[BorderPreview], language: str) -> List[PanelNotice]:
    """Returns the reason why saving would fail, or else the area that it would restrict and the first warning."""
    if preview is None:
        return []
    errors = [issue for issue in preview.issues if issue.severity == BorderIssue.ERROR]
    warnings = [issue for issue in preview.issues if issue.severity != BorderIssue.ERROR]
    if not preview.success:
        why = sentence_in((errors or [preview])[0], language)
        return [PanelNotice(sentences.translate("preview_refused", {"why": why}, language), warning=True)]
    area = f"{preview.area_m2:.2f}"
    notices = [PanelNotice(sentences.translate("preview_restricts", {"area": area}, language))]
    if warnings:
        warning = sentence_in(warnings[0], language)
        notices.append(PanelNotice(sentences.translate("preview_note", {"what": warning}, language), warning=True))
    return notices
