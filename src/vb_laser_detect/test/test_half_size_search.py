"""Spots found in an image of half the size are measured at full size, with the accuracy of a full-size search."""

from unittest.mock import Mock

import av
import cv2
import numpy as np
import pytest

from spot_scenes import GREEN, RED, Scene
from vb_core.image_format import HalvedPicture
from vb_laser_detect.camera.camera_source import CapturedImage
from vb_laser_detect.detection.spot_detector import DetectionResult, SpotDetector

SIZE = 956, 540  # neither the rows nor the columns of its half are a multiple of 8
DRAWN = range(35, 60)
ROWS = np.arange(SIZE[1], dtype=np.float32)[:, None, None]
LIGHTS = {  # the gain of each image, or of each of its rows
    "steady": lambda number: 1.0,
    "switched": lambda number: 1.0 if number < 47 else 0.45,  # in the middle of the stroke
    "flickering": lambda number: 1.0 + 0.3 * np.sin(ROWS / 90.0 + 1.7 * number),  # over a rolling shutter
}


DRAWINGS = {  # light, color, size of the spot [px], where it would be in image 0 [px], and its step per image [px]
    "red": ("steady", RED, 2.5, (250.3, 150.6), (6.0, 3.0)),
    "small and green": ("steady", GREEN, 1.2, (250.3, 150.6), (6.0, 3.0)),
    "at the lower edge": ("steady", RED, 2.5, (250.3, 534.6), (6.0, 0.0)),
    "at the right edge": ("steady", RED, 2.5, (950.5, 150.6), (0.0, 3.0)),
    "light switched": ("switched", RED, 2.5, (250.3, 150.6), (6.0, 3.0)),
    "lamps flicker": ("flickering", GREEN, 3.0, (250.3, 150.6), (6.0, 3.0)),
}


@pytest.mark.parametrize("light, color, sigma, start, step", DRAWINGS.values(), ids=list(DRAWINGS))
def test_halves_lead_to_the_spots_of_the_whole(light, color, sigma, start, step):
    scene = Scene(*SIZE)
    full_detector, half_detector = SpotDetector(), SpotDetector()
    full_offsets, half_offsets, frames_decoded_in_full = [], [], []

    def place(number):
        return np.add(start, np.multiply(step, number))

    def offsets(spots):
        return [(spot.u, spot.v) - place(spot.stamp / 0.04) for spot in spots]

    for number in range(DRAWN.stop):
        spots = [place(number)] if number in DRAWN else []
        image = scene.render(spots, sigma, color=color, floor=scene.floor * LIGHTS[light](number))

        def decode(width, height, image=image, number=number):
            if width == SIZE[0]:
                frames_decoded_in_full.append(number)
            return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)

        full_offsets += offsets(full_detector.detect(image, 0.04 * number).spots)
        half_offsets += offsets(half_detector.detect(HalvedPicture(SIZE, decode), 0.04 * number).spots)
    assert len(full_offsets) >= 0.8 * len(DRAWN)
    assert abs(len(full_offsets) - len(half_offsets)) <= 1
    assert np.abs(half_offsets).max() <= np.abs(full_offsets).max() + 0.1
    if light == "steady":
        # nothing else needs the full size
        assert min(frames_decoded_in_full) >= DRAWN.start
        assert set(frames_decoded_in_full) >= set(DRAWN)


@pytest.mark.parametrize("size, scale", [((1920, 1080), 2), ((1441, 1080), 1), ((1280, 720), 1)])
@pytest.mark.parametrize("jpeg", [True, False])
def test_large_images_are_decoded_to_halves_of_the_same_place(size, scale, jpeg):
    image = Scene(*size, noise=0.0).render([(201.0, 152.0)], sigma=4.0)
    if jpeg:
        captured = CapturedImage(0.0, jpeg=cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes())
    else:
        captured = CapturedImage(0.0, frame=av.VideoFrame.from_ndarray(image, format="bgr24"))
    picture, again = captured.picture(), captured.picture()
    assert (picture.scale, picture.size) == (scale, size)
    assert picture.search_pixels.shape == (size[1] // scale, size[0] // scale, 3)
    assert picture.pixels.shape == image.shape
    assert np.abs(scale * (middle_of_spot(picture.search_pixels) + 0.5) - 0.5 - middle_of_spot(image)).max() < 0.2
    if scale > 1:
        again.decode_full_size()
        assert np.abs(again.search_pixels.astype(int) - picture.search_pixels).mean() < 1.0


def test_an_image_that_comes_late_is_not_decoded():
    detector = SpotDetector()
    floor = Scene(*SIZE).render()
    detector.detect(HalvedPicture(SIZE, lambda *size: cv2.resize(floor, size)), 1.0)
    decode = Mock()
    assert detector.detect(HalvedPicture(SIZE, decode), 0.96) == DetectionResult(is_late=True)
    assert not decode.called


def middle_of_spot(image):
    light = np.maximum(image[..., 2].astype(float) - 200.0, 0.0)
    light[:, image.shape[1] // 2 :] = 0.0
    rows, columns = np.indices(light.shape)
    return np.array([(light * columns).sum(), (light * rows).sum()]) / light.sum()
