"""What an image's pixels mean, by its message's encoding or format."""

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CompressedImage

from refusals import refused
from vb_core.image_format import PixelReader
from vb_core.ros.images import decode


@pytest.mark.parametrize(
    "kind, shape, color_format",
    [
        ("bgr8; jpeg compressed bgr8", (32, 32, 3), "bgr"),
        ("bayer_rggb8; jpeg compressed bgr8", (32, 32, 3), "bgr"),  # converted by the driver
        ("bayer_rggb8; png compressed ", (32, 32), "bayer_rggb"),
        ("mono8; jpeg compressed ", (32, 32), "mono"),
        ("jpeg", (32, 32), "mono"),
    ],
)
def test_a_compressed_image_s_format_says_whether_it_is_a_mosaic(kind, shape, color_format):
    message = CompressedImage(format=kind, data=cv2.imencode(".png", np.zeros(shape, np.uint8))[1].tobytes())
    assert decode(message, PixelReader()).color_format == color_format


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_a_depth_image_is_not_a_picture(encoding):
    with refused("unknown_encoding"):
        PixelReader().read(np.zeros((4, 6), np.uint16), encoding)
