"""Fits an RViz config to a map and a screen."""
from __future__ import annotations

import copy
from typing import Any, Dict

from vb_core.errors import CodedError
from vb_feedback.layout import Box, fit


def fit_config(config: Dict[str, Any], extent: Box, width: int, height: int) -> Dict[str, Any]:
    """An RViz config whose top view shows the whole display on a screen.

    The view is the one for which display_markers lays its words out, see `layout.fit`.

    Args:
        config: an RViz config, as YAML gives it, with a TopDownOrtho view; it is not changed.
        extent: of the map [m].
        width, height: of the screen [px].

    Raises:
        CodedError: "bad_config" if it has no such view; "bad_layout" if screen or map have no sensible size.
    """
    if width < 320 or height < 240:
        raise CodedError("bad_layout", f"the screen must be at least 320 x 240 pixels, got {width} x {height}")
    result = copy.deepcopy(config)
    try:
        view = result["Visualization Manager"]["Views"]["Current"]
        window = result["Window Geometry"]
        kind = view["Class"]
    except (KeyError, TypeError):
        raise CodedError("bad_config", "this is no RViz config with a view and a window") from None
    if kind != "rviz/TopDownOrtho":
        raise CodedError("bad_config", f"the config's view must be rviz/TopDownOrtho, it is {kind}")
    layout = fit(extent, width / height)
    x, y = layout.view.centre
    view.update({"Angle": 0, "Scale": width / layout.view.width, "X": x, "Y": y})
    window.update({"X": 0, "Y": 0, "Width": int(width), "Height": int(height)})
    return result
