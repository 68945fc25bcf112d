"""A spot detector of this or another version, wired as the node does it: the only place that knows its interface."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List, Optional

import numpy as np

from bench.frame import import_from
from vb_core.errors import CodedError


class _TheirGeometry:
    """An image's geometry for another version, whose own errors it raises."""

    def __init__(self, geometry: Any, error: type) -> None:
        self._geometry, self._error, self.to_floor = geometry, error, geometry.to_floor

    def point(self, u: float, v: float) -> Any:
        """See `ImageGeometry.point`."""
        try:
            return self._geometry.point(u, v)
        except CodedError as error:
            raise self._error(error.code) from None


class Finder:
    """Searches images.

    Args:
        role: "stationary" or "mobile".
        source: folder `src` of another version; None: this one.
        judge: another classifier than the one that comes with the package.
        changes: parameters that differ from the role's.
    """

    def __init__(self, role: str, source: Optional[Path] = None, judge: Any = None, **changes: Any) -> None:
        modules = import_from(source, "vb_laser_detect.detector", "vb_core.image_format", "vb_core.errors")
        module, images, self._errors = modules
        self._detector = module.SpotDetector(getattr(module.DetectorParams, role)(**changes), judge)
        self._reader, self._other = images.PixelReader(), source is not None

    def find(self, image: np.ndarray, stamp: float, geometry: Any = None, encoding: str = "bgr8") -> List[Any]:
        """Searches an image as a driver sends it; returns spots, also of earlier images that were confirmed only now."""
        if self._other and geometry is not None:
            geometry = _TheirGeometry(geometry, self._errors.CodedError)
        return self._detector.detect(self._reader.read(image, encoding), stamp, geometry)
