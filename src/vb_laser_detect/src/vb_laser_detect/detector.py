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
from typing import Any, Callable, Dict, List, Optional, Tuple

import numpy as np

from vb_core.errors import CodedError, ParameterError
from vb_laser_detect import classifier, features
from vb_laser_detect.blocks import BLOCK
from vb_laser_detect.colour import chroma
from vb_laser_detect.detector_params import DetectorParams
from vb_laser_detect.features import Blob, Camera
from vb_laser_detect.floor_scale import ToFloor, metres_per_pixel
from vb_laser_detect.image_format import is_mosaic
from vb_laser_detect.proposals import Proposal, Proposer, View
from vb_laser_detect.tracking import Sighting, SpotTracker

_SMEAR_PX = 3.0  # optics and pixels smear every spot by this, whatever its size
_LONGEST = 2.0  # times its diameter: a fast one is elongated
_WIDEST = 0.09  # of the image's diagonal, where no pose is known
_LEAST_PX = 2.5  # smaller blobs are noise
_LEAST_WHITE = 128.0  # [grey levels] no camera's white is darker
_VIVID = 0.4  # chroma of a laser's light on a floor; webcams show less, but other bright things even less
_ONE_MOSAIC = 0.75  # a small spot's colour in one mosaic depends on the places it falls on; in a mean it does not
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


@dataclass(frozen=True)
class _Finding:
    """A measured proposal; `told`: it continues a track that was published, and that the image alone shows."""

    blob: Blob
    numbers: Dict[str, float]
    confidence: float = 0.0
    refusal: str = ""
    certain: bool = True
    told: bool = False


