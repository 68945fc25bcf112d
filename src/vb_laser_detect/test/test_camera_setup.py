"""Lens, delay, exposure and settings of a camera that the detector reads itself, against known values."""

import itertools
import math
import re
from collections import deque
from types import SimpleNamespace
from unittest.mock import Mock
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
import rospy
import yaml

from refusals import refused
from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.image_format import Picture
from vb_laser_detect.ros import camera_setup
from vb_laser_detect.calibration.lens import BoardParams, BoardView, LensCalibration
from vb_laser_detect.camera import controls
from vb_laser_detect.camera.camera_files import load_lens, save_lens, set_capture
from vb_laser_detect.camera.delay import brightness, measure_delay
from vb_laser_detect.camera.exposure import TOO_BRIGHT, saturated_share
from vb_laser_detect.ros.camera_feed import ReceivedImage
from vb_laser_detect.ros.camera_setup import CameraImages
from vb_laser_detect.camera.controls import CaptureParams

WIDE = CameraModel(
    1280, 720, np.array([[820.0, 0, 655], [0, 824.0, 350], [0, 0, 1]]), np.array([-0.25, 0.08, 0.001, 0, 0])
)


# ------------------------------------------------------------- lens
def held(camera, rng, tilt=0.6):
    """Returns a view of a board that a person holds in front of the camera."""
    board = BoardParams.for_paper("A3")
    corners = board.opencv().getChessboardCorners()
    far = rng.uniform(0.4, 0.9) * camera.focal_px / 820.0
    middle = camera.rays(np.array([[rng.uniform(0, camera.width), rng.uniform(0, camera.height)]]))[0] * far
    turn = geometry.rotation_from_rpy(*rng.uniform(-tilt, tilt, 2), rng.uniform(-math.pi, math.pi))
    points = (corners - corners.mean(axis=0)) @ turn.T + middle
    pixels = camera.project(points) + rng.normal(0.0, 0.15, (len(points), 2))
    inside = camera.contains(pixels)
    return BoardView(pixels[inside], corners[inside, :2].astype(float), np.flatnonzero(inside))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_lens_is_found(seed, tmp_path, monkeypatch, capsys):
    rng, views, camera = np.random.default_rng(seed), [], WIDE
    image = np.full((camera.height, camera.width, 3), 90, np.uint8)
    images = SimpleNamespace(settings=str(tmp_path / "detectors/hall.yaml"), next=lambda: (0.0, Picture(image, "bgr")))

    def find_board(board, image):
        if rng.random() < 0.2:
            raise CodedError("no_board")
        views.append(held(camera, rng))
        return views[-1]

    monkeypatch.setattr(camera_setup, "CameraImages", lambda name: images)
    monkeypatch.setattr(camera_setup, "find_board", find_board)
    monkeypatch.setattr("vb_laser_detect.calibration.lens.MIN_VIEWS", 30)  # for an exact lens
    assert camera_setup.calibrate_lens(SimpleNamespace(camera="hall", paper="A3", square=None)) == 0
    address = re.search(r"http://\S+/", capsys.readouterr().out).group()
    assert b'src="image"' in urlopen(address).read()
    live = cv2.imdecode(np.frombuffer(urlopen(address + "image").read(), np.uint8), cv2.IMREAD_COLOR)
    columns, rows = (0.75 * views[-1].pixels).astype(int).T
    assert live.shape == (540, 960, 3) and np.abs(np.median(live[rows, columns], axis=0) - (0, 220, 0)).max() < 40
    found = load_lens(tmp_path / "lenses/hall.yaml")
    assert found.focal_px == pytest.approx(camera.focal_px, rel=0.012)
    # 90 % of the rays are within 0.01, which is 3 cm at 3 m, of their median error
    grid = np.stack(np.meshgrid(np.linspace(60, 1220, 9), np.linspace(60, 660, 7)), axis=-1).reshape(-1, 2)
    here, there = (rays / np.linalg.norm(rays, axis=1)[:, None] for rays in (found.rays(grid), camera.rays(grid)))
    away = np.linalg.norm(here - there, axis=1)
    assert np.percentile(away - np.median(away), 90) < 0.01


def test_a_board_that_is_never_tilted_does_not_determine_the_lens():
    rng, lens = np.random.default_rng(1), LensCalibration((WIDE.width, WIDE.height))
    for _ in range(80):
        lens.add(held(WIDE, rng, tilt=0.0))
    with refused("board_not_tilted"):
        lens.solve()


def test_the_same_view_does_not_count_twice():
    lens = LensCalibration((1280, 720))
    view = next(view for view in (held(WIDE, np.random.default_rng(seed)) for seed in range(20)) if len(view.ids) >= 8)
    assert lens.add(view) and not lens.add(view)
    with refused("too_few_views"):
        lens.solve()


@pytest.mark.parametrize("camera", [WIDE, CameraModel(1280, 720, WIDE.matrix, np.array([0.02, -0.01, 0, 0]), True)])
def test_a_lens_file_comes_back_as_it_was(tmp_path, camera):
    save_lens(tmp_path / "hall.yaml", "hall", camera)
    found = load_lens(tmp_path / "hall.yaml")
    assert (found.width, found.height, found.fisheye) == (camera.width, camera.height, camera.fisheye)
    assert np.array_equal(found.matrix, camera.matrix) and np.array_equal(found.distortion, camera.distortion)


