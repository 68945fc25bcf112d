"""Pictures lie where the map is, and show what is there."""

import cv2
import numpy as np
import pytest

from vb_core.grid_map import GridMap
from vb_web import images
from vb_web.images import ImageCache


def decode(image):
    return cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_UNCHANGED)


def test_a_map_is_drawn_with_its_highest_y_on_top():
    data = np.zeros((20, 30), np.int8)
    data[0, 5] = 100
    data[19] = -1
    pixels = decode(images.draw_map(GridMap(data, 0.05)))
    assert pixels.shape == (20, 30, 4)
    assert pixels[19, 5, 3] == 255 and pixels[10, 10, 3] == 0 and 0 < pixels[0, 3, 3] < 255


@pytest.mark.parametrize("shape", [(2100, 1200), (1, 5001), (2049, 17)])
def test_large_maps_are_reduced_and_no_wall_vanishes(shape):
    data = np.zeros(shape, np.int8)
    data[shape[0] // 2, shape[1] // 2] = 100
    image = images.draw_map(GridMap(data, 0.05))
    pixels = decode(image)
    assert max(pixels.shape) <= images.MAX_SIDE
    assert pixels.shape[1] * image.cells >= shape[1] and pixels.shape[0] * image.cells >= shape[0]
    assert (pixels[..., 3] == 255).sum() >= 1


def test_restricted_floor_is_where_the_map_became_fuller():
    before = np.zeros((40, 40), np.int8)
    before[:, 0] = 100
    after = before.copy()
    after[10:20, 10:20] = 100
    after[30:35, 10:20] = 50
    pixels = decode(images.draw_restricted(GridMap(before, 0.05), GridMap(after, 0.05)))[::-1]
    assert (pixels[10:20, 10:20, 3] > 0).all() and pixels[:, 0, 3].max() == 0 and pixels[25, 15, 3] == 0
    assert 0 < pixels[30:35, 10:20, 3].max() < pixels[10:20, 10:20, 3].max()


def test_the_same_content_has_the_same_name_and_an_album_keeps_two():
    maps = [images.draw_map(GridMap(np.full((5, 5), value, np.int8), 0.05)) for value in (0, 100, -1, 0)]
    assert maps[0].name == maps[3].name and len({one.name for one in maps}) == 3
    cache = ImageCache()
    for image in maps[:3]:
        cache.put("map", image)
    assert cache.get("map", maps[0].name) is None
    assert cache.get("map", maps[1].name) is maps[1] and cache.get("map", maps[2].name) is maps[2]
    assert cache.get("restricted", maps[2].name) is None


def test_camera_pictures_are_made_smaller_never_larger():
    for width, expected in ((1920, 960), (320, 320)):
        data = images.encode_jpeg(np.zeros((width // 2, width, 3), np.uint8))
        assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape[1] == expected
