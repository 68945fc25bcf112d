"""Finds laser spots in a camera's images, one call per frame.

Use it for any stationary or moving camera, with or without ROS: make one `SpotDetector` per camera and give it every
frame, including those without a spot, which show it what the floor looks like.

There are four stages: `vb_core.image_format` interprets the pixel values, `proposals` finds regions worth measuring,
`features` measures them and decides whether each shows a spot, and `tracking` decides which spot it is and whether it
counts. `projection` gives positions on the floor.

>>> import numpy as np
>>> detector = SpotDetector(DetectorParams())
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
from typing import List, Optional, Sequence, Tuple, Union

import numpy as np

from vb_core.errors import CodedError, ParameterError
from vb_core.image_format import AnyPicture, HalvedPicture, Picture
from vb_laser_detect.detection import features
from vb_laser_detect.detection.background import BLOCK, Region
from vb_laser_detect.detection.features import ImageTraits, SpotClassifier
from vb_laser_detect.detection.projection import ImageGeometry
from vb_laser_detect.detection.proposals import Proposer, SearchedImage
from vb_laser_detect.detection.tracking import Expected, Spot, SpotTracker
from vb_laser_detect.detector_params import DetectorParams

__all__ = ["DetectorParams", "Spot", "SpotDetector"]

_MIN_LEVEL = 0.86  # of what is bright in the room; of the known spots only 3 of 464 are darker, in darkened clips
_BLUR_PX = 3.0  # optics and pixels blur every spot by this, whatever its size
_MAX_DIAGONAL_SHARE = 0.09  # of the image's diagonal: a spot's largest diameter where no pose is known
_MAX_LATENESS = 1.0  # [s] an image older than the last one by more is not late: the clock was set
# from this probability on, a resting spot is kept out of the background; below it, it may be a ghost
_MIN_CERTAIN_PROBABILITY = 0.9


class SpotDetector:
    """Finds the spots of one camera; keeps its knowledge of the scene between frames.

    Attributes:
        candidates: the last frame's spots and rejected regions, for debug images.
        late: number of images left out because they arrived after a later one.
    """

    def __init__(self, params: Optional[DetectorParams] = None, classifier: Optional[SpotClassifier] = None) -> None:
        self.params = params or DetectorParams()
        self._classifier = classifier or features.packaged_classifier()
        self.late = 0
        self.reset()

    def set_params(self, params: DetectorParams) -> None:
        """Changes the parameters; the background stays.

        Raises:
            ParameterError: if `moving_camera` would change, which needs another detector.
        """
        if params.moving_camera != self.params.moving_camera:
            raise ParameterError("moving_camera", "cannot be changed while the detector runs")
        self.params = params
        self._tracker.confirm_frames, self._tracker.max_dwell_time = params.confirm_frames, params.max_dwell_time

    def reset(self) -> None:
        """Forgets the scene; the next frame begins a new one."""
        self.candidates: List[Spot] = []
        self._stamp: Optional[float] = None
        self._geometry: Optional[ImageGeometry] = None
        self._measured = False  # whether anything in the last image was bright enough to measure
        self._shape: Optional[Tuple[int, ...]] = None
        self._proposer = Proposer(self.params.moving_camera)
        self._tracker = SpotTracker(self.params.confirm_frames, self.params.max_dwell_time)

    @property
    def lamps(self) -> int:
        """Number of lights that were published as the spot before they had rested for too long."""
        return self._tracker.lamps

    def detect(
        self, image: Union[np.ndarray, AnyPicture], stamp: float, geometry: Optional[ImageGeometry] = None
    ) -> List[Spot]:
        """Searches one image.

        Args:
            image: a `Picture`, as from `PixelReader`, or a `HalvedPicture`; or uint8, (H, W, 3) bgr (or rgb: colours
                are only compared with each other) or (H, W) grey.
            stamp: [s] when it was taken. A late image is left out and counted in `late`; a stamp more than a second
                before the last one means that the clock was set, and the detector starts again.
            geometry: where its pixels are on the floor. None: sizes and speeds are judged in pixels.

        Returns:
            The spots that this image confirmed, oldest first: at most one of the image itself and, when a stroke
            begins, those of earlier images, with their own stamps and positions.

        Raises:
            CodedError: "bad_image" for any other image.
        """
        picture = _checked(image)
        behind = -math.inf if self._stamp is None else self._stamp - stamp
        if 0.0 < behind <= _MAX_LATENESS:
            self.late += 1
            self.candidates = []
            return []
        if self.params.moving_camera and (picture.mosaic or picture.scale > 1):
            # a mosaic cannot be warped by fractions of a pixel, and warping two sizes would take twice the time
            picture = Picture(picture.bgr(), "bgr")
        if picture.scale > 1 and self._measured:
            picture.decode_whole()  # what was measured in the last image is likely to be there still
        pixels = picture.searched
        shape = picture.scale, *pixels.shape
        if behind > _MAX_LATENESS or self._shape not in (None, shape):
            self.reset()
        elapsed = 0.0 if self._stamp is None else stamp - self._stamp
        self._stamp, self._shape, self._geometry = stamp, shape, geometry
        traits = ImageTraits(math.hypot(*picture.size), picture.mosaic)
        motion = self._proposer.estimate_motion(pixels)
        expected = self._tracker.begin(stamp, traits, motion)
        searched = self._proposer.propose(picture, expected)
        seen = self._examine_all(searched, traits._replace(bright=searched.background.bright), expected)
        confirmed, kept = self._confirm(seen)
        # a pause must not make one frame outweigh all earlier ones
        self._proposer.update_background(searched, kept, min(elapsed, 1.0))
        return confirmed

    def _examine_all(self, searched: SearchedImage, traits: ImageTraits, expected: List[Expected]) -> List[Spot]:
        """Measures and classifies an image's regions."""
        seen: List[Spot] = []
        self._measured, least = False, _MIN_LEVEL * traits.bright
        bright = [region for region in searched.regions if searched.brightest(region) >= least]
        diameters = dict(zip(bright, self._max_diameters(bright, traits)))
        for region in searched.regions:
            here = next((one for one in expected if one.overlaps(region)), None)
            if region in diameters:
                spot = self._examine(region, diameters[region], searched, traits, here)
            else:
                spot = _rejected(region, "too_dark")
            if here is not None and spot.rejection == "too_large":
                # by now, other light falls where the spot is expected
                part = here.clip(region)
                spot = self._examine(
                    part, self._max_diameters([part], traits)[0], searched, traits, here, here.max_width
                )
            if not any(_same_blob(spot, other) for other in seen):
                seen.append(spot)
        return seen

    def _examine(
        self,
        region: Region,
        max_diameter: float,
        searched: SearchedImage,
        traits: ImageTraits,
        expected: Optional[Expected],
        max_width: float = math.inf,
    ) -> Spot:
        """Measures and classifies the brightest blob of a region; see `features.measure`."""
        if math.isnan(max_diameter):
            return _rejected(region, "off_floor")
        self._measured = True
        image, reference = searched.picture.pixels, searched.background.whole_reference()
        if searched.brightest(region) < _MIN_LEVEL * traits.bright:  # now that it is decoded whole
            return _rejected(region, "too_dark")
        blob = features.measure(image, reference, region, max_diameter, traits, max_width)
        rejection, probability, floor_point = blob.problem, 0.0, None
        if not rejection:
            measured = {**blob.features, **searched.surroundings(blob.u, blob.v, blob.diameter)}
            is_expected = expected is not None and expected.holds(blob.u, blob.v)
            probability, reason = self._classifier.classify(blob, measured, is_expected)
            if probability < self.params.min_probability:
                rejection = reason
            elif self._geometry is not None:
                try:
                    floor_point = self._geometry.point(blob.u, blob.v)
                except CodedError as error:
                    rejection = error.code
        spot = Spot(blob.u, blob.v, blob.diameter, confidence=probability, rejection=rejection, tint=blob.tint)
        return replace(spot, stamp=self._stamp, floor_point=floor_point)

    def _confirm(self, seen: List[Spot]) -> Tuple[List[Spot], List[Spot]]:
        """Tracks spots; returns those to publish (at most one of this image), and those to keep out of the background.

        Adds all spots to `candidates`, with the reason if they are not published.
        """
        found = sorted((spot for spot in seen if not spot.rejection), key=lambda spot: -spot.confidence)
        self.candidates = [spot for spot in seen if spot.rejection]
        confirmed: List[Spot] = []
        kept: List[Spot] = []
        for spot, track in zip(found, self._tracker.update(found)):
            if track is None:
                self.candidates.append(replace(spot, rejection="lamp"))
                continue
            if track.published:
                rejection = ""
            else:
                rejection = "lower_confidence" if track.confirmed else "unconfirmed"
            spot = replace(spot, track=track.number, rejection=rejection)
            self.candidates.append(spot)
            if track.published:
                confirmed += track.unpublished + [spot]
                track.unpublished = []
            if spot.confidence >= max(_MIN_CERTAIN_PROBABILITY, self.params.min_probability):
                kept.append(spot)
        return confirmed, kept

    def _max_diameters(self, regions: Sequence[Region], traits: ImageTraits) -> List[float]:
        """Returns a spot's largest allowed diameter [px] in the middle of each region; NaN where no floor is seen."""
        if self._geometry is None or not regions:
            return [_MAX_DIAGONAL_SHARE * traits.diagonal] * len(regions)
        middles = np.array(regions).reshape(-1, 2, 2).mean(axis=1)
        return (0.001 * self.params.max_diameter_mm / self._geometry.meters_per_pixel(middles) + _BLUR_PX).tolist()


