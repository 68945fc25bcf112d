"""A camera's two files: its lens, in the format of camera_calibration and camera_info_manager, and its settings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Dict, Mapping, Union

import numpy as np
import yaml

from vb_core.camera_model import FISHEYE_MODELS, CameraModel
from vb_core.errors import CodedError
from vb_core.files import write_atomically

_GROUP = "capture"


def save_lens(path: Path, name: str, camera: CameraModel) -> None:
    """Writes a lens, which `load_lens` reads. CodedError "cannot_write" is raised if that fails."""

    def matrix(values: np.ndarray) -> Dict[str, Any]:
        values = np.atleast_2d(values)
        return {"rows": values.shape[0], "cols": values.shape[1], "data": [float(value) for value in values.ravel()]}

    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": name,
        "camera_matrix": matrix(camera.matrix),
        "distortion_model": camera.distortion_model,
        "distortion_coefficients": matrix(camera.distortion),
        "rectification_matrix": matrix(np.eye(3)),
        "projection_matrix": matrix(np.column_stack([camera.matrix, np.zeros(3)])),
    }
    write_atomically(path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None).encode("utf-8"))


def load_lens(path: Path) -> CameraModel:
    """Reads a lens; inverse of `save_lens`.

    Raises:
        CodedError: "no_camera_info" if there is no file, "bad_lens_file" if it describes no camera.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        return CameraModel(
            int(content["image_width"]),
            int(content["image_height"]),
            np.array(content["camera_matrix"]["data"], float),
            np.array(content["distortion_coefficients"]["data"], float),
            content.get("distortion_model") in FISHEYE_MODELS,
        )
    except FileNotFoundError:
        why = f"there is no {path}: run `rosrun vb_laser_detect calibrate_camera lens {path.stem}`"
        raise CodedError("no_camera_info", why) from None
    except CodedError as error:
        raise CodedError("bad_lens_file", file=path, why=error.message) from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise CodedError("bad_lens_file", file=path, why=str(error)) from None


def set_capture(path: Path, values: Mapping[str, Union[int, float]]) -> None:
    """Sets values of the group `capture` in detectors/NAME.yaml; leaves the rest, comments included, unchanged.

    Raises:
        CodedError: "bad_file" if the file cannot be changed this way, "cannot_write".
    """
    try:
        text = path.read_text(encoding="utf-8")
        before = yaml.safe_load(text) or {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise CodedError("bad_file", file=path, why=str(error)) from None
    text = re.sub(r"^\{\}\s*$", "", text, flags=re.MULTILINE).rstrip() + "\n"
    if not re.search(rf"^{_GROUP}:\s*$", text, re.MULTILINE):
        text += f"{_GROUP}:\n"
    for name, value in values.items():
        line = f"  {name}: {value}"
        text, count = re.subn(rf"^  {name}:[^#\n]*", line + " ", text, flags=re.MULTILINE)
        if not count:
            text = re.sub(rf"^{_GROUP}:[ \t]*$", f"{_GROUP}:\n{line}", text, count=1, flags=re.MULTILINE)
    text = re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE)
    try:
        after = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise CodedError("bad_file", file=path, why=str(error)) from None
    if after != {**before, _GROUP: {**(before.get(_GROUP) or {}), **values}}:
        raise CodedError("bad_file", file=path, why="'capture' is not written in lines of its own")
    write_atomically(path, text.encode("utf-8"))