@pytest.mark.parametrize(
    "text, code", [(None, "no_camera_info"), ("image_width: 3", "bad_lens_file"), (":", "bad_lens_file")]
)
def test_a_lens_file_that_says_nothing_is_refused(tmp_path, text, code):
    if text is not None:
        (tmp_path / "hall.yaml").write_text(text)
    with refused(code):
        load_lens(tmp_path / "hall.yaml")


# ------------------------------------------------------------- delay
def blinking(delay, rate, rng, contrast=60.0, noise=2.0, share=0.02):
    """Returns switching times, and a camera's images of a small blinking window beside moving people."""
    switched = np.cumsum(rng.uniform(0.25, 0.65, 40)) + 100.0
    seen = []
    for stamp in np.arange(99.0, switched[-1] + 3.0, 1.0 / rate) + rng.normal(0, 0.002):
        gathered = stamp - delay + np.linspace(-0.25, 0.25, 9) / rate
        lit = np.mean(np.searchsorted(switched, gathered) % 2)
        image = np.full((180, 320), 70.0)
        side = int(math.sqrt(share * image.size))
        image[40 : 40 + side, 200 : 200 + side] += contrast * lit
        image[100:160, 20:120] += 15.0 * math.sin(0.9 * stamp)
        seen.append((stamp, brightness(np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8))))
    return switched, seen


@pytest.mark.parametrize("delay, rate", [(0.0, 30.0), (0.045, 25.0), (0.3, 10.0), (1.6, 25.0)])
def test_the_delay_is_measured(delay, rate):
    found, uncertainty = measure_delay(*blinking(delay, rate, np.random.default_rng(int(1000 * delay + rate))))
    assert abs(found - delay) < max(0.008, uncertainty)
    assert uncertainty < 0.05


def test_images_that_do_not_follow_the_light_say_nothing():
    switched, seen = blinking(0.1, 25.0, np.random.default_rng(5), contrast=0.0)
    with refused("no_blinking"):
        measure_delay(switched, seen)


def test_a_terminal_gets_its_colours_back_from_an_interrupted_measurement(monkeypatch, capsys):
    monkeypatch.setattr(rospy.Time, "now", staticmethod(rospy.Time))
    monkeypatch.setattr(camera_setup.time, "sleep", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        camera_setup._blink()
    written = capsys.readouterr().out
    assert written.startswith("\x1b[107m") and written.endswith("\x1b[0m\x1b[2J\x1b[H")


# ------------------------------------------------------------- exposure
GIVEN = {"exposure": 120, "white_balance": 5000}


@pytest.fixture
def hall(monkeypatch):
    """Yields a camera for the command `exposure`, whose test says the floor's level [grey levels] at an exposure."""
    camera = SimpleNamespace(
        params={"capture": {**GIVEN, "rate": 5.0}}, now=dict(GIVEN), kept={}, window=math.inf, laser=0
    )
    looks = itertools.count()

    def look(after=0.0):
        image = np.full((200, 200, 3), min(255.0, camera.level(camera.now["exposure"])), np.uint8)
        if camera.now["exposure"] > camera.window:
            image[:, :40] = 255
        if not after and next(looks):  # the person was asked for the laser
            image[100, 100 : 100 + camera.laser] = 255
        return after, Picture(image, "bgr")

    camera.set, camera.keep, camera.next = camera.now.update, camera.kept.update, look
    monkeypatch.setattr(camera_setup, "CameraImages", lambda name: camera)
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(5)))
    return camera


@pytest.mark.parametrize("laser, status", [(4, 0), (0, 1), (90, 1)])  # [px]; 90: a lamp was switched on
@pytest.mark.parametrize("light, window", [(0.2, math.inf), (8.0, math.inf), (60.0, math.inf), (1.0, 60)])
def test_an_exposure_is_found_for_the_floor_and_the_spot(hall, light, window, laser, status, monkeypatch):
    monkeypatch.setattr(camera_setup, "_SPOT_TIMEOUT", 0.1 if status else 60.0)
    hall.level = lambda exposure: 255.0 * (light * exposure / 2000.0) ** (1 / 2.2)
    hall.window, hall.laser = window, laser
    assert camera_setup.set_exposure(SimpleNamespace(camera="hall")) == status
    assert hall.kept == hall.now and hall.now["white_balance"] == 4600
    # at 202 / light the floor's level is 90, and from 75 to 105 it is grey; a window in the image keeps it short
    assert 0.67 < hall.now["exposure"] / min(202.0 / light, window) < 1.4


