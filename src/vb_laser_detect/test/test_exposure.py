"""The command `exposure` finds an exposure time for a simulated floor; saturation is that of surfaces."""

import math
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import rospy

from vb_core.errors import CodedError
from vb_core.image_format import Picture
from vb_laser_detect.camera.exposure import TOO_BRIGHT, saturated_share
from vb_laser_detect.ros import calibration_commands

OLD_SETTINGS = {"exposure": 120, "white_balance": 5000}


class HallCamera:
    """Stands in for a running camera; `floor_level` returns the floor's grey level at an exposure time [0.1 ms]."""

    window_exposure = math.inf  # [0.1 ms] from this exposure time on, a window in the image is white
    spot_px = 0  # length of the spot that shows once the person was asked for it

    def __init__(self):
        self.params = {"capture": {**OLD_SETTINGS, "rate": 5.0}}
        self.settings, self.written_settings = dict(OLD_SETTINGS), {}
        self.change_settings, self.write_settings = self.settings.update, self.written_settings.update
        self._has_asked_for_laser = False

    def next_image(self, earliest=0.0):
        image = np.full((200, 200, 3), min(255.0, self.floor_level(self.settings["exposure"])), np.uint8)
        if self.settings["exposure"] >= self.window_exposure:
            image[:, :40] = 255
        if self._has_asked_for_laser:
            image[100, 100 : 100 + self.spot_px] = 255
        self._has_asked_for_laser = not earliest  # while exposure times are tried, images must be newer than each
        return earliest, Picture(image, "bgr")


@pytest.fixture
def hall(monkeypatch):
    camera = HallCamera()
    monkeypatch.setattr(calibration_commands, "RunningCamera", lambda name: camera)
    monkeypatch.setattr(rospy.Time, "now", staticmethod(lambda: rospy.Time(5)))
    return camera


@pytest.mark.parametrize("spot_px, status", [(4, 0), (0, 1), (90, 1)])  # 90: a lamp was switched on
@pytest.mark.parametrize("light, window", [(0.2, math.inf), (8.0, math.inf), (60.0, math.inf), (1.0, 61)])
def test_an_exposure_is_found_for_the_floor_and_the_spot(hall, light, window, spot_px, status, monkeypatch):
    monkeypatch.setattr(calibration_commands, "_SPOT_TIMEOUT", 0.1 if status else 60.0)
    hall.floor_level = lambda exposure: 255.0 * (light * exposure / 2000.0) ** (1 / 2.2)
    hall.window_exposure, hall.spot_px = window, spot_px
    assert calibration_commands.set_exposure(SimpleNamespace(camera="hall")) == status
    assert hall.written_settings == hall.settings
    assert hall.settings["white_balance"] == 4600
    # at 202 / light the floor's level is 90, and from 75 to 105 it is grey; a window in the image keeps it short
    assert hall.settings["exposure"] < window
    assert 0.67 < hall.settings["exposure"] / min(202.0 / light, window) < 1.4


@pytest.mark.parametrize(
    "floor_level, window, code",
    [
        (lambda exposure: 20.0, math.inf, "exposure_ignored"),
        (lambda exposure: 5.0 + exposure / 100.0, math.inf, "too_dark"),
        (lambda exposure: exposure, 30, "too_dark"),
        (lambda exposure: 150.0 + exposure, math.inf, "too_bright"),
        (lambda exposure: exposure, 0, "too_bright"),
        (Mock(side_effect=CodedError("no_images")), math.inf, "no_images"),
        (Mock(side_effect=KeyboardInterrupt), math.inf, ""),
    ],
)
def test_a_search_that_fails_sets_the_camera_back(hall, floor_level, window, code):
    hall.floor_level, hall.window_exposure = floor_level, window
    with pytest.raises((CodedError, KeyboardInterrupt)) as raised:
        calibration_commands.set_exposure(SimpleNamespace(camera="hall"))
    assert getattr(raised.value, "code", "") == code
    assert hall.settings == OLD_SETTINGS and not hall.written_settings


def test_saturated_share_counts_surfaces_but_not_a_spot():
    image = np.full((480, 640, 3), 120, np.uint8)
    image[100:104, 200:204] = 255  # a laser spot
    assert saturated_share(image) <= 64 / (480 * 640)
    image[:, :160] = 255
    assert saturated_share(image) == saturated_share(image[:, :, 0]) == 0.25
    assert TOO_BRIGHT < 0.25
    assert saturated_share(np.zeros((0, 0), np.uint8)) == 0.0
