"""What the numbers of an image mean comes from its message, for every encoding."""

import cv2
import numpy as np
import pytest
import rospy

from scenes import GREEN, Scene, tinted
from vb_core.image_format import Picture, PixelReader
from vb_core.ros.images import array_from_image, message_from_image
from vb_laser_detect.detection.debug_image import draw_candidates
from vb_laser_detect.detector import DetectorParams, Spot, SpotDetector

PERIOD = 0.04


def run(images, encoding, params=None):
    """The spots of images that come in an encoding."""
    detector, reader = SpotDetector(params or DetectorParams(confirm_frames=1)), PixelReader()
    return [detector.detect(reader.read(image, encoding), PERIOD * i) for i, image in enumerate(images)]


def strokes(encode, bayer=False, gray=False):
    """Eight images without and twelve with a spot, and the spot's places."""
    scene, places = tinted(Scene(320, 240, noise=1.5)), [(60.0 + 12.0 * i, 100.0) for i in range(12)]
    images = [scene.render([place] if place else [], color=GREEN, bayer=bayer) for place in [None] * 8 + places]
    return [encode(image[:, :, 1].copy() if gray else image) for image in images], [None] * 8 + places


def by_opencv(code):
    """bgr as OpenCV itself encodes it."""
    return lambda image: cv2.cvtColor(image, code)


def nv12(image):
    """bgr to 4:2:0: the brightness, and below it both colours side by side."""
    whole = cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420)
    high, wide = image.shape[:2]
    colors = whole[high:].reshape(2, high // 2, wide // 2)
    return np.vstack([whole[:high], colors.transpose(1, 2, 0).reshape(high // 2, wide)])


CASES = {
    "bgr8": (lambda image: image, {}),
    "rgb8": (lambda image: image[:, :, ::-1].copy(), {}),
    "bgra8": (by_opencv(cv2.COLOR_BGR2BGRA), {}),
    "mono8": (lambda image: image, {"gray": True}),
    "mono16": (lambda image: image.astype(np.uint16) * 257, {"gray": True}),
    "mono16 of 12 bits": (lambda image: image.astype(np.uint16) * 16, {"gray": True}),
    "bayer_rggb8": (lambda image: image, {"bayer": True}),
    "bayer_rggb16": (lambda image: image.astype(np.uint16) * 257, {"bayer": True}),
    "bayer_rggb16 of 10 bits": (lambda image: image.astype(np.uint16) * 4, {"bayer": True}),
    "bgr16": (lambda image: image.astype(np.uint16) * 257, {}),
    "yuv422": (by_opencv(cv2.COLOR_BGR2YUV_UYVY), {}),
    "yuv422_yuy2": (by_opencv(cv2.COLOR_BGR2YUV_YUY2), {}),
    "uyvy": (by_opencv(cv2.COLOR_BGR2YUV_UYVY), {}),
    "yuyv": (by_opencv(cv2.COLOR_BGR2YUV_YUY2), {}),
    "nv12": (nv12, {}),
}


@pytest.mark.parametrize("case", list(CASES))
@pytest.mark.parametrize("mobile", [False, True])
def test_the_spot_is_found_in_every_encoding(case, mobile):
    encode, kind = CASES[case]
    images, truths = strokes(encode, **kind)
    preset = DetectorParams.mobile if mobile else DetectorParams
    found = run(images, case.split()[0], preset(confirm_frames=1))
    assert not any(found[:8])
    hits = [
        spots and np.hypot(spots[0].u - truth[0], spots[0].v - truth[1]) < 1.0
        for spots, truth in zip(found[8:], truths[8:])
    ]
    assert sum(map(bool, hits)) >= 11


@pytest.mark.parametrize("case", [case for case in CASES if " " not in case])
def test_a_message_s_picture_is_the_same_on_every_display(case):
    # from the bytes of a message to bgr, by the one table that the search, its debug image and the page share
    encode, kind = CASES[case]
    image = Scene(320, 240, noise=0.0).render([(100.0, 80.0)], color=GREEN, bayer=kind.get("bayer", False))
    shown = encode(image[:, :, 1].copy() if kind.get("gray") else image)
    message = message_from_image(shown, case, rospy.Time(5), "camera")
    message.height = 240
    picture = PixelReader().read(array_from_image(message), case)
    truth = Picture(image, "bayer_rggb").bgr() if kind.get("bayer") else image
    truth = np.repeat(image[:, :, 1:2], 3, axis=2) if kind.get("gray") else truth
    drawn = draw_candidates(picture, [Spot(50.2, 40.1, 6.0, confidence=0.9), Spot(100, 50, 9, rejection="too_dark")])
    assert (drawn == (0, 220, 0)).all(axis=2).any()
    away = np.abs(drawn.astype(int) - truth)
    assert away.shape == (240, 320, 3) and np.median(away) <= 2 and np.percentile(away, 95) < 12