class SpotDetector:
    """Finds the spots of one camera; keeps its knowledge of the scene between frames.

    Attributes:
        tag: whatever belongs to the next frame; it comes back with those of its spots that are backfilled later.
        candidates: the last frame's spots and rejected candidates, for debug images.
        backfilled: spots of earlier frames that the last one confirmed, the oldest first: what a stroke began with.
        encoding: of the images, as in sensor_msgs/Image; empty: a Bayer mosaic is recognised by its pixels.
    """

    def __init__(self, params: Optional[DetectorParams] = None, judge: Optional[classifier.SpotClassifier] = None) -> None:
        self.params = params or DetectorParams.stationary()
        self.tag: Any = None
        self.encoding = ""
        self._given = judge
        self._classifier = judge or classifier.load(self.params.classifier)
        self._least_chroma = self._classifier.least_chroma(self.params.min_probability)
        self._to_floor: Optional[ToFloor] = None
        self._place_check: Optional[Callable[[float, float], str]] = None
        self._white = _LEAST_WHITE
        self.reset()

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
        self._least_chroma = self._classifier.least_chroma(params.min_probability)
        self._tracker.retune(params.confirm_frames, params.max_speed, params.max_gap_s, params.max_spots)
        self._proposer.retune(params.hold_s)

    def reset(self) -> None:
        """Forgets the scene; the next frame begins a new one."""
        p = self.params
        self.candidates: List[Candidate] = []
        self.backfilled: List[BackfilledSpot] = []
        self._stamp: Optional[float] = None
        self._mosaic = False
        self._shape: Optional[Tuple[int, ...]] = None
        self._proposer = Proposer(p.moving_camera, p.hold_s)
        self._tracker = SpotTracker(p.confirm_frames, p.max_speed, p.max_gap_s, p.max_spots)

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
        if self._stamp is not None and stamp < self._stamp or self._shape not in (None, image.shape):
            self.reset()
        if self._shape is None:
            self._mosaic, self._shape = is_mosaic(image, self.encoding), image.shape
            self._white = max(self._white, float(image.max()))
        elapsed = 0.0 if self._stamp is None else stamp - self._stamp
        self._stamp = stamp
        p, mosaic, diagonal = self.params, self._mosaic, math.hypot(*image.shape[:2])
        motion = self._proposer.motion(image, mosaic)
        expected = self._tracker.begin(stamp, diagonal, motion)
        view = self._proposer.look(image, mosaic, p.min_rise, p.max_candidates, self._white, expected)
        self._white = max(self._white, view.white)
        camera = Camera(self._white, diagonal, mosaic, view.moved)
        found_spots, left_out = self._look(view, camera)
        found = sorted((f for f in found_spots if not f.refusal), key=lambda f: (not f.certain, -f.confidence))
        spots, refusals = self._confirm(found, camera)
        # a pause must not make one frame outweigh all earlier ones
        kept = [(f.blob.u, f.blob.v, f.blob.diameter) for f in found
                # whatever floor the light of a moment ago showed: a published spot is not floor
                if (view.known and f.certain and f.confidence >= max(_CERTAIN, p.min_probability)
                    and (f.told or self._is_proven(f.blob, camera)))
                # a robot's first image: whatever is pale belongs to the floor, a lamp more likely than a spot
                or (not view.known and (not p.moving_camera or _is_vivid(f.blob, camera)))]
        self._proposer.learn(view, kept, min(elapsed, 1.0))
        self.candidates = [_candidate(f, refusals.get(id(f), f.refusal)) for f in found_spots] + left_out
        return spots

    def _look(self, view: View, camera: Camera) -> Tuple[List[_Finding], List[Candidate]]:
        """Measures a view's proposals; the second list are those not examined."""
        found_spots: List[_Finding] = []
        left_out = [_unmeasured(proposal, proposal.refusal) for proposal in view.proposals if proposal.refusal]
        proposals = [proposal for proposal in view.proposals if not proposal.refusal]
        for number, (proposal, metre) in enumerate(zip(proposals, self._metres_in(proposals))):
            issue = self._examine(proposal, metre, view, camera)
            one = proposal.expected
            if one is not None and one.published and one.trusted and one.holds(issue.blob.u, issue.blob.v):
                issue = replace(issue, told=True)
            if not _is_double(issue, found_spots):
                found_spots.append(issue)
            if (self.params.max_spots == 1 and one is not None and one.published and one.moves and issue.certain
                    and not issue.refusal and one.holds(issue.blob.u, issue.blob.v)):
                # the one spot is drawn with, and found where it is expected: nothing else can take its place
                left_out += [_unmeasured(other, "not_looked_at") for other in proposals[number + 1 :]]
                break
        return found_spots, left_out

    def _examine(self, proposal: Proposal, metre: Optional[float], view: View, camera: Camera) -> _Finding:
        """Measures and judges one proposal."""
        largest, one = self._largest(metre, camera), proposal.expected
        chroma_floor: Optional[float] = 0.0
        if camera.mosaic and one is None:
            chroma_floor = _ONE_MOSAIC * self._least_chroma
        elif camera.mosaic and one.published and one.trusted and self.params.confirm_frames > 1:
            chroma_floor = None  # a published spot has shown its colour, and in a mosaic that takes longest to measure
        blob = features.measure(view.image, view.reference, proposal.region, largest, least_chroma=chroma_floor)
        issue = self._judge(blob, metre, view, camera, False)
        if one is None or not one.trusted or not issue.refusal:
            return issue
        if one.holds(blob.u, blob.v) and not blob.problem:
            issue = self._judge(blob, metre, view, camera, True)
        if issue.refusal:
            # it has come to a bright line, or to the edge of a larger brighter area: its core exceeds that
            for edge in (features.CORE, features.CORE_OF_MORE):
                core = features.measure(view.image, view.reference, proposal.part, largest, edge)
                again = self._judge(core, metre, view, camera, True)
                if not again.refusal and one.holds(core.u, core.v):
                    return again
        return issue

    def _judge(self, blob: Blob, metre: Optional[float], view: View, camera: Camera, expected: bool) -> _Finding:
        refusal = blob.problem or self._wrong_size(blob, metre)
        if refusal:
            return _Finding(blob, {}, refusal=refusal)
        numbers = features.vector(blob, view.around(blob.u, blob.v, blob.diameter), camera)
        if camera.mosaic:
            numbers["chroma_mosaic"] = min(1.0, numbers["chroma_mosaic"] / _ONE_MOSAIC)
        verdict = self._classifier.judge(blob, numbers, expected)
        least = max(self.params.min_probability, _CERTAIN) if expected else self.params.min_probability
        if verdict.probability < least:
            refusal = verdict.against
        elif not expected and numbers["darker"] > _MAX_DARKER:
            refusal = "darker"
        elif self._place_check is not None:
            refusal = self._place_check(blob.u, blob.v)
        return _Finding(blob, numbers, verdict.probability, refusal, not expected)

    def _confirm(self, found: List[_Finding], camera: Camera) -> Tuple[List[Spot], Dict[int, str]]:
        """The spots to publish, the most certain first; and why others are not."""
        sightings, spots = [], []
        floor = None
        if self._to_floor is not None and found:
            floor = np.asarray(self._to_floor(np.array([(f.blob.u, f.blob.v) for f in found])), float)[:, :2].tolist()
        for number, f in enumerate(found):
            b = f.blob
            spots.append(Spot(b.u, b.v, b.diameter, f.confidence))
            sightings.append(Sighting(
                (b.u, b.v), tuple(floor[number]) if floor is not None else None, f.confidence, f.certain,
                f.told or self._is_proven(b, camera), b.tint, (spots[-1], self._stamp, self.tag, f.numbers)))
        tracked = self._tracker.update(
            sightings, lambda sighting, tint, followed_s: self._agrees(sighting, tint, followed_s, camera))
        told, refusals = [], {}
        self.backfilled = []
        for f, spot, track in zip(found, spots, tracked):
            if track.published:
                told.append(replace(spot, track=track.track))
                self.backfilled += [BackfilledSpot(replace(content[0], track=track.track), *content[1:3])
                                  for _, content in track.backfilled]
            else:
                refusals[id(f)] = "less_certain" if track.confirmed else "unconfirmed"
        return told, refusals

    def _is_proven(self, blob: Blob, camera: Camera) -> bool:
        """Whether a blob is not a lamp that was there from the start; see `tracking.Sighting`."""
        return self._proposer.proven(blob.u, blob.v) or _is_vivid(blob, camera)

    def _agrees(self, sighting: Sighting, tint: Optional[np.ndarray], followed_s: float, camera: Camera) -> bool:
        """Whether a track's last sighting is a spot with the mean colour of all of them; without one, after a while."""
        if not camera.mosaic:
            return followed_s >= _STEP_S or len(tint) == 3 and chroma(tint) >= _VIVID
        numbers = {**sighting.content[3], "chroma_mosaic": chroma(tint)}
        return self._classifier.judge(None, numbers).probability >= self.params.min_probability

    # ------------------------------------------------------------- sizes
    def _metres_in(self, proposals: List[Proposal]) -> List[Optional[float]]:
        """[m/px] on the floor in the middle of regions; None where the floor, or the camera's pose, is not known."""
        if self._to_floor is None:
            return [None] * len(proposals)
        middles = [((left + right) / 2.0, (top + bottom) / 2.0) for (left, top, right, bottom), *_ in proposals]
        return metres_per_pixel(self._to_floor, middles)

    def _largest(self, metre: Optional[float], camera: Camera) -> float:
        """[px] the largest extent of a spot where a pixel is this long; anything larger, as clothes, is skipped."""
        widest = _WIDEST * camera.diagonal
        return _LONGEST * (self.params.max_diameter_mm / 1e3 / metre + _SMEAR_PX if metre else widest)

    def _wrong_size(self, blob: Blob, metre: Optional[float]) -> str:
        if blob.diameter < _LEAST_PX:
            return "too_small"
        if self._to_floor is None:
            return "too_large" if blob.diameter > _WIDEST * math.hypot(*self._shape[:2]) else ""
        # a person's region may have its middle above the horizon, and the spot on the floor
        metre = metre or metres_per_pixel(self._to_floor, [(blob.u, blob.v)])[0]
        if metre is None:
            return "off_floor"
        if (blob.diameter - _SMEAR_PX) * metre > self.params.max_diameter_mm / 1e3:
            return "too_large"
        return "too_small" if blob.diameter * metre < self.params.min_diameter_mm / 1e3 else ""