@pytest.mark.parametrize(
    "level, code",
    [
        (lambda e: 20.0, "exposure_ignored"),
        (lambda e: 5.0 + e / 100.0, "too_dark"),
        (lambda e: 150.0 + e, "too_bright"),
        (Mock(side_effect=CodedError("no_images")), "no_images"),
        (Mock(side_effect=KeyboardInterrupt), ""),
    ],
)
def test_a_search_that_fails_sets_the_camera_back(hall, level, code):
    hall.level = level
    with pytest.raises((CodedError, KeyboardInterrupt)) as raised:
        camera_setup.set_exposure(SimpleNamespace(camera="hall"))
    assert getattr(raised.value, "code", "") == code and hall.now == GIVEN and not hall.kept


@pytest.mark.parametrize(
    "ask, arrived, code", [("set", 0, "detector_missing"), ("model", 0, "no_images"), ("model", 1, "camera_no_lens")]
)
def test_what_does_not_answer_is_named(monkeypatch, ask, arrived, code):
    for wait in ("wait_for_service", "wait_for_message"):
        monkeypatch.setattr(rospy, wait, Mock(side_effect=rospy.ROSException("timeout exceeded")))
    monkeypatch.setattr(camera_setup, "time", SimpleNamespace(monotonic=itertools.count(0.0, 10.0).__next__))
    images = object.__new__(CameraImages)
    images._camera = images._topic = images._image = "/hall"
    images._newest = deque([ReceivedImage(rospy.Time(5), "", lambda: Picture(np.zeros((3, 4, 3)), "bgr"))] * arrived)
    with refused(code):
        getattr(images, ask)()


def test_saturated_share_counts_surfaces_but_not_a_spot():
    image = np.full((480, 640, 3), 120, np.uint8)
    image[100:104, 200:204] = 255  # a laser spot
    assert saturated_share(image) <= 64 / (480 * 640)
    image[:, :160] = 255
    assert saturated_share(image) == saturated_share(image[:, :, 0]) == 0.25 > TOO_BRIGHT
    assert saturated_share(np.zeros((0, 0), np.uint8)) == 0.0


# ------------------------------------------------------------- controls
NEW = """
User Controls

                 white_balance_automatic 0x0098090c (bool)   : default=1 value=1
                                    gain 0x00980913 (int)    : min=0 max=255 step=1 default=0 value=0
               white_balance_temperature 0x0098091a (int)    : min=2000 max=6500 step=1 default=4000 value=4000 flags=inactive

Camera Controls

                           auto_exposure 0x009a0901 (menu)   : min=0 max=3 default=3 value=3 (Aperture Priority Mode)
                  exposure_time_absolute 0x009a0902 (int)    : min=3 max=2047 step=1 default=250 value=250 flags=inactive
"""
OLD = NEW.replace("auto_exposure", "exposure_auto").replace("exposure_time_absolute", "exposure_absolute")
OLD = OLD.replace("white_balance_automatic", "white_balance_temperature_auto")


def test_settings_not_asked_for_are_the_camera_s_own():
    assert controls.plan(NEW, CaptureParams()) == ["auto_exposure=3", "white_balance_automatic=1"]
    ribbon = NEW.replace("min=0 max=3 default=3 value=3", "min=0 max=1 default=0 value=1")  # only two modes
    assert controls.plan(ribbon, CaptureParams())[0] == "auto_exposure=0"
    assert controls.plan("", CaptureParams()) == []
    with refused("no_control"):
        controls.plan("", CaptureParams(exposure=100))


def test_automatic_settings_of_a_device_are_switched_off_before_values_are_set(tmp_path, monkeypatch):
    tool = tmp_path / "v4l2-ctl"
    (tmp_path / "listing").write_text(NEW)
    tool.write_text(
        f'#!/bin/sh\necho "$@" >>{tmp_path}/calls\n[ "$3" = --list-ctrls ] && cat {tmp_path}/listing\nexit 0\n'
    )
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    params = CaptureParams(exposure=50, white_balance=9000)
    controls.apply("/dev/video7", params)
    asked, *told = (tmp_path / "calls").read_text().splitlines()
    names = (
        "auto_exposure=1",
        "exposure_time_absolute=50",
        "white_balance_automatic=0",
        "white_balance_temperature=6500",
    )
    assert asked == "-d /dev/video7 --list-ctrls" and told == [f"-d /dev/video7 --set-ctrl={name}" for name in names]
    assert controls.plan(OLD, params)[:2] == ["exposure_auto=1", "exposure_absolute=50"]
    tool.write_text("#!/bin/sh\necho 'VIDIOC_S_EXT_CTRLS: failed: Permission denied' >&2\nexit 1\n")
    with refused("control_refused") as caught:
        controls.apply("/dev/video7", params)
    assert "Permission denied" in caught.value.message


# ------------------------------------------------------------- settings
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
    before, after = yaml.safe_load(text) or {}, yaml.safe_load(path.read_text())
    assert after == {**before, "capture": {**before.get("capture", {}), "delay_ms": 48.5, "exposure": 100}}
    for comment in ("# mine", "# the left one", "# guessed"):
        assert (comment in text) == (comment in path.read_text())


def test_a_file_in_another_style_is_left_as_it_is(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text("capture: {width: 3}\n")
    with refused("bad_file"):
        set_capture(path, {"delay_ms": 1.0})
    assert path.read_text() == "capture: {width: 3}\n"
