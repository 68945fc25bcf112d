"""The settings with which a camera is read. v4l2-ctl (Debian's v4l-utils) sets a device's exposure and white balance."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence

from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param

_TIMEOUT = 5.0  # [s]
_CONTROL = re.compile(r"^\s*(\w+) 0x[0-9a-f]+ \((\w+)\)\s*:(.*)$", re.MULTILINE)
# names of controls in different kernels, newest first
_AUTO_EXPOSURE = ("auto_exposure", "exposure_auto")
_EXPOSURE = ("exposure_time_absolute", "exposure_absolute")
_AUTO_WHITE = ("white_balance_automatic", "white_balance_temperature_auto")
_MANUAL = 1  # value of auto_exposure that V4L2 defines


@dataclass(frozen=True)
class CaptureParams(Parameters):
    """How a camera is read; see config/stationary.yaml."""

    width: int = param(1280, "px", low=0, high=16384)
    height: int = param(720, "px", low=0, high=16384)
    rate: float = param(0.0, "images/s", low=0.0, high=1000.0)
    pixel_format: str = param("mjpeg")
    delay_ms: float = param(0.0, "ms", low=0.0, high=5000.0, doc="time from an image to its arrival")
    exposure: int = param(0, "0.1 ms", low=0, high=100000, doc="a device's exposure time; 0: automatic")
    white_balance: int = param(0, "K", low=0, high=20000, doc="a device's white balance; 0: automatic")


def run_v4l2(device: str, *arguments: str) -> str:
    """Runs v4l2-ctl for a device; returns what it prints.

    Raises:
        CodedError: "no_v4l2" if it is not installed; "control_refused", with the device's reason.
    """
    command = ["v4l2-ctl", "-d", device, *arguments]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT, check=False)
    except FileNotFoundError:
        raise CodedError("no_v4l2") from None
    except subprocess.TimeoutExpired:
        raise CodedError("control_refused", source=device, why="no answer") from None
    if done.returncode:
        raise CodedError("control_refused", source=device, why=" ".join((done.stderr or done.stdout).split()))
    return done.stdout


def list_control_values(listing: str, params: CaptureParams) -> List[str]:
    """Returns NAME=VALUE for each control to set, in order: automatic modes are switched off before values are set.

    A setting of 0 means automatic. The control then gets its default, because the value that means it differs.

    Args:
        listing: what `v4l2-ctl --list-ctrls` prints.

    Raises:
        CodedError: "no_control" if the camera has no control for a value that is wanted.
    """
    controls: Dict[str, str] = {name: limits for name, _, limits in _CONTROL.findall(listing)}
    steps: List[str] = []

    def add(names: Sequence[str], wanted: Optional[int]) -> None:
        """Adds the control that has the first of these names that exists, with its wanted value or its default (None)."""
        name = next((name for name in names if name in controls), "")
        if not name and wanted is not None:
            raise CodedError("no_control", control=names[0], known=", ".join(controls) or "-")
        found = re.findall(r"(min|max|default)=(-?\d+)", controls.get(name, ""))
        limits = {key: int(number) for key, number in found}
        value = limits.get("default") if wanted is None else wanted
        if value is not None:
            value = max(value, limits.get("min", value))
            value = min(value, limits.get("max", value))
            steps.append(f"{name}={value}")

    add(_AUTO_EXPOSURE, _MANUAL if params.exposure else None)
    if params.exposure:
        add(_EXPOSURE, params.exposure)
    add(_AUTO_WHITE, 0 if params.white_balance else None)
    if params.white_balance:
        add(("white_balance_temperature",), params.white_balance)
    return steps


def set_controls(device: str, params: CaptureParams) -> None:
    """Sets exposure and white balance of a device. Errors are those of `run_v4l2` and `list_control_values`."""
    for step in list_control_values(run_v4l2(device, "--list-ctrls"), params):
        run_v4l2(device, f"--set-ctrl={step}")