def _is_vivid(blob: Blob, camera: Camera) -> bool:
    """Whether a blob is so coloured that only a laser's light is likely."""
    coloured = blob.tint is not None and (camera.mosaic or len(blob.tint) == 3)
    return coloured and chroma(blob.tint) >= _VIVID


def _candidate(issue: _Finding, refusal: str) -> Candidate:
    blob = issue.blob
    return Candidate(blob.u, blob.v, blob.diameter, issue.confidence, refusal)


def _unmeasured(proposal: Proposal, refusal: str) -> Candidate:
    left, top, right, bottom = proposal.region
    return Candidate((left + right) / 2.0, (top + bottom) / 2.0, float(right - left), refusal=refusal)


def _is_double(issue: _Finding, others: List[_Finding]) -> bool:
    """Two regions can lead to the same blob; the first stays."""
    b = issue.blob
    return any(math.hypot(b.u - o.blob.u, b.v - o.blob.v) < 2.0 and bool(o.refusal) == bool(issue.refusal)
               for o in others)


def _checked(image: np.ndarray) -> np.ndarray:
    image = np.asarray(image)
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (1, 3, 4)):
        raise CodedError("bad_image", f"expected 8 bit mono, Bayer or colour pixels, got {image.dtype} {image.shape}")
    if min(image.shape[:2]) < 4 * BLOCK:
        raise CodedError("bad_image", f"the image is too small: {image.shape[1]} x {image.shape[0]}")
    if image.ndim == 3 and image.shape[2] != 3:
        image = image[:, :, 0] if image.shape[2] == 1 else image[:, :, :3]
    return np.ascontiguousarray(image)
