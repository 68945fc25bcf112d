"""Adapts RViz's configuration to a map and a screen, and its fonts to the characters of many languages. No ROS."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import Optional, Tuple

import yaml

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_feedback.display.layout import DRAWABLE_RANGES, Rectangle, fit_view


def write_fitted_config(
    source: str, target: Path, extent: Rectangle, width: int, height: int, aspect: Optional[float] = None
) -> None:
    """Copies an RViz config, and changes its view from above so that the screen shows the whole smart display.

    Args:
        source: an RViz config with a TopDownOrtho view.
        extent: extent of the map [m].
        width, height: size of the screen [px].
        aspect: aspect ratio (width / height) of display_markers' layout (`layout.fit_view`), or None if it is that of
            the screen. If the two differ, there is a margin, and nothing is cut off.

    Raises:
        CodedError: "bad_config" if the source cannot be read or has no such view; "bad_layout" if the screen or the map
            is too small.
    """
    if width < 320 or height < 240:
        raise CodedError("bad_layout", f"the screen must be at least 320 x 240 pixels, got {width} x {height}")
    try:
        config = yaml.safe_load(Path(source).read_text(encoding="utf-8"))
        view = config["Visualization Manager"]["Views"]["Current"]
        window = config["Window Geometry"]
        view_class = view["Class"]
    except (OSError, yaml.YAMLError) as error:
        raise CodedError("bad_config", f"cannot read the RViz config '{source}': {error}") from None
    except (KeyError, TypeError):
        raise CodedError("bad_config", "this is no RViz config with a view and a window") from None
    if view_class != "rviz/TopDownOrtho":
        raise CodedError("bad_config", f"the config's view must be rviz/TopDownOrtho, it is {view_class}")
    layout = fit_view(extent, aspect or width / height)
    x, y = layout.view.center
    scale = min(width / layout.view.width, height / layout.view.height)  # [px/m]
    view.update({"Angle": 0, "Scale": scale, "X": x, "Y": y})
    window.update({"X": 0, "Y": 0, "Width": int(width), "Height": int(height)})
    write_atomically(target, yaml.safe_dump(config, default_flow_style=False, sort_keys=False).encode("utf-8"))


def screen_size(description: str) -> Optional[Tuple[int, int]]:
    """Parses the screen's (width, height) [px] in xdpyinfo's output. Returns None if the output has none."""
    match = re.search(r"dimensions:\s+(\d+)x(\d+) pixels", description)
    return (int(match.group(1)), int(match.group(2))) if match else None


def overlay_fonts(rviz: Path, folder: Path) -> Path:
    """Creates a folder that overlays RViz's package, and returns it. It must precede the package in ROS_PACKAGE_PATH.

    RViz draws text in Liberation Sans, which has Latin, Greek and Cyrillic characters. But it requests only those up to
    166 (OGRE's default), and draws no text that contains any other character. The overlay has links to all files of the
    package except the font definitions; in their place are copies that request all of DRAWABLE_RANGES.

    Args:
        rviz: the folder of RViz's package.
        folder: the folder to create; an existing one is replaced.
    """
    shutil.rmtree(str(folder), ignore_errors=True)
    ignore = shutil.ignore_patterns("*.fontdef")
    shutil.copytree(str(rviz.resolve()), str(folder / "rviz"), copy_function=os.symlink, ignore=ignore)
    fonts = Path("ogre_media") / "fonts"
    code_points = " ".join(f"{first}-{last}" for first, last in DRAWABLE_RANGES)
    for path in (rviz / fonts).glob("*.fontdef"):
        kept = [line for line in path.read_text(encoding="utf-8").splitlines() if "code_points" not in line]
        end = max(number for number, line in enumerate(kept) if line.strip() == "}")
        kept.insert(end, f"  code_points {code_points}")
        (folder / "rviz" / fonts / path.name).write_text("\n".join(kept) + "\n", encoding="utf-8")
    return folder
