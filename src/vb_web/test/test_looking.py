"""The floor as the ceiling cameras see it."""
import numpy as np

from vb_core.grid_map import GridMap
from vb_web import looking, pictures


def test_a_floor_that_lacks_a_camera_is_made_again_for_the_next_browser(monkeypatch):
    there, made = {"red"}, []
    monkeypatch.setattr(looking.time, "monotonic", lambda: 0.0)
    monkeypatch.setattr(pictures, "draw_floor", lambda _grid, views: made.append(views) or pictures.Picture(b"", "", 1))
    looker = looking.Looker(dict, ["red", "blue"], "raw", lambda: GridMap(np.zeros((2, 2), np.int8), 0.05), None)
    monkeypatch.setattr(looker, "_view", lambda camera: camera if camera in there else None)
    looker.floor_webp()
    there.add("blue")
    looker.floor_webp()
    looker.floor_webp()
    assert made == [["red"], ["red", "blue"]]
