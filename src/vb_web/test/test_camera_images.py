"""The floor as the ceiling cameras see it."""

import numpy as np

from vb_core.grid_map import GridMap
from vb_web import camera_images, images


def test_a_floor_that_lacks_a_camera_is_made_again_for_the_next_browser(monkeypatch):
    there, made = {"red"}, []
    monkeypatch.setattr(camera_images.time, "monotonic", lambda: 0.0)
    monkeypatch.setattr(
        images, "draw_floor", lambda _grid, views: made.append(views) or images.EncodedImage(b"", "", 1)
    )
    found = camera_images.CameraImages(
        dict, ["red", "blue"], "raw", lambda: GridMap(np.zeros((2, 2), np.int8), 0.05), None
    )
    monkeypatch.setattr(found, "_view", lambda camera: camera if camera in there else None)
    found.floor_webp()
    there.add("blue")
    found.floor_webp()
    found.floor_webp()
    assert made == [["red"], ["red", "blue"]]
