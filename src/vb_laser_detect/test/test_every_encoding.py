"""The search and its debug image interpret pixel values by the message's encoding, for every encoding."""

from functools import partial

import cv2
import numpy as np
import pytest
import rospy

from spot_scenes import GREEN, Scene, shown, tinted
from vb_core.image_format import Picture, PixelReader
from vb_core.ros.images import decode, message_from_image
from vb_laser_detect.detection.debug_image import draw_candidates
from vb_laser_detect.detection.spot_detector import DetectorParams, Spot, SpotDetector


def nv12(image):
    """Converts bgr to 4:2:0: the luma plane, and below it the interleaved chroma plane."""
    whole = cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420)
    high, wide = image.shape[:2]
    colors = whole[high:].reshape(2, high // 2, wide // 2)
    return np.vstack([whole[:high], colors.transpose(1, 2, 0).reshape(high // 2, wide)])


# by encoding: the kind of camera, and how its image is encoded
CASES = {
    "bgr8": ("bgr", np.copy),
    "rgb8": ("bgr", lambda image: image[:, :, ::-1].copy()),
    "bgra8": ("bgr", partial(cv2.cvtColor, code=cv2.COLOR_BGR2BGRA)),
    "mono8": ("mono", np.copy),
    "mono16": ("mono", lambda image: image.astype(np.uint16) * 257),
    "mono16 of 12 bits": ("mono", lambda image: image.astype(np.uint16) * 16),
    "bayer_rggb8": ("bayer", np.copy),
    "bayer_rggb16": ("bayer", lambda image: image.astype(np.uint16) * 257),
    "bayer_rggb16 of 10 bits": ("bayer", lambda image: image.astype(np.uint16) * 4),
    "bgr16": ("bgr", lambda image: image.astype(np.uint16) * 257),
    "yuv422": ("bgr", partial(cv2.cvtColor, code=cv2.COLOR_BGR2YUV_UYVY)),
    "yuv422_yuy2": ("bgr", partial(cv2.cvtColor, code=cv2.COLOR_BGR2YUV_YUY2)),
    "uyvy": ("bgr", partial(cv2.cvtColor, code=cv2.COLOR_BGR2YUV_UYVY)),
    "yuyv": ("bgr", partial(cv2.cvtColor, code=cv2.COLOR_BGR2YUV_YUY2)),
    "nv12": ("bgr", nv12),
}


@pytest.mark.parametrize("case", list(CASES))
@pytest.mark.parametrize("preset", [DetectorParams, DetectorParams.mobile])
def test_the_spot_is_found_in_every_encoding(case, preset):
    kind, encode = CASES[case]
    scene, detector = tinted(Scene(320, 240, noise=1.5)), SpotDetector(preset(confirm_frames=1))
    reader = PixelReader()
    hits = 0
    for i in range(-8, 12):
        u, v = 60.0 + 12.0 * i, 100.0
        image = encode(shown(scene, kind, [(u, v)] * (i >= 0), color=GREEN))
        spots = detector.detect(reader.read(image, case.split()[0]), 0.04 * i).spots
        assert i >= 0 or not spots
        hits += bool(spots) and np.hypot(spots[0].u - u, spots[0].v - v) < 1.0
    assert hits >= 11


@pytest.mark.parametrize("case", [case for case in CASES if " " not in case])
def test_a_message_s_picture_is_the_same_on_every_display(case):
    # from a message's bytes to bgr, by the table that the search, its debug image and the page share
    kind, encode = CASES[case]
    image = shown(Scene(320, 240, noise=0.0), kind, [(100.0, 80.0)], color=GREEN)
    message = message_from_image(encode(image), case, rospy.Time(5), "camera")
    message.height = 240
    picture = decode(message, PixelReader())
    truth = Picture(image, "bayer_rggb").bgr() if kind == "bayer" else image
    truth = np.dstack([image] * 3) if kind == "mono" else truth
    drawn = draw_candidates(picture, [Spot(50.2, 40.1, 6.0, confidence=0.9), Spot(100, 50, 9, rejection="too_dark")])
    assert (drawn == (0, 220, 0)).all(axis=2).any()
    away = np.abs(drawn.astype(int) - truth)
    assert away.shape == (240, 320, 3)
    assert np.median(away) <= 2 and np.percentile(away, 95) < 12
