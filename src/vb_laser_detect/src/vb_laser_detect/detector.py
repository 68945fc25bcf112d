"""Finds laser spots in a camera's images, one call per frame.

Five stages that share only what they pass on: `image_format` says what the numbers mean, `proposals` where a
closer look is worth it, `features` what is there, `classifier` whether that is a spot, and `tracking` which spot it is and
whether it counts.

>>> import numpy as np
>>> detector = SpotDetector(DetectorParams.stationary())
>>> floor = np.full((480, 640, 3), 90, np.uint8)
>>> for frame in range(50):                                         # two seconds of an empty floor
...     spots = detector.detect(floor, stamp=0.04 * frame)
>>> spots
[]
"""
from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Callable, List, NamedTuple, Optional, Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError, ParameterError
from vb_laser_detect.detection import classifier, features
from vb_laser_detect.detection.blocks import BLOCK
from vb_laser_detect.detector_params import DetectorParams
from vb_laser_detect.detection.features import Blob, Camera
from vb_laser_detect.detection.floor_scale import ToFloor, metres_per_pixel
from vb_laser_detect.detection.image_format import BAYER
from vb_laser_detect.detection.proposals import Proposal, Proposer, View
from vb_laser_detect.detection.tracking import Sighting, SpotTracker

_SMEAR_PX = 3.0  # optics and pixels smear every spot by this, whatever its size
_LONGEST = 2.0  # times its diameter: a fast one is elongated
_WIDEST = 0.09  # of the image's diagonal, where no pose is known
_LEAST_PX = 2.5  # smaller blobs are noise
_LEAST_WHITE = 128.0  # [grey levels] no camera's white is darker
_VIVID = 0.4  # mean chroma of a laser's light on a floor; webcams show less, but other bright things even less
_PALE = 0.25  # ... of a laser on a floor that is nearly white; a mosaic's mean of white glints over half a second is less
# [s] colourless light is followed for longer before it counts: a glint on a shoe, a watch or a cup lasts
# less than a step, half a second. Nothing is lost, as the spots until then are backfilled
_STEP_S = 0.6
_CERTAIN = 0.9  # probability from which a spot that stays is kept out of the background: less, and it may be a ghost
# part of a spot's surroundings that lost light. A laser adds light and takes none: what darkens this much is
# an object, for instance a person's shirt; a hand or a foot beside the spot darkens less
_MAX_DARKER = 0.25


@dataclass(frozen=True)
class Spot:
    """A laser spot in an image.

    Attributes:
        u, v: [px] column and row, sub-pixel; the centre of the first pixel is 0.
        diameter: [px]
        confidence: 0 ... 1
        track: number of the spot in this camera's images; it stays while the spot is followed.
    """

    u: float
    v: float
    diameter: float
    confidence: float
    track: int = 0


@dataclass(frozen=True)
class BackfilledSpot:
    """A spot of an earlier frame that a later one confirmed.

    Attributes:
        stamp: [s] of its frame.
        tag: what `SpotDetector.tag` was then.
    """

    spot: Spot
    stamp: float
    tag: Any


@dataclass(frozen=True)
class Candidate:
    """The verdict on an examined place: `refusal` says why it is not a spot, or ""."""

    u: float
    v: float
    diameter: float
    confidence: float = 0.0
    refusal: str = ""


class _Finding(NamedTuple):
    """A measured proposal; `certain`: the image alone shows it, not only that it was expected there."""

    blob: Blob
    confidence: float = 0.0
    refusal: str = ""
    certain: bool = True

    def candidate(self, refusal: str = "") -> Candidate:
        """What a debug image shows of it."""
        return Candidate(self.blob.u, self.blob.v, self.blob.diameter, self.confidence, refusal or self.refusal)


