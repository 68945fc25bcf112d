"""Runs a spot detector of this or another version as the node does, and scores it on labelled frames.

Only this module uses the detector's interface, and decides which of its spots are right.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

import numpy as np

from bench.harness import import_from
from vb_evaluation.statistics import proportion

Pixel = Tuple[float, float]  # (u, v)


class LabeledFrame(NamedTuple):
    """One image of a clip or scene.

    Attributes:
        image: as from a camera driver, in `encoding`, or the bytes of a "jpeg", as from a camera read directly.
        spots: positions of its spots, (u, v) [px] unless stated otherwise.
        unclear: positions that are not scored: a pulse's first or last light, unlabelled pulses, half-hidden spots.
        geometry: makes the `ImageGeometry`, given the module `projection` of a version; None if it is unknown.
        shots: in a clip, the shot to which each spot belongs.
    """

    stamp: float
    image: Union[np.ndarray, bytes]
    spots: Sequence[Pixel]
    unclear: Sequence[Pixel] = ()
    geometry: Optional[Callable[[Any], Any]] = None
    shots: Sequence[int] = ()
    encoding: str = "bgr8"


class DetectorRunner:
    """Searches images with a detector.

    Args:
        role: "stationary" or "mobile".
        source: folder `src` of another version; None for this one.
        classifier: one to use instead of the package's.
        changes: parameters that differ from those of the role.
    """

    def __init__(self, role: str, source: Optional[Path] = None, classifier: Any = None, **changes: Any) -> None:
        names = ("detection.spot_detector", "detection.projection", "camera.camera_source")
        modules = import_from(source, "vb_core.image_format", *(f"vb_laser_detect.{name}" for name in names))
        images, module, self._projection, self._source = modules
        params = module.DetectorParams.mobile if role == "mobile" else module.DetectorParams
        self._detector = module.SpotDetector(params(**changes), classifier)
        self._reader = images.PixelReader()

    def find(self, frame: LabeledFrame) -> List[Any]:
        """Searches an image; returns its spots, and those of earlier images that are confirmed only now."""
        geometry = frame.geometry(self._projection) if frame.geometry else None
        if frame.encoding == "jpeg":
            picture = self._source.CapturedImage(frame.stamp, frame.image).picture()
        else:
            picture = self._reader.read(frame.image, frame.encoding)
        return self._detector.detect(picture, frame.stamp, geometry).spots


class DetectionScore:
    """Scores a detector on the frames of one clip or scene.

    Args:
        reach: distance from a labelled spot below which a detected spot is right.
        position_of: returns a detected spot's position in the frames' coordinates.
        counts_late_spots: whether spots of earlier images that are confirmed only now count too.

    Attributes:
        found: (stamp, index) of each labelled spot that was found.
        errors: distances of right spots from the labelled ones.
        false_spots: (frame number, u, v [px]) of the other spots.
        unclear_count: number of false spots at positions where the label is unclear.
    """

    def __init__(
        self,
        runner: DetectorRunner,
        reach: float,
        position_of: Callable[[Any], Sequence[float]] = lambda spot: (spot.u, spot.v),
        counts_late_spots: bool = True,
    ) -> None:
        self._runner = runner
        self._reach = reach
        self._position_of = position_of
        self._counts_late_spots = counts_late_spots
        self._frames: Dict[float, Tuple[int, LabeledFrame]] = {}
        self.found: Set[Tuple[float, int]] = set()
        self.false_spots: List[Tuple[int, float, float]] = []
        self.unclear_count = 0
        self.errors: List[float] = []

    def add_frame(self, frame: LabeledFrame) -> None:
        """Searches a frame and scores its spots."""
        self._frames[frame.stamp] = len(self._frames), frame._replace(image=None, geometry=None)
        for spot in self._runner.find(frame):
            if spot.stamp != frame.stamp and not self._counts_late_spots:
                continue
            number, truth = self._frames[spot.stamp]
            position = self._position_of(spot)
            to_spots = [math.dist(position, labelled) for labelled in truth.spots]
            to_unclear = [math.dist(position, unclear) for unclear in truth.unclear]
            if min(to_spots, default=math.inf) < self._reach:
                self.found.add((spot.stamp, int(np.argmin(to_spots))))
                self.errors.append(min(to_spots))
            else:
                self.false_spots.append((number, round(spot.u, 1), round(spot.v, 1)))
                self.unclear_count += min(to_unclear, default=math.inf) < self._reach

    def missed(self) -> List[Tuple[int, int, int]]:
        """Lists frame number and position of each labelled spot that was not found."""
        return [
            (number, round(place[0]), round(place[1]))
            for stamp, (number, frame) in self._frames.items()
            for index, place in enumerate(frame.spots)
            if (stamp, index) not in self.found
        ]

    def sums(self) -> Dict[str, int]:
        """Returns the counts that can be summed over clips."""
        frames = [frame for _, frame in self._frames.values()]
        of_found = ((self._frames[stamp][1].shots, index) for stamp, index in self.found)
        return {
            "frames": len(frames),
            "labels": sum(len(frame.spots) for frame in frames),
            "found": len(self.found),
            "shots": len({shot for frame in frames for shot in frame.shots}),
            "shots_found": len({shots[index] for shots, index in of_found if shots}),
            "false": len(self.false_spots),
            "false_off_fringe": len(self.false_spots) - self.unclear_count,
        }


def figures(scores: Sequence[DetectionScore], unit: str = "px") -> Dict[str, Any]:
    """Computes the figures of one or several scores."""
    all_sums = [score.sums() for score in scores]
    sums: Dict[str, int] = {key: sum(one[key] for one in all_sums) for key in all_sums[0]}
    errors = [error for score in scores for error in score.errors] or [math.nan]
    wrong_images = sum(len({number for number, *_ in score.false_spots}) for score in scores)
    recall = proportion(sums["found"], sums["labels"])
    false = proportion(wrong_images, sums["frames"]).scaled(1e3)
    return {
        **sums,
        "recall": sums["found"] / max(1, sums["labels"]),
        "recall_95": f"{recall.low:.3f} to {recall.high:.3f}",
        "false_per_1000": 1e3 * sums["false"] / sums["frames"] if sums["frames"] else math.nan,
        "false_95": f"{false.low:.2f} to {false.high:.2f}",
        f"median_error_{unit}": float(np.median(errors)),
        f"p95_error_{unit}": float(np.percentile(errors, 95)),
    }
