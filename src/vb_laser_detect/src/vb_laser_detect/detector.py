"""Finds laser spots in a camera's images, one call per frame.

Use it for any stationary or moving camera, with or without ROS: make one `SpotDetector` per camera and give it every
frame, also those without a spot, which show it what the floor looks like.

Five stages that share only what they pass on: `image_format` says what the numbers mean, `proposals` where a
closer look is worth it, `features` what is there, `classifier` whether that is a spot, and `tracking` which
spot it is and whether it counts.

>>> import numpy as np
>>> detector = SpotDetector(DetectorParams.stationary())
>>> floor = np.full((480, 640, 3), 90, np.uint8)
>>> for frame in range(50):                                         # two seconds of an empty floor
...     spots = detector.detect(floor, stamp=0.04 * frame)
>>> spots
[]
>>> image = floor.copy()
>>> image[239:244, 319:324] = (120, 120, 255)                       # a red spot (bgr) ...
>>> image[240:243, 320:323] = 255                                   # ... whose middle is saturated
>>> for frame in range(50, 60):
...     spots = detector.detect(image, stamp=0.04 * frame)
>>> [(round(spot.u), round(spot.v)) for spot in spots]              # [px]
[(321, 241)]
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Callable, List, Optional, Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError, ParameterError
from vb_laser_detect.detection import classifier, features
from vb_laser_detect.detection.blocks import BLOCK, Region
from vb_laser_detect.detection.features import Blob, ImageTraits
from vb_laser_detect.detection.projection import ToFloor, meters_per_pixel
from vb_laser_detect.detection.image_format import BAYER
from vb_laser_detect.detection.proposals import Proposal, Proposer, SearchedImage
from vb_laser_detect.detection.tracking import BackfilledSpot, Expected, Spot, SpotTracker
from vb_laser_detect.detector_params import DetectorParams

__all__ = ["BackfilledSpot", "DetectorParams", "Spot", "SpotDetector"]

_BLUR_PX = 3.0  # optics and pixels blur every spot by this, whatever its size
_MAX_DIAGONAL_SHARE = 0.09  # of the image's diagonal, where no pose is known
_MIN_PX = 2.5  # smaller blobs are noise
# probability from which a spot that stays is kept out of the background; with less, it may be a ghost
_MIN_CERTAIN_PROBABILITY = 0.9


class SpotDetector:
    """Finds the spots of one camera; keeps its knowledge of the scene between frames.

    Attributes:
        tag: anything that the caller wants to keep with the next frame; returned with each of its spots that is
            backfilled.
        candidates: the last frame's spots, and its proposals that were rejected, for debug images.
        backfilled: spots of earlier frames that the last one confirmed, the oldest first: what a stroke began with.
        encoding: of the images, as in sensor_msgs/Image; (H, W) images are grey ones unless it says bayer.
    """

    def __init__(
        self, params: Optional[DetectorParams] = None, spot_classifier: Optional[classifier.SpotClassifier] = None
    ) -> None:
        self.params = params or DetectorParams.stationary()
        self.tag: Any = None
        self.encoding = ""
        self._classifier_override = spot_classifier
        self.set_camera_pose(None)
        self.reset()
        self.set_params(self.params)

    def set_camera_pose(
        self, to_floor: Optional[ToFloor], place_check: Optional[Callable[[float, float], str]] = None
    ) -> None:
        """Sets where the camera of the next frames is.

        Args:
            to_floor: maps pixels (N, 2) to the floor [m], for sizes in millimetres and speeds in m/s. None: in pixels.
            place_check: returns why no spot can be at a pixel (u, v), or "".
        """
        self._to_floor, self._place_check = to_floor, place_check

    def set_params(self, params: DetectorParams) -> None:
        """Changes the parameters; the background stays.

        Raises:
            ParameterError: for another `moving_camera`, which needs another detector.
            CodedError: "bad_classifier"
        """
        if params.moving_camera != self.params.moving_camera:
            raise ParameterError("moving_camera", "cannot be changed while the detector runs")
        self._classifier = self._classifier_override or classifier.load(params.classifier)
        self.params = self._tracker.params = self._proposer.params = params

    def reset(self) -> None:
        """Forgets the scene; the next frame begins a new one."""
        self.candidates: List[Spot] = []
        self.backfilled: List[BackfilledSpot] = []
        self._stamp: Optional[float] = None
        self._shape: Optional[Tuple[int, ...]] = None
        self._proposer, self._tracker = Proposer(self.params), SpotTracker(self.params)

    @property
    def confirmation_s(self) -> float:
        """[s] from a spot's first image to the one that confirms it, at the current rate."""
        return (self.params.confirm_frames - 1) * self._tracker.period

    def detect(self, image: np.ndarray, stamp: float) -> List[Spot]:
        """Searches one frame.

        Args:
            image: (H, W, 3) bgr (or rgb: colours are only compared with each other) or (H, W) mono or Bayer, uint8.
            stamp: [s] when it was taken. A stamp before the last one's starts again.

        Returns:
            The confirmed spot, if there is one.

        Raises:
            CodedError: "bad_image" for any other image.
        """
        image = _checked(image)
        mosaic = image.ndim == 2 and self.encoding[:10] in BAYER
        if mosaic and self.params.moving_camera:
            # a mosaic cannot be moved by parts of a pixel
            image, mosaic = cv2.cvtColor(image, BAYER[self.encoding[:10]]), False
        jumped_back = self._stamp is not None and stamp < self._stamp
        if jumped_back or self._shape not in (None, image.shape):
            self.reset()
        elapsed = 0.0 if self._stamp is None else stamp - self._stamp
        self._stamp, self._shape = stamp, image.shape
        camera = ImageTraits(math.hypot(*image.shape[:2]), mosaic)
        expected = self._tracker.begin(stamp, camera, self._proposer.estimate_motion(image))
        searched = self._proposer.propose(image, expected)
        seen = self._examine_all(searched, camera._replace(white=searched.white))
        spots, kept = self._confirm(seen)
        # a pause must not make one frame outweigh all earlier ones
        self._proposer.update_background(searched, kept, min(elapsed, 1.0))
        return spots

    def _examine_all(self, searched: SearchedImage, camera: ImageTraits) -> List[Spot]:
        """Measures and classifies an image's proposals."""
        seen: List[Spot] = []
        followed = False
        for proposal in searched.proposals:
            rejection = proposal.rejection or ("not_examined" if followed else "")
            if rejection:
                spot = Spot(*proposal.middle, float(proposal.region[2] - proposal.region[0]), rejection=rejection)
            else:
                spot = self._examine(proposal, searched, camera)
            if not any(_same_blob(spot, other) for other in seen):
                seen.append(spot)
            # the one spot is found where it is expected: nothing else can take its place
            followed = followed or _is_followed_spot(spot, proposal.expected)
        return seen

    def _examine(self, proposal: Proposal, searched: SearchedImage, camera: ImageTraits) -> Spot:
        """Measures and classifies one proposal."""
        region, expected = proposal.region, proposal.expected
        spot = self._classify(region, expected, searched, camera)
        if expected is not None and spot.rejection == "too_large":
            # by now, other light falls on the place where it is expected
            spot = self._classify(expected.clip(region), expected, searched, camera, expected.widest)
        return spot

    def _classify(
        self,
        region: Region,
        expected: Optional[Expected],
        searched: SearchedImage,
        camera: ImageTraits,
        widest: float = math.inf,
    ) -> Spot:
        """Measures and classifies the brightest blob of a region; see `features.measure`."""
        middle = (region[0] + region[2]) / 2.0, (region[1] + region[3]) / 2.0
        largest = self._size_range(self._pixel_size(*middle), camera)[1]
        blob = features.measure(searched.image, searched.reference, region, largest, camera, widest)
        rejection, probability = blob.problem or self._wrong_size(blob, camera), 0.0
        if not rejection:
            measured = {**blob.features, "busy": searched.change_elsewhere(blob.u, blob.v, blob.diameter)}
            is_expected = expected is not None and expected.holds(blob.u, blob.v)
            probability, reason = self._classifier.classify(blob, measured, is_expected)
            if probability < self.params.min_probability:
                rejection = reason
            elif self._place_check is not None:
                rejection = self._place_check(blob.u, blob.v)
        return Spot(blob.u, blob.v, blob.diameter, probability, rejection=rejection, tint=blob.tint)

    def _confirm(self, seen: List[Spot]) -> Tuple[List[Spot], List[Spot]]:
        """Follows the spots; returns those to publish (at most one), and those to keep out of the background.

        Notes the others, and why they are not published, in `candidates`.
        """
        found = sorted((spot for spot in seen if not spot.rejection), key=lambda spot: -spot.confidence)
        if found and self._to_floor is not None:
            floor = np.asarray(self._to_floor(np.array([(spot.u, spot.v) for spot in found])), float)
            found = [replace(spot, floor=(x, y)) for spot, (x, y) in zip(found, floor[:, :2])]
        self.candidates = [spot for spot in seen if spot.rejection]
        confirmed: List[Spot] = []
        kept: List[Spot] = []
        self.backfilled = []
        for spot, track in zip(found, self._tracker.update(found, self.tag)):
            if track.published:
                rejection = ""
            else:
                rejection = "lower_confidence" if track.confirmed else "unconfirmed"
            spot = replace(spot, track=track.number, rejection=rejection)
            self.candidates.append(spot)
            if track.published:
                confirmed.append(spot)
                self.backfilled += track.unpublished
                track.unpublished = []
            certain = spot.confidence >= max(_MIN_CERTAIN_PROBABILITY, self.params.min_probability)
            if certain and self._stamp - track.dwelling_since < self.params.max_dwell_time:
                kept.append(spot)
        return confirmed, kept

    def _pixel_size(self, u: float, v: float) -> float:
        """Returns a pixel's length on the floor [m]; NaN where that is not known."""
        return meters_per_pixel(self._to_floor, u, v) if self._to_floor is not None else math.nan

    def _size_range(self, pixel_size: float, camera: ImageTraits) -> Tuple[float, float]:
        """Returns a spot's smallest and largest diameter [px] where a pixel is this long on the floor [m]."""
        if math.isnan(pixel_size):
            return _MIN_PX, _MAX_DIAGONAL_SHARE * camera.diagonal
        smallest, largest = (
            0.001 / pixel_size * size for size in (self.params.min_diameter_mm, self.params.max_diameter_mm)
        )
        return max(_MIN_PX, smallest), largest + _BLUR_PX

    def _wrong_size(self, blob: Blob, camera: ImageTraits) -> str:
        pixel_size = self._pixel_size(blob.u, blob.v)
        if self._to_floor is not None and math.isnan(pixel_size):
            return "off_floor"
        smallest, largest = self._size_range(pixel_size, camera)
        if blob.diameter < smallest:
            return "too_small"
        return "too_large" if blob.diameter > largest else ""


def _same_blob(spot: Spot, other: Spot) -> bool:
    """Returns whether two regions have led to the same blob."""
    near = math.hypot(spot.u - other.u, spot.v - other.v) < 2.0
    return near and bool(other.rejection) == bool(spot.rejection)


def _is_followed_spot(spot: Spot, expected: Optional[Expected]) -> bool:
    """Returns whether a spot is the published one, where it was expected."""
    return expected is not None and expected.published and not spot.rejection and expected.holds(spot.u, spot.v)


def _checked(image: np.ndarray) -> np.ndarray:
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise CodedError("bad_image", f"expected 8 bit mono, Bayer or colour pixels, got {image.dtype} {image.shape}")
    if min(image.shape[:2]) < 4 * BLOCK:
        raise CodedError("bad_image", f"the image is too small: {image.shape[1]} x {image.shape[0]}")
    return np.ascontiguousarray(image)