class SpotDetector:
    """Finds the spots of one camera; keeps its knowledge of the scene between frames.

    Attributes:
        tag: whatever belongs to the next frame; it comes back with those of its spots that are backfilled later.
        candidates: the last frame's spots and rejected candidates, for debug images.
        backfilled: spots of earlier frames that the last one confirmed, the oldest first: what a stroke began with.
        encoding: of the images, as in sensor_msgs/Image; (H, W) images are grey ones unless it says bayer.
    """

    def __init__(self, params: Optional[DetectorParams] = None, judge: Optional[classifier.SpotClassifier] = None) -> None:
        self.params = params or DetectorParams.stationary()
        self.tag: Any = None
        self.encoding = ""
        self._given = judge
        self._to_floor: Optional[ToFloor] = None
        self._place_check: Optional[Callable[[float, float], str]] = None
        self._white = _LEAST_WHITE
        self.reset()
        self.retune(self.params)

    def look_from(
        self, to_floor: Optional[ToFloor], place_check: Optional[Callable[[float, float], str]] = None
    ) -> None:
        """Sets where the camera of the next frames is.

        Args:
            to_floor: pixels (N, 2) to the floor [m], for sizes in millimetres and speeds in m/s. None: in pixels.
            place_check: a pixel (u, v) to the reason why no spot can be there, or "".
        """
        self._to_floor, self._place_check = to_floor, place_check

    def retune(self, params: DetectorParams) -> None:
        """Changes the parameters; the background stays.

        Raises:
            ParameterError: for another `moving_camera`, which needs another detector.
            CodedError: "bad_classifier"
        """
        if params.moving_camera != self.params.moving_camera:
            raise ParameterError("moving_camera", "cannot be changed while the detector runs")
        self._classifier = self._given or classifier.load(params.classifier)
        self.params = params
        self._tracker.params = self._proposer.params = params

    def reset(self) -> None:
        """Forgets the scene; the next frame begins a new one."""
        self.candidates: List[Candidate] = []
        self.backfilled: List[BackfilledSpot] = []
        self._stamp: Optional[float] = None
        self._shape: Optional[Tuple[int, ...]] = None
        self._proposer, self._tracker = Proposer(self.params), SpotTracker(self.params)

    @property
    def confirmation_s(self) -> float:
        """[s] from a spot's first image to the one that confirms it, at the current rate."""
        return (self.params.confirm_frames - 1) * self._tracker.period_s

    def detect(self, image: np.ndarray, stamp: float) -> List[Spot]:
        """Searches one frame.

        Args:
            image: (H, W, 3) bgr (or rgb: colours are only compared with each other) or (H, W) mono or Bayer, uint8.
            stamp: [s] when it was taken. A stamp before the last one's starts again.

        Returns:
            Confirmed spots, the most certain first.

        Raises:
            CodedError: "bad_image" for any other image.
        """
        image = _checked(image)
        mosaic = image.ndim == 2 and self.encoding[:10] in BAYER
        if mosaic and self.params.moving_camera:
            # a mosaic cannot be moved by parts of a pixel
            image, mosaic = cv2.cvtColor(image, BAYER[self.encoding[:10]]), False
        if self._stamp is not None and stamp < self._stamp or self._shape not in (None, image.shape):
            self.reset()
        if self._shape is None:
            self._white = max(self._white, float(image.max()))
        elapsed = 0.0 if self._stamp is None else stamp - self._stamp
        self._stamp, self._shape = stamp, image.shape
        diagonal = math.hypot(*image.shape[:2])
        expected = self._tracker.begin(stamp, diagonal, self._proposer.motion(image))
        view = self._proposer.look(image, self._white, expected)
        self._white = view.white
        findings, self.candidates = self._examine_all(view, Camera(self._white, diagonal, mosaic))
        spots = self._confirm(findings, mosaic)
        kept = [(f.blob.u, f.blob.v, f.blob.diameter) for f in findings
                if not f.refusal and f.certain and f.confidence >= max(_CERTAIN, self.params.min_probability)]
        # a pause must not make one frame outweigh all earlier ones
        self._proposer.learn(view, kept, min(elapsed, 1.0))
        return spots

    def _examine_all(self, view: View, camera: Camera) -> Tuple[List[_Finding], List[Candidate]]:
        """Measures a view's proposals; the second list are those not examined."""
        findings: List[_Finding] = []
        left_out, proposals = [one for one in view.proposals if one.refusal], [one for one in view.proposals if not one.refusal]
        for number, (proposal, metre) in enumerate(zip(proposals, self._metres_in(proposals))):
            finding, one = self._examine(proposal, metre, view, camera), proposal.expected
            # two regions can lead to the same blob
            if not any(math.hypot(finding.blob.u - other.blob.u, finding.blob.v - other.blob.v) < 2.0
                       and bool(other.refusal) == bool(finding.refusal) for other in findings):
                findings.append(finding)
            if (self.params.max_spots == 1 and one is not None and one.published and finding.certain
                    and not finding.refusal and one.holds(finding.blob.u, finding.blob.v)):
                # the one spot is found where it is expected: nothing else can take its place
                left_out += [other._replace(refusal="not_looked_at") for other in proposals[number + 1 :]]
                break
        return findings, [Candidate((left + right) / 2.0, (top + bottom) / 2.0, float(right - left), refusal=other.refusal)
                          for other in left_out for left, top, right, bottom in [other.region]]

    def _examine(self, proposal: Proposal, metre: Optional[float], view: View, camera: Camera) -> _Finding:
        """Measures and judges one proposal; where a spot must be, also as what a brighter area left of it."""
        one, largest = proposal.expected, _LONGEST * self._sizes(metre, camera)[1]
        blob = features.measure(view.image, view.reference, proposal.region, largest, camera)
        finding = self._judge(blob, metre, view, camera, False)
        for edge in (features.EDGE, *features.CORES) if one is not None and one.trusted and finding.refusal else ():
            if edge != features.EDGE:
                blob = features.measure(view.image, view.reference, proposal.part, largest, camera, edge)
            if one.holds(blob.u, blob.v):
                again = self._judge(blob, metre, view, camera, True)
                if not again.refusal:
                    return again
        return finding

    def _judge(self, blob: Blob, metre: Optional[float], view: View, camera: Camera, expected: bool) -> _Finding:
        refusal = blob.problem or self._wrong_size(blob, metre, camera)
        if refusal:
            return _Finding(blob, refusal=refusal)
        numbers = {**blob.numbers, **view.around(blob.u, blob.v, blob.diameter)}
        verdict = self._classifier.judge(blob, numbers, expected)
        if verdict.probability < (max(self.params.min_probability, _CERTAIN) if expected else self.params.min_probability):
            refusal = verdict.against
        elif not expected and numbers["darker"] > _MAX_DARKER:
            refusal = "darker"
        elif self._place_check is not None:
            refusal = self._place_check(blob.u, blob.v)
        return _Finding(blob, verdict.probability, refusal, not expected)

    def _confirm(self, findings: List[_Finding], mosaic: bool) -> List[Spot]:
        """The spots to publish, the most certain first; notes the others, and why, in `candidates`."""
        found = sorted((f for f in findings if not f.refusal), key=lambda f: (not f.certain, -f.confidence))
        places = np.full((len(found), 4), np.nan)
        if found:
            places[:, :2] = [(f.blob.u, f.blob.v) for f in found]
            if self._to_floor is not None:
                places[:, 2:] = np.asarray(self._to_floor(places[:, :2]), float)[:, :2]
        spots = [Spot(f.blob.u, f.blob.v, f.blob.diameter, f.confidence) for f in found]
        sightings = [
            Sighting(place, f.confidence, f.certain, f.blob.tint, (spot, self._stamp, self.tag))
            for place, f, spot in zip(places, found, spots)]

        def agrees(tint: Optional[np.ndarray], followed_s: float) -> bool:
            """Whether the mean colour of a track's sightings is a laser's; one that is paler must be followed for a while."""
            least = _VIVID if followed_s < _STEP_S else _PALE if mosaic else 0.0
            return (0.0 if tint is None else features.chroma(tint)) >= least

        told, self.backfilled = [], []
        self.candidates += [f.candidate() for f in findings if f.refusal]
        for f, spot, track in zip(found, spots, self._tracker.update(sightings, agrees)):
            self.candidates.append(f.candidate("" if track.published else "less_certain" if track.confirmed else "unconfirmed"))
            if track.published:
                told.append(replace(spot, track=track.track))
                self.backfilled += [BackfilledSpot(replace(earlier, track=track.track), stamp, tag)
                                    for earlier, stamp, tag in track.backfilled]
        return told

    def _metres_in(self, proposals: List[Proposal]) -> List[Optional[float]]:
        """[m/px] on the floor in the middle of regions; None where the floor, or the camera's pose, is not known."""
        if self._to_floor is None:
            return [None] * len(proposals)
        middles = [((left + right) / 2.0, (top + bottom) / 2.0) for (left, top, right, bottom), *_ in proposals]
        return metres_per_pixel(self._to_floor, middles)

    def _sizes(self, metre: Optional[float], camera: Camera) -> Tuple[float, float]:
        """The least and the largest diameter [px] of a spot where a pixel is this long on the floor [m], or where is unknown."""
        if not metre:
            return _LEAST_PX, _WIDEST * camera.diagonal
        least, largest = (0.001 / metre * size for size in (self.params.min_diameter_mm, self.params.max_diameter_mm))
        return max(_LEAST_PX, least), largest + _SMEAR_PX

    def _wrong_size(self, blob: Blob, metre: Optional[float], camera: Camera) -> str:
        if self._to_floor is not None and not metre:
            # a person's region may have its middle above the horizon, and the spot on the floor
            metre = metres_per_pixel(self._to_floor, [(blob.u, blob.v)])[0]
            if metre is None:
                return "off_floor"
        least, largest = self._sizes(metre, camera)
        return "too_small" if blob.diameter < least else "too_large" if blob.diameter > largest else ""


def _checked(image: np.ndarray) -> np.ndarray:
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise CodedError("bad_image", f"expected 8 bit mono, Bayer or colour pixels, got {image.dtype} {image.shape}")
    if min(image.shape[:2]) < 4 * BLOCK:
        raise CodedError("bad_image", f"the image is too small: {image.shape[1]} x {image.shape[0]}")
    if image.ndim == 3 and image.shape[2] != 3:
        image = image[:, :, 0] if image.shape[2] == 1 else image[:, :, :3]
    return np.ascontiguousarray(image)
