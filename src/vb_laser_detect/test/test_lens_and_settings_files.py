"""A camera's lens file comes back as it was written; in a settings file only the capture settings change."""

import contextlib
import weakref

import numpy as np
import pytest
import yaml

from board_scene import WIDE_CAMERA
from refusals import refused
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_laser_detect.camera.lens_and_settings_files import load_lens, save_lens, set_capture
from vb_laser_detect.ros.camera_feed import LensFile


@pytest.mark.parametrize("camera", [WIDE_CAMERA, CameraModel(1280, 720, WIDE_CAMERA.matrix, [0.02, -0.01, 0, 0], True)])
def test_a_lens_file_comes_back_as_it_was(tmp_path, camera):
    save_lens(tmp_path / "hall.yaml", "hall", camera)
    found = load_lens(tmp_path / "hall.yaml")
    assert (found.width, found.height, found.fisheye) == (camera.width, camera.height, camera.fisheye)
    assert np.array_equal(found.matrix, camera.matrix) and np.array_equal(found.distortion, camera.distortion)


@pytest.mark.parametrize("text, code", [(None, "no_camera_info"), ("x: 3", "bad_lens_file"), (":", "bad_lens_file")])
def test_a_lens_file_that_says_nothing_is_refused(tmp_path, text, code):
    if text is not None:
        (tmp_path / "hall.yaml").write_text(text)
    with refused(code):
        load_lens(tmp_path / "hall.yaml")


def test_no_picture_outlives_its_search_without_a_lens(tmp_path):
    lens, pictures = LensFile(tmp_path / "red.yaml"), []

    def search():
        picture = np.zeros(3)
        pictures.append(weakref.ref(picture))
        with contextlib.suppress(CodedError):
            lens.model_for((640, 480))

    for _ in range(3):
        search()
    assert not any(picture() is not None for picture in pictures)


@pytest.mark.parametrize(
    "text",
    [
        "# mine\n{}\n",
        "source: /dev/video0   # the left one\n",
        "source: x\ncapture:\n  delay_ms: 3.0   # guessed\n  width: 1280\nrobots: []\n",
    ],
)
def test_settings_are_changed_and_all_else_stays(tmp_path, text):
    path = tmp_path / "hall.yaml"
    path.write_text(text)
    set_capture(path, {"delay_ms": 48.5, "exposure": 100})
    expected = yaml.safe_load(text) or {}
    expected.setdefault("capture", {}).update(delay_ms=48.5, exposure=100)
    assert yaml.safe_load(path.read_text()) == expected
    for comment in ("# mine", "# the left one", "# guessed"):
        assert (comment in text) == (comment in path.read_text())


def test_a_file_in_another_style_is_left_as_it_is(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text("capture: {width: 3}\n")
    with refused("bad_file"):
        set_capture(path, {"delay_ms": 1.0})
    assert path.read_text() == "capture: {width: 3}\n"
