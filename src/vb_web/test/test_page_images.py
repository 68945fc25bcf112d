"""Pictures are aligned with the map, and show what is there."""

import cv2
import numpy as np
import pytest

from vb_core.camera_model import CameraModel
from vb_core.grid_map import GridMap
from vb_web import camera_images, page_images
from vb_web.page_images import CeilingImage, ImageCache


def decode(image):
    return cv2.imdecode(np.frombuffer(image.encoded, np.uint8), cv2.IMREAD_UNCHANGED)


def test_a_map_is_drawn_with_its_highest_y_on_top():
    data = np.zeros((20, 30), np.int8)
    data[0, 5] = 100
    data[19] = -1
    pixels = decode(page_images.map_layer(GridMap(data, 0.05)))
    assert pixels.shape == (20, 30, 4)
    assert (pixels[19, 5, 3], pixels[10, 10, 3]) == (255, 0)
    assert 0 < pixels[0, 3, 3] < 255


@pytest.mark.parametrize("shape", [(2100, 1200), (1, 5001), (2049, 17)])
def test_large_maps_are_reduced_and_no_wall_vanishes(shape):
    data = np.zeros(shape, np.int8)
    data[shape[0] // 2, shape[1] // 2] = 100
    image = page_images.map_layer(GridMap(data, 0.05))
    pixels = decode(image)
    assert max(pixels.shape) <= page_images.MAX_SIDE
    assert (np.multiply(pixels.shape[:2], image.cells_per_pixel) >= shape).all()
    assert (pixels[..., 3] == 255).sum() >= 1


def test_restricted_floor_is_where_the_map_became_fuller():
    prior = np.zeros((40, 40), np.int8)
    prior[:, 0] = 100
    posterior = prior.copy()
    posterior[10:20, 10:20] = 100
    posterior[30:35, 10:20] = 50
    pixels = decode(page_images.draw_restricted(GridMap(prior, 0.05), GridMap(posterior, 0.05)))[::-1]
    assert (pixels[10:20, 10:20, 3] > 0).all()
    assert (pixels[:, 0, 3].max(), pixels[25, 15, 3]) == (0, 0)
    assert 0 < pixels[30:35, 10:20, 3].max() < pixels[10:20, 10:20, 3].max()


def test_the_cache_keeps_two_images_named_by_content():
    maps = [page_images.map_layer(GridMap(np.full((5, 5), value, np.int8), 0.05)) for value in (0, 100, -1, 0)]
    assert maps[0].name == maps[3].name
    assert len({image.name for image in maps}) == 3
    cache = ImageCache()
    for image in maps[:3]:
        cache.put("map", image)
    assert [cache.get("map", image.name) for image in maps[:3]] == [None, *maps[1:3]]
    assert cache.get("restricted", maps[2].name) is None


def looking_down(x, y, height):
    """Returns T_camera_map of a camera above (x, y) whose image has +y at the top."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = (-x, y, height)
    return pose


def test_the_floor_is_where_the_cameras_see_it():
    grid = GridMap(np.zeros((100, 160), np.int8), 0.05, (-1.0, 2.0, 0.0))
    camera = CameraModel.ideal(400, 300, 200.0)
    image = np.full((300, 400, 3), 90, np.uint8)
    # a red object 0.5 m to the right of and 0.25 m above the image's centre: 200 px/m at 1 m, 80 px/m at 2.5 m
    image[110:150, 220:260] = (0, 0, 255)
    views = [CeilingImage(image, camera, looking_down(2.0, 4.0, 2.5))]
    image = page_images.draw_floor(grid, views)
    pixels = decode(image)[::-1]
    meter = 1.0 / (grid.resolution * image.cells_per_pixel)

    def at(x, y):
        return pixels[int((y - 2.0) * meter), int((x + 1.0) * meter)]

    blue, _, red, _ = at(2.5, 4.25)
    assert blue < 80
    assert red > 200
    assert abs(int(at(1.5, 4.25)[2]) - 90) < 12
    assert at(-0.9, 2.1)[3] == 0
    assert (decode(page_images.draw_floor(grid, views * 2)) == decode(image)).all()


def test_a_camera_below_the_floor_or_none_shows_nothing():
    grid = GridMap(np.zeros((20, 20), np.int8), 0.05)
    upwards = np.eye(4)
    upwards[2, 3] = -2.0
    camera = CameraModel.ideal(40, 30, 20.0)
    for views in ([], [CeilingImage(np.zeros((30, 40, 3), np.uint8), camera, upwards)]):
        assert decode(page_images.draw_floor(grid, views))[..., 3].max() == 0


@pytest.mark.parametrize("width, expected", [(1920, 960), (320, 320)])
def test_camera_pictures_are_made_smaller_never_larger(width, expected):
    data = page_images.encode_jpeg(np.zeros((width // 2, width, 3), np.uint8))
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).shape[1] == expected


def test_an_incomplete_floor_image_is_made_again(monkeypatch):
    connected, drawings = {"red"}, []
    monkeypatch.setattr(camera_images.time, "monotonic", lambda: 0.0)
    image = page_images.EncodedImage(b"", "", 1)
    grid = GridMap(np.zeros((2, 2), np.int8), 0.05)
    monkeypatch.setattr(page_images, "draw_floor", lambda _grid, views: drawings.append(views) or image)
    images = camera_images.CameraImages({}.get, ["red", "blue"], "raw", lambda: grid, None)
    monkeypatch.setattr(images, "_receive", lambda camera: camera if camera in connected else None)
    images.floor_webp()
    connected.add("blue")
    images.floor_webp()
    images.floor_webp()
    assert drawings == [["red"], ["red", "blue"]]