def _rejected(region: Region, rejection: str) -> Spot:
    left, top, right, bottom = region
    return Spot((left + right) / 2.0, (top + bottom) / 2.0, float(right - left), rejection=rejection)


def _same_blob(spot: Spot, other: Spot) -> bool:
    """Returns whether two regions have led to the same blob."""
    near = math.hypot(spot.u - other.u, spot.v - other.v) < 2.0
    return near and bool(other.rejection) == bool(spot.rejection)


def _checked(image: Union[np.ndarray, AnyPicture]) -> AnyPicture:
    if isinstance(image, HalvedPicture):
        return image
    picture = image if isinstance(image, Picture) else Picture(image, "mono" if np.ndim(image) == 2 else "bgr")
    pixels = np.asarray(picture.pixels)
    if pixels.dtype != np.uint8 or pixels.ndim not in (2, 3) or pixels.shape[2:] not in ((), (3,)):
        raise CodedError("bad_image", f"expected 8 bit mono, Bayer or colour pixels, got {pixels.dtype} {pixels.shape}")
    if min(pixels.shape[:2]) < 4 * BLOCK:
        raise CodedError("bad_image", f"the image is too small: {pixels.shape[1]} x {pixels.shape[0]}")
    return Picture(np.ascontiguousarray(pixels), picture.content)
