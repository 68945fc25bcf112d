"""How much of an image is saturated."""

import numpy as np

from vb_laser_detect.camera.exposure import TOO_BRIGHT, saturated_share


def test_the_share_is_that_of_the_surface():
    image = np.full((480, 640, 3), 120, np.uint8)
    image[:, :160] = 255
    assert saturated_share(image) == 0.25 > TOO_BRIGHT
    assert saturated_share(image[:, :, 0]) == 0.25  # one channel, or a mosaic


def test_points_and_empty_images_are_not_saturated():
    image = np.full((480, 640), 120, np.uint8)
    image[100:104, 100:104] = 255  # a laser spot
    assert saturated_share(image) <= 64 / image.size
    assert saturated_share(np.zeros((0, 0), np.uint8)) == 0.0
