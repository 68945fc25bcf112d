"""A calibrated camera's file: the pose, which `camera_poses` publishes, and comments on its accuracy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Sequence

import numpy as np
import yaml

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.files import write_atomically

_HEAD = """\
# Pose of the ceiling camera '{camera}' in the map, written by calibrate_camera.
# camera_poses publishes it as a static transform from `parent` to `frame`.
"""


@dataclass(frozen=True)
class CameraPose:
    """The contents of a calibration file.

    Attributes:
        parent, frame: frames of the transform, usually map and <camera>_optical_frame.
        T: (4, 4) T_parent_frame.
        focal: [px] focal length with which the pose was found, because another lens needs another pose; 0 if not known.
    """

    camera: str
    parent: str
    frame: str
    T: np.ndarray
    focal: float = 0.0


def calibration_path(folder: str, camera: str) -> Path:
    """Returns the path of a camera's file."""
    return Path(folder).expanduser() / f"{camera}.yaml"


def write_pose(path: Path, pose: CameraPose, report: Sequence[str]) -> None:
    """Writes a calibration file, atomically, and keeps the previous one next to it as *.old.

    Args:
        report: lines that say when, how and how well the pose was found; they become comments.

    Raises:
        CodedError: "cannot_write"
    """
    if path.exists():
        write_atomically(path.with_name(path.name + ".old"), path.read_bytes())
    quaternion = geometry.quaternion_from_rotation(pose.T[:3, :3])  # x, y, z, w
    content = {
        "parent": pose.parent,
        "frame": pose.frame,
        "translation": [round(float(value), 6) for value in pose.T[:3, 3]],
        "rotation": [round(float(value), 9) for value in quaternion],
        "focal_px": round(pose.focal, 3),
    }
    text = _HEAD.format(camera=pose.camera) + "".join(f"#   {line}\n" for line in report)
    text += yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)
    write_atomically(path, text.encode("utf-8"))


def read_pose(path: Path) -> CameraPose:
    """Reads a calibration file; inverse of `write_pose` but for the comments.

    Raises:
        CodedError: "no_calibration" if there is no such file; "bad_calibration" if it holds no pose.
    """
    try:
        content = yaml.safe_load(path.read_text())
    except FileNotFoundError:
        raise CodedError("no_calibration", f"there is no '{path}'") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CodedError("bad_calibration", f"cannot read '{path}': {error}") from None
    try:
        parent, frame = (content[key] for key in ("parent", "frame"))
        translation = np.array(content["translation"], dtype=float).reshape(3)
        rotation = geometry.rotation_from_quaternion(np.array(content["rotation"], dtype=float).reshape(4))
        if not all(isinstance(name, str) and name for name in (parent, frame)):
            raise ValueError("parent and frame must be names")
        if not np.isfinite(translation).all():
            raise ValueError(f"translation {translation}")
        focal = float(content.get("focal_px", 0.0))
    except (KeyError, TypeError, ValueError) as error:
        raise CodedError("bad_calibration", f"'{path}' is not a calibration: {error}") from None
    return CameraPose(path.stem, parent, frame, geometry.make_transform(rotation, translation), focal)
