"""A spot detector of this or another version, wired as the node does it: the only place that knows its interface."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List, NamedTuple, Optional

import numpy as np

from bench.frame import import_from
from vb_core.image_format import PixelReader


class Found(NamedTuple):
    """A spot, the time [s] of its image, which may be an earlier one that was confirmed only now, and its floor point."""

    stamp: float
    spot: Any
    place: Any


class Finder:
    """Searches images.

    Args:
        role: "stationary" or "mobile".
        source: folder `src` of another version; None: this one.
        judge: another classifier than the one that comes with the package.
        changes: parameters that differ from the role's.
    """

    def __init__(self, role: str, source: Optional[Path] = None, judge: Any = None, **changes: Any) -> None:
        (module,) = import_from(source, "vb_laser_detect.detector")
        params = getattr(module.DetectorParams, role)(**changes)
        self._detector = module.SpotDetector(params, *([judge] if judge is not None else []))
        self._reader = PixelReader()

    def find(self, image: np.ndarray, stamp: float, geometry: Any = None, encoding: str = "bgr8") -> List[Found]:
        """Searches an image as a driver sends it."""
        picture = self._reader.read(image, encoding)
        if hasattr(self._detector, "set_camera_pose"):
            return self._find_as_before(picture, stamp, geometry)
        return [Found(spot.stamp, spot, spot.place) for spot in self._detector.detect(picture, stamp, geometry)]

    def _find_as_before(self, picture: Any, stamp: float, geometry: Any) -> List[Found]:
        """Searches with a version that was told of the camera before each image, and gave its results in two places."""
        detector = self._detector

        def reject(u: float, v: float) -> str:
            try:
                geometry.point(u, v)
            except Exception as error:
                return error.code
            return ""

        detector.set_camera_pose(*((None,) if geometry is None else (geometry.to_floor, reject)))
        detector.tag, detector.encoding = geometry, f"{picture.content}8"
        spots = detector.detect(picture.pixels, stamp)
        told = [(one.stamp, one.spot, one.tag) for one in detector.backfilled] + [(stamp, s, geometry) for s in spots]
        return [Found(at, spot, where.point(spot.u, spot.v) if where else None) for at, spot, where in told]

    def why_not(self, u: float, v: float, reach: float = 25.0) -> str:
        """Returns why nothing near a pixel was taken for a spot in the last image."""
        near = [one for one in self._detector.candidates if np.hypot(one.u - u, one.v - v) < reach]
        return near[0].rejection or "another_spot" if near else "no_candidate"
