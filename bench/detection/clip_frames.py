"""Reads the labelled clips' frames as cameras of each role see them, or as other cameras would record them."""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from typing import Dict, Iterator, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from bench.detection.augmentation import PAINT_EVERY, OtherCamera, CameraSettings
from bench.detection.detector_under_test import LabeledFrame

REACH_PX = 10.0  # [px] of 640 px
FRINGE = 2  # [frames] before and after a label, in which its spot may show too
ROLES = ("stationary", "mobile", "window")
# in long clips, only the first frames and those near a shot are used
NEAR_FRAMES, FIRST_FRAMES = 8, 60
# frames with unlabelled pulses, found by eye; in 115 and 116 on a wall that is white anyway
UNLABELED = {"logitech-indoor-tree-green.mp4": (43, 44, 70, 71, 87, 88, 115, 116, 126, 127, 222, 223)}
# parts of the clips' names
CAMERAS = ("highres", "lifecam", "logitech", "no_interference")
ROOMS = ("indoor", "outdoor", "safari", "motion", "nobg")


def camera_and_room(group: str) -> Tuple[str, str]:
    """Returns a clip's camera and room, also for an augmented clip; unique ones if its name contains neither."""
    camera = next((name for name in CAMERAS if name in group), group.split(": ")[-1])
    return camera, next((name for name in ROOMS if name in group), f"{camera}'s")


def is_clip(group: str) -> bool:
    """Returns whether examples are from a clip, not from a rendered scene."""
    return not group.startswith(("ceiling: ", "robot: "))


def reach_in(video: dict) -> float:
    """Returns the distance [px] from a label below which a spot in a clip is right."""
    return REACH_PX * max(1.0, video["width"] / 640.0)


def left_out_with(groups: Sequence[str]) -> Dict[str, List[str]]:
    """Returns the groups left out with each: with a clip those of its camera or room, with a scene a fifth of all."""
    folds = dict(zip(groups, np.random.default_rng(1).permutation(np.arange(len(groups)) % 5)))
    traits = {group: set(camera_and_room(group)) for group in groups if is_clip(group)}
    scenes = [group for group in groups if group not in traits]
    left_out = {group: [other for other in scenes if folds[other] == folds[group]] for group in groups}
    for group in traits:
        left_out[group] = [other for other in traits if traits[other] & traits[group]]
    return left_out


def window_at(index: int, width: int, height: int, seed: int) -> np.ndarray:
    """Returns the transform (2, 3) from the picture to a window of four fifths of its size, in frame `index`.

    Pan and tilt swing by 7 % of the picture, at up to 4 px per frame (of 640 x 480); roll swings by 2.5 degrees.
    """
    random = np.random.default_rng(seed)
    phases = random.uniform(0, 2 * math.pi, 3)
    periods = random.uniform((90, 90, 70), (140, 140, 160))  # [frames]
    swing = np.sin(2 * math.pi * index / periods + phases)
    angle = math.radians(2.5 * swing[2])
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, -s], [s, c]])
    size = np.array([width, height])
    center = 0.5 * size + swing[:2] * 0.07 * size
    return np.column_stack([rotation, 0.4 * size - rotation @ center])


def frames_of(clip: Path, video: dict, role: str) -> Iterator[LabeledFrame]:
    """Yields all frames of a clip; spots labelled in the frames shortly before or after are unclear."""
    by_frame: Dict[int, List[dict]] = {}
    for label in video["labels"]:
        by_frame.setdefault(label["frame"], []).append(label)
    capture = cv2.VideoCapture(str(clip))
    rate = capture.get(cv2.CAP_PROP_FPS) or 25.0
    seed = zlib.crc32(clip.name.encode())
    index = -1
    while True:
        success, image = capture.read()
        index += 1
        if not success:
            return
        transform = np.eye(2, 3)
        height, width = image.shape[:2]
        if role == "window":
            transform = window_at(index, width, height, seed)
            width, height = (int(0.8 * side) for side in (width, height))
            image = cv2.warpAffine(image, transform, (width, height), flags=cv2.INTER_CUBIC)
            # adds noise that does not move with the scene, and depends only on the frame, not on earlier clips
            cv2.setRNGSeed(seed % 2**31 + index)
            image = cv2.add(image, cv2.randn(np.empty(image.shape, np.int8), 0, 1.5), dtype=cv2.CV_8U)
        spots, unclear, shots = [], [], []
        if index in UNLABELED.get(clip.name, ()):
            unclear += [(u, v) for u in range(0, width, 8) for v in range(0, height, 8)]
        for offset in range(-FRINGE, FRINGE + 1):
            for label in by_frame.get(index + offset, []):
                x, y = transform @ (label["x"], label["y"], 1.0)
                # a spot at the window's edge is neither required nor wrong
                is_clear = role != "window" or (4.0 < x < width - 5.0 and 4.0 < y < height - 5.0)
                if offset == 0 and is_clear:
                    spots.append((x, y))
                    shots.append(label["event"])
                else:
                    unclear.append((x, y))
        yield LabeledFrame(index / rate, image, spots, unclear, shots=shots)


def frames_near_shots(
    folder: Path, name: str, video: dict, group: str, settings: Optional[CameraSettings] = None
) -> Iterator[LabeledFrame]:
    """Yields the informative frames of one clip for a stationary camera: those near a shot, and the first frames.

    Args:
        group: the clip's name and augmentation.
        settings: of another camera that records the same pictures; spots are then painted into them too.
    """
    labeled = np.array([label["frame"] for label in video["labels"]])
    other = OtherCamera(settings, zlib.crc32(group.encode())) if settings else None
    for number, frame in enumerate(frames_of(folder / "clips" / name, video, "stationary")):
        is_far = not len(labeled) or np.abs(labeled - number).min() > NEAR_FRAMES
        if is_far and len(labeled) and number > FIRST_FRAMES:
            continue
        if other is not None:
            image, seen, unseen = other.record(frame.image, frame.spots, paint=is_far and number > PAINT_EVERY)
            frame = frame._replace(image=image, spots=frame.spots + seen, unclear=frame.unclear + unseen)
        yield frame
