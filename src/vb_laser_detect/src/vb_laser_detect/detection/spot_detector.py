"""Finds laser spots in a camera's images, one call per frame.

Use it for any stationary or moving camera, with or without ROS. Make one `SpotDetector` per camera and give it every
frame, including those without a spot, which show it what the floor looks like.

`SpotDetector.detect` calls all stages in order. Each is a module of `detection`, and `stage_results` has what they return.

>>> import numpy as np
>>> detector = SpotDetector(DetectorParams())
>>> floor = np.full((480, 640, 3), 90, np.uint8)
>>> for frame in range(50):                                         # two seconds of an empty floor
...     found = detector.detect(floor, stamp=0.04 * frame)
>>> found.spots
[]
>>> image = floor.copy()
>>> image[239:244, 319:324] = (120, 120, 255)                       # a red spot (bgr) ...
>>> image[240:243, 320:323] = 255                                   # ... whose middle is saturated
>>> for frame in range(50, 60):
...     found = detector.detect(image, stamp=0.04 * frame)
>>> [(round(spot.u), round(spot.v)) for spot in found.spots]              # [px]
[(321, 241)]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple, Union

import numpy as np

from vb_core.errors import CodedError, ParameterError
from vb_core.image_format import AnyPicture, HalvedPicture, Picture
from vb_core.parameters import Parameters, param
from vb_laser_detect.detection import features
from vb_laser_detect.detection.background import Background
from vb_laser_detect.detection.changed_regions import find_regions
from vb_laser_detect.detection.features import SpotClassifier
from vb_laser_detect.detection.image_registration import ImageRegistration
from vb_laser_detect.detection.projection import ImageGeometry
from vb_laser_detect.detection.spot_tracker import SpotTracker
from vb_laser_detect.detection.stage_results import BLOCK, DetectionResult, Motion, SearchedImage, Spot

__all__ = ["DetectionResult", "DetectorParams", "Spot", "SpotDetector"]

# lowest level of a spot, as a share of `bright_level`; only 3 of 464 known spots are darker, all in darkened clips
_MIN_LEVEL = 0.86
_MAX_DIAGONAL_SHARE = 0.09  # a spot's largest diameter if no pose is known, as a share of the image's diagonal
_MAX_LATENESS = 1.0  # [s] by which an image may be older than the last one; if it is even older, the clock was set
# a spot at least this probable is never averaged into the background; a less probable one may be a ghost
_MIN_CERTAIN_PROBABILITY = 0.9


@dataclass(frozen=True)
class DetectorParams(Parameters):
    """The detector's parameters, by default those of a stationary camera.

    config/stationary.yaml lists them with their meanings, config/mobile.yaml those that differ.
    """

    moving_camera: bool = param(False)
    confirm_frames: int = param(4, "frames", low=1, high=50, doc="number of images in which a spot must be seen")
    min_probability: float = param(
        0.5, "", above=0.0, high=0.999, doc="probability that the classifier must give to a spot"
    )
    max_diameter_mm: float = param(80.0, "mm", low=1.0, high=1000.0, doc="largest diameter of a spot on the floor")
    max_dwell_time: float = param(
        25.0, "s", low=10.0, high=3600.0, doc="time after which a light that stays in one place is a lamp, not a spot"
    )

    @classmethod
    def mobile(cls, **changes) -> "DetectorParams":
        """Returns the parameters for a camera on a robot."""
        return cls(**{**dict(moving_camera=True, confirm_frames=3), **changes})


class SpotDetector:
    """Finds the spots in one camera's images. Its knowledge of the scene is kept between frames.

    Args:
        may_rest: whether light that shows no colour may be a spot although it has never moved: only for a pointer that may
            lie on something, as during calibration. Otherwise such light is taken for paper or a reflection.
    """

    def __init__(
        self,
        params: Optional[DetectorParams] = None,
        classifier: Optional[SpotClassifier] = None,
        may_rest: bool = False,
    ) -> None:
        self.params = params or DetectorParams()
        self._may_rest = may_rest
        self._classifier = classifier or features.packaged_classifier()
        self.reset()

    def set_params(self, params: DetectorParams) -> None:
        """Changes the parameters, without forgetting the background.

        Raises:
            ParameterError: `moving_camera` would change, which needs another detector.
        """
        if params.moving_camera != self.params.moving_camera:
            raise ParameterError("moving_camera", "cannot be changed while the detector runs")
        self.params = params
        self._tracker.confirm_frames, self._tracker.max_dwell_time = params.confirm_frames, params.max_dwell_time

    def reset(self) -> None:
        """Forgets the scene. The next frame begins a new one."""
        self._stamp: Optional[float] = None
        self._measured = False  # whether anything in the last image had to be measured at full size
        self._shape: Optional[Tuple[int, ...]] = None
        self._background = Background()
        self._registration = ImageRegistration() if self.params.moving_camera else None
        self._tracker = SpotTracker(self.params.confirm_frames, self.params.max_dwell_time, self._may_rest)

    def detect(
        self, image: Union[np.ndarray, AnyPicture], stamp: float, geometry: Optional[ImageGeometry] = None
    ) -> DetectionResult:
        """Searches one image.

        Args:
            image: a `Picture`, as from `PixelReader`, or a `HalvedPicture`; or uint8, (H, W) grey or (H, W, 3) bgr. rgb
                serves as well, because colours are only compared with each other.
            stamp: [s] when it was taken. A late image is left out. A stamp more than a second before the last one means
                that the clock was set, and the detector starts again.
            geometry: maps the image's pixels to the floor; without it, sizes and speeds are limited in pixels.

        Raises:
            CodedError: "bad_image" for any other image.
        """
        picture = _check_image(image)
        behind = -math.inf if self._stamp is None else self._stamp - stamp
        if 0.0 < behind <= _MAX_LATENESS:
            return DetectionResult(is_late=True)
        picture = self._prepare(picture)
        shape = picture.scale, *picture.search_pixels.shape
        if behind > _MAX_LATENESS or self._shape not in (None, shape):
            self.reset()
        elapsed = 0.0 if self._stamp is None else stamp - self._stamp
        self._stamp = stamp
        self._shape = shape

        motion, motion_since_keyframe = self._estimate_motion(picture)
        expected = self._tracker.predict(stamp, motion)
        comparison = self._background.compare(picture, motion_since_keyframe, expected)
        min_level = _MIN_LEVEL * self._background.bright_level
        searched = SearchedImage(
            picture,
            diagonal=math.hypot(*picture.size),
            bright_level=self._background.bright_level,
            min_level=min_level,
            regions=find_regions(picture, comparison, min_level, expected),
            reference=comparison.reference,
            shifted=comparison.motion is not None,
            changed=comparison.changed,
            ghost_s=self._background.ghost_s,
        )
        boxes = [box for region in searched.regions for box in region.boxes]
        max_diameters = dict.fromkeys(boxes, _MAX_DIAGONAL_SHARE * searched.diagonal)
        pose_error = None
        if geometry is not None:
            max_diameters, pose_error = geometry.max_diameters(boxes, 0.001 * self.params.max_diameter_mm)
        candidates = features.examine_regions(searched, max_diameters, self._classifier, self.params.min_probability)
        self._measured = any(
            region.boxes and candidate.rejection not in ("off_floor", "too_large")
            for region, candidate in zip(searched.regions, candidates)
        )
        if geometry is not None:
            candidates = geometry.locate(candidates)
        detection = self._tracker.update(candidates, searched)
        certain = max(_MIN_CERTAIN_PROBABILITY, self.params.min_probability)
        tracked = [spot for spot in detection.candidates if spot.track]
        kept_out = [spot for spot in tracked if spot.confidence >= certain]
        # a pause must not make one frame outweigh all earlier ones
        self._background.update(picture, comparison, kept_out, min(elapsed, 1.0))
        return detection._replace(pose_error=pose_error)

    def _prepare(self, picture: AnyPicture) -> AnyPicture:
        """Decodes as much of a picture as will be needed."""
        if self.params.moving_camera and (picture.is_bayer or picture.scale > 1):
            # a mosaic cannot be warped by fractions of a pixel, and warping two sizes would take twice the time
            return Picture(picture.bgr(), "bgr")
        if picture.scale > 1 and self._measured:
            picture.decode_full_size()  # what was measured in the last image is probably still there
        return picture

    def _estimate_motion(self, picture: AnyPicture) -> Tuple[Motion, Motion]:
        """Returns the camera's motions since the last image and since the keyframe."""
        if self._registration is None:
            return None, None
        if self._background.is_keyframe:
            self._registration.set_keyframe()
        motion = self._registration.follow(picture.search_pixels)
        return motion, self._registration.motion


def _check_image(image: Union[np.ndarray, AnyPicture]) -> AnyPicture:
    """Returns a valid image as a picture with contiguous pixels."""
    if isinstance(image, HalvedPicture):
        return image
    if not isinstance(image, Picture):
        image = Picture(image, "mono" if np.ndim(image) == 2 else "bgr")
    pixels = np.asarray(image.pixels)
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or pixels.shape[2:] not in ((), (3,)):
        raise CodedError("bad_image", f"expected 8 bit mono, Bayer or colour pixels, got {pixels.dtype} {pixels.shape}")
    if min(pixels.shape[:2]) < 4 * BLOCK:
        raise CodedError("bad_image", f"the image is too small: {pixels.shape[1]} x {pixels.shape[0]}")
    return Picture(np.ascontiguousarray(pixels), image.color_format)
