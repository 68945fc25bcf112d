"""A robot's camera: images as full of edges as photographs, and spots with little colour.

The motion is smooth, as that of a pan-tilt head or a robot; the images are compressed. A webcam shows a green laser's
spot nearly white, so colour alone is not enough.
"""

import cv2
import numpy as np
import pytest

from spot_scenes import ImageDetector
from vb_laser_detect.detection.image_registration import ImageRegistration
from vb_laser_detect.detection.spot_detector import DetectorParams, SpotDetector
from vb_laser_detect.detection.spot_tracker import Track

PALE = np.array([0.86, 1.0, 0.84], np.float32)
WIDE, HIGH = 400, 300


def photograph(seed):
    """Renders (450, 600, 3) float: noise at several scales, rectangles with sharp edges, some white, and white dots."""
    random = np.random.default_rng(seed)
    picture = np.full((450, 600, 3), 70.0, np.float32)
    for size, strength in ((64, 25), (16, 14), (4, 8)):
        coarse = random.normal(0, strength, (450 // size + 2, 600 // size + 2, 3)).astype(np.float32)
        picture += cv2.resize(coarse, (600, 450), interpolation=cv2.INTER_CUBIC)
    for _ in range(45):
        x, y = (int(value) for value in random.uniform((0, 0), (580, 430)))
        wide, high = (int(value) for value in random.uniform(4, 90, 2))
        value = 245.0 if random.random() < 0.25 else random.uniform(10, 190)
        picture[y : y + high, x : x + wide] = np.clip(value * random.uniform(0.85, 1.0, 3), 0, 245)
    for _ in range(12):
        middle = tuple(int(value) for value in random.uniform((20, 20), (580, 430)))
        cv2.circle(picture, middle, int(random.uniform(2, 6)), (250, 250, 250), -1, cv2.LINE_AA)
    return cv2.GaussianBlur(np.clip(picture, 0, 250), (3, 3), 0)


class View:
    """A window that pans, tilts and rolls over a photograph, with a sensor's noise and JPEG compression."""

    def __init__(self, seed, still=False):
        self._still = still
        self._picture, self._random = photograph(seed), np.random.default_rng(seed + 100)

    def at(self, index, spot=None):
        """Returns image `index` (H, W, 3), with a spot at (u, v) [px] if given."""
        t = 0.0 if self._still else float(index)
        angle = np.radians(3.0 * np.sin(0.05 * t))
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        middle = np.array([300.0 + 60.0 * np.sin(0.045 * t), 225.0 + 45.0 * np.cos(0.06 * t)])
        motion = np.column_stack([turn, np.array([WIDE / 2, HIGH / 2]) - turn @ middle])
        image = cv2.warpAffine(self._picture, motion, (WIDE, HIGH), flags=cv2.INTER_CUBIC)
        if spot is not None:
            v, u = np.mgrid[:HIGH, :WIDE]
            light = 330.0 * np.exp(-0.5 * ((u - spot[0]) ** 2 + (v - spot[1]) ** 2) / 2.2**2)
            image = image + light[:, :, None].astype(np.float32) * PALE
        image = np.clip(image + self._random.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)
        return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])[1], cv2.IMREAD_COLOR)


@pytest.mark.parametrize("still", [True, False])
def test_spots_on_photographs(still):
    hit_count = false_count = 0  # in 180 images, 27 of which show a spot
    for seed in (1, 2, 3):
        view, detector = View(seed, still), ImageDetector(DetectorParams.mobile(confirm_frames=1))
        random = np.random.default_rng(seed)
        for i in range(60):
            # a pulse of three images every 0.8 s, moved a little; not where the picture is white already
            while i % 20 == 12:
                start = random.uniform((60, 60), (WIDE - 60, HIGH - 60))
                u, v = start.astype(int)
                if view.at(i)[v - 8 : v + 9, u - 8 : u + 9].max() <= 200:
                    break
            spot = start + (i % 20 - 12) * np.array([1.5, 0.5]) if 12 <= i % 20 < 15 else None
            spots = detector.detect(view.at(i, spot), 0.04 * i)
            hits = [s for s in spots if spot is not None and np.hypot(s.u - spot[0], s.v - spot[1]) < 3.0]
            hit_count += bool(hits)
            false_count += len(spots) - len(hits)
    assert hit_count >= 0.85 * 27
    assert false_count <= 0.01 * 180


def test_the_motion_is_the_camera_s_and_not_a_thing_s():
    picture = np.clip(photograph(5), 0, 255).astype(np.uint8)
    registration = ImageRegistration()
    registration.follow(picture[50:350, 60:460])
    truth = np.array([[1.0, 0, -7.0], [0, 1, 4.0], [0, 0, 1]])
    moved = picture[46:346, 67:467].copy()
    moved[100:200, 150:280] = 30  # somebody walks by
    motion = registration.follow(moved)
    assert np.abs(motion - truth)[:2, :2].max() < 0.004 and np.abs(motion - truth)[:2, 2].max() < 0.6
    moved[120:200, 200:330] = 160
    # the person walks on; the camera has moved since the first keyframe, but not since the next one
    assert np.abs(registration.follow(moved) - np.eye(3))[:2, 2].max() < 0.6
    assert np.abs(registration.motion - truth)[:2, 2].max() < 0.6
    registration.set_keyframe()
    moved[120:200, 200:330] = 90
    assert np.array_equal(registration.follow(moved), np.eye(3)) and registration.motion is None
    # a blank wall shows no motion
    blank = ImageRegistration()
    blank.follow(np.full((240, 320), 90, np.uint8))
    assert blank.follow(np.full((240, 320), 91, np.uint8)) is None


def test_a_tracked_spot_moves_along_with_the_image():
    picture = photograph(3).astype(np.uint8)
    detector = SpotDetector(DetectorParams.mobile())
    detector.detect(picture[:HIGH, :WIDE], 0.0)
    track = Track(1, np.array([200.0, 150.0]), 0.0, 0.0)
    detector._tracker._tracks.append(track)
    detector.detect(picture[:HIGH, 24 : 24 + WIDE], 0.04)
    assert track.pixel == pytest.approx((176.0, 150.0), abs=0.5)
