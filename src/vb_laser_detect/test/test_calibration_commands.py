"""The commands `lens` and `delay` in a terminal, and the running camera that they use."""

import itertools
import re
from collections import deque
from types import SimpleNamespace
from unittest.mock import Mock
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import cv2
import numpy as np
import pytest
import rospy

from board_scene import WIDE_CAMERA, view_held_board
from refusals import refused
from vb_core.errors import CodedError
from vb_core.image_format import Picture
from vb_laser_detect.calibration.live_picture import LivePicture
from vb_laser_detect.camera.lens_and_settings_files import load_lens
from vb_laser_detect.detection.spot_detector import DetectorParams
from vb_laser_detect.ros import calibration_commands
from vb_laser_detect.ros.camera_feed import ReceivedImage
from vb_laser_detect.ros.calibration_commands import RunningCamera


def test_lens_command_shows_the_board_and_writes_the_file(tmp_path, monkeypatch, capsys):
    rng, views = np.random.default_rng(1), []
    picture = Picture(np.full((720, 1280, 3), 90, np.uint8), "bgr")
    camera = SimpleNamespace(settings=str(tmp_path / "detectors/hall.yaml"), next_image=lambda: (0.0, picture))

    def find_board(board, image):
        if rng.random() < 0.2:
            raise CodedError("no_board")
        views.append(view_held_board(WIDE_CAMERA, rng))
        return views[-1]

    monkeypatch.setattr(calibration_commands, "RunningCamera", lambda name: camera)
    monkeypatch.setattr(calibration_commands, "find_board", find_board)
    assert calibration_commands.calibrate_lens(SimpleNamespace(camera="hall", paper="A3", square=None)) == 0
    assert load_lens(tmp_path / "lenses/hall.yaml").focal_px == pytest.approx(WIDE_CAMERA.focal_px, rel=0.03)
    address = re.search(r"http://\S+/", capsys.readouterr().out).group()
    assert b'src="image"' in urlopen(address).read()
    shown = cv2.imdecode(np.frombuffer(urlopen(address + "image").read(), np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == (540, 960, 3)
    columns, rows = (0.75 * views[-1].pixels).astype(int).T
    assert np.abs(np.median(shown[rows, columns], axis=0) - (0, 220, 0)).max() < 40  # green corners


def test_other_sites_do_not_get_the_live_picture():
    request = Request(LivePicture().address + "image", headers={"Host": "evil.example"})
    with pytest.raises(HTTPError, match="403"):
        urlopen(request)


def test_a_terminal_gets_its_colours_back_from_an_interrupted_measurement(monkeypatch, capsys):
    monkeypatch.setattr(rospy.Time, "now", staticmethod(rospy.Time))
    monkeypatch.setattr(calibration_commands.time, "sleep", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        calibration_commands._blink()
    written = capsys.readouterr().out
    assert written.startswith("\x1b[107m") and written.endswith("\x1b[0m\x1b[2J\x1b[H")


@pytest.mark.parametrize(
    "method, image_count, code",
    [("change_settings", 0, "detector_missing"), ("read_lens", 0, "no_images"), ("read_lens", 1, "camera_no_lens")],
)
def test_what_does_not_answer_is_named(monkeypatch, method, image_count, code):
    for wait in ("wait_for_service", "wait_for_message"):
        monkeypatch.setattr(rospy, wait, Mock(side_effect=rospy.ROSException("timeout exceeded")))
    monkeypatch.setattr(calibration_commands, "time", SimpleNamespace(monotonic=itertools.count(0.0, 10.0).__next__))
    camera = object.__new__(RunningCamera)
    camera._camera = camera._topic = camera._image = "/hall"
    image = ReceivedImage(rospy.Time(5), "", lambda: Picture(np.zeros((3, 4, 3)), "bgr"))
    camera._newest = deque([image] * image_count)
    with refused(code):
        getattr(camera, method)()


def test_a_calibration_sees_spots_as_the_camera_s_detector_does(monkeypatch):
    monkeypatch.setattr(rospy, "Subscriber", Mock())
    params = {"/spot_detector_red": {"detector": {"max_diameter_mm": 60.0, "max_dwell_time": 20.0}}}
    monkeypatch.setattr(rospy, "get_param", params.get)
    assert RunningCamera("red", own_source=False).detector_params.max_diameter_mm == 60.0
    assert RunningCamera("green", own_source=False).detector_params == DetectorParams()
