"""The file of a camera's pose comes back as it was written, and a file that holds no pose is refused."""

import numpy as np
import pytest

from board_scene import POSE
from refusals import refused
from vb_laser_detect.calibration import pose_file
from vb_laser_detect.calibration.pose_file import CameraPose


def test_file_round_trip(tmp_path):
    path = pose_file.calibration_path(str(tmp_path / "new"), "red")
    pose = CameraPose("red", "map", "red_optical_frame", POSE, 812.5)
    for _ in range(2):
        pose_file.write_pose(path, pose, ["8 of 8 points used"])
    assert path.with_name("red.yaml.old").exists() and not list(path.parent.glob("*.part"))
    assert "#   8 of 8 points used\n" in path.read_text()
    loaded = pose_file.read_pose(path)
    assert (loaded.camera, loaded.parent, loaded.frame) == ("red", "map", "red_optical_frame")
    assert np.abs(loaded.T - POSE).max() < 1e-5 and loaded.focal == 812.5


@pytest.mark.parametrize(
    "content, code",
    [
        (None, "no_calibration"),
        ("{", "bad_calibration"),
        ("[1, 2]", "bad_calibration"),
        ("{parent: map, frame: f, translation: [0, 0], rotation: [0, 0, 0, 1]}", "bad_calibration"),
        ("{parent: map, frame: f, translation: [0, 0, .nan], rotation: [0, 0, 0, 1]}", "bad_calibration"),
        ("{parent: map, frame: f, translation: [0, 0, 1], rotation: [0, 0, 0, 0]}", "bad_calibration"),
        ("{parent: '', frame: f, translation: [0, 0, 1], rotation: [0, 0, 0, 1]}", "bad_calibration"),
    ],
)
def test_bad_files_are_refused(tmp_path, content, code):
    path = tmp_path / "red.yaml"
    if content is not None:
        path.write_text(content)
    with refused(code):
        pose_file.read_pose(path)
