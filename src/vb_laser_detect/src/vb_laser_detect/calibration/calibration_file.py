"""A calibrated camera's file: its pose, which the launch file publishes, and what it was computed from."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Dict, List, Mapping

import numpy as np
import yaml

from vb_core import geometry
from vb_core.errors import CodedError
from vb_core.files import write_atomically

if TYPE_CHECKING:  # a node that only publishes poses does without OpenCV
    from vb_laser_detect.calibration.pose import Correspondences, PoseEstimate

_HEAD = """\
# Pose of the ceiling camera '{camera}' in the map, written by calibrate_camera.
# launch/parts/perception.launch publishes it as a static transform from `parent` to `frame`. Only `camera`, `parent`,
# `frame`, `translation`, `rotation` and `focal_px` are read; the rest says how good it is and what it came from.
"""


@dataclass(frozen=True)
class CameraPose:
    """The contents of a calibration file.

    Attributes:
        camera: its name.
        parent, frame: the transform's frames, usually map and <camera>_optical_frame.
        T: (4, 4) T_parent_frame.
        focal: [px] of the lens with which it was found: with another lens the pose is wrong; 0 if it is not known.
    """

    camera: str
    parent: str
    frame: str
    T: np.ndarray
    focal: float = 0.0


def calibration_path(folder: str, camera: str) -> Path:
    """Returns the path of a camera's file."""
    return Path(folder).expanduser() / f"{camera}.yaml"


def make_document(
    pose: CameraPose, estimate: PoseEstimate, observed: Correspondences, method: str, date: str
) -> Mapping[str, Any]:
    """Collects everything that a calibration file holds; lengths in metres unless the key says otherwise."""

    def numbers(values: Any, digits: int) -> List[float]:
        return [round(float(value), digits) for value in np.ravel(values)]

    return {
        "camera": pose.camera,
        "parent": pose.parent,
        "frame": pose.frame,
        "translation": numbers(pose.T[:3, 3], 6),
        "rotation": numbers(geometry.quaternion_from_rotation(pose.T[:3, :3]), 9),  # x, y, z, w
        "focal_px": round(pose.focal, 3),
        "date": date,
        "method": method,
        "error_px": {"rms": round(estimate.rms_px, 3), "max": round(float(estimate.errors_px[estimate.used].max()), 3)},
        "error_cm": {
            "rms": round(100 * estimate.rms_m, 3),
            "max": round(100 * float(estimate.errors_m[estimate.used].max()), 3),
        },
        "uncertainty": {
            "position_cm": numbers(100 * estimate.position_sigma, 3),
            "angle_deg": numbers(np.degrees(estimate.angle_sigma), 4),
            "floor_cm": {
                "middle": round(100 * estimate.floor_sigma[0], 2),
                "worst": round(100 * estimate.floor_sigma[1], 2),
            },
        },
        "points": [
            {
                "pixel": numbers(pixel, 2),
                "map": numbers(point, 4),
                "error_cm": round(100 * float(error), 2) if np.isfinite(error) else None,
                "used": bool(used),
            }
            for pixel, point, error, used in zip(observed.pixels, observed.points, estimate.errors_m, estimate.used)
        ],
    }


def save(path: Path, content: Mapping[str, Any]) -> None:
    """Writes a calibration file, atomically; the previous one is kept beside it as *.old.

    Raises:
        CodedError: "cannot_write"
    """
    if path.exists():
        write_atomically(path.with_name(path.name + ".old"), path.read_bytes())
    text = _HEAD.format(camera=content["camera"]) + yaml.safe_dump(
        dict(content), sort_keys=False, default_flow_style=None, width=110
    )
    write_atomically(path, text.encode("utf-8"))


def load(path: Path) -> CameraPose:
    """Reads a calibration file; inverse of `save` for what the launch file needs.

    Raises:
        CodedError: "no_calibration" if there is no such file; "bad_calibration" if it holds no pose;
            "calibration_of_other_camera", with that `camera`, if its name says another one.
    """
    try:
        content = yaml.safe_load(path.read_text())
    except FileNotFoundError:
        raise CodedError("no_calibration", f"there is no '{path}'") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CodedError("bad_calibration", f"cannot read '{path}': {error}") from None
    try:
        camera, parent, frame = (content[key] for key in ("camera", "parent", "frame"))
        translation = np.array(content["translation"], dtype=float).reshape(3)
        rotation = geometry.rotation_from_quaternion(np.array(content["rotation"], dtype=float).reshape(4))
        if not all(isinstance(name, str) and name for name in (camera, parent, frame)):
            raise ValueError("camera, parent and frame must be names")
        if not np.isfinite(translation).all():
            raise ValueError(f"translation {translation}")
        focal = float(content.get("focal_px", 0.0))
    except (KeyError, TypeError, ValueError) as error:
        raise CodedError("bad_calibration", f"'{path}' is no calibration: {error}") from None
    if camera != path.stem:
        raise CodedError("calibration_of_other_camera", file=path, camera=camera)
    return CameraPose(camera, parent, frame, geometry.transform(rotation, translation), focal)


def read_frames(folder: str) -> Dict[str, str]:
    """Reads the frame of each camera that a calibration in the folder is for."""
    frames = {}
    for path in sorted(Path(folder).expanduser().glob("*.yaml")):
        with contextlib.suppress(CodedError):
            frames[path.stem] = load(path).frame
    return frames


def require_own_frame(camera: str, frame: str, frames: Mapping[str, str]) -> None:
    """Refuses an optical frame that another camera has: a frame has one pose.

    Args:
        frames: of each camera, this one or others.

    Raises:
        CodedError: "shared_frame", naming the cameras.
    """
    same = [other for other, used in frames.items() if used == frame and other != camera]
    if same:
        raise CodedError("shared_frame", cameras=", ".join(sorted([*same, camera])), frame=frame)
