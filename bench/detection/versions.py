"""Another version of the detector beside this one, in one process: both look at the same pictures."""

from __future__ import annotations

import importlib
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, List, Tuple


@lru_cache(maxsize=None)
def other_detector(source: Path) -> Tuple[Tuple[Any, Any], Callable]:
    """Loads (DetectorParams, SpotDetector) and `search` of another version of the packages beside this one."""

    def ours() -> List[str]:
        return [name for name in sys.modules if name.split(".")[0] in ("vb_core", "vb_laser_detect")]

    kept = {name: sys.modules.pop(name) for name in ours()}
    sys.path[:0] = [str(source / package / "src") for package in ("vb_core", "vb_laser_detect")]
    try:
        detector = importlib.import_module("vb_laser_detect.detector")
        # older versions had other names
        homes = ("detection.image_geometry", "image_geometry", "frame")
        folder = Path(detector.__file__).parent
        geometry = next(home for home in homes if (folder / home.replace(".", "/")).with_suffix(".py").exists())
        if geometry == "frame":
            detector.SpotDetector.backfilled = property(lambda self: self.recalled)
        for kind in (detector.Spot, getattr(detector, "Candidate", detector.Spot)):
            if not hasattr(kind, "rejection"):
                kind.rejection = property(lambda self: self.refusal)
        return (detector.DetectorParams, detector.SpotDetector), importlib.import_module(
            f"vb_laser_detect.{geometry}"
        ).search
    finally:
        del sys.path[:2]
        for name in ours():
            del sys.modules[name]
        sys.modules.update(kept)
