"""The watch over the expected cameras: missing detectors, calibrations that do not fit, cameras that disagree."""

import math
import re

import numpy as np
import pytest

from vb_core import sentences
from vb_core.errors import CodedError
from vb_core.notices import Severity
from vb_laser_detect.calibration import pose_file
from vb_laser_detect.calibration.pose_file import CameraPose
from vb_laser_detect.calibration.camera_faults import CameraFaultFinder, DetectorReport, distance_between, read_files

POSE = CameraPose("north", "map", "north_optical_frame", np.eye(4), 500.0)


def errors_of(notices):
    """Returns the code and camera of each notice, all of which are errors."""
    assert all(notice.severity is Severity.ERROR for notice in notices)
    return [(notice.code, notice.camera) for notice in notices]


def test_a_detector_that_is_gone_is_reported():
    watch = CameraFaultFinder(["north", "south"], 0.0)
    watch.report("north", DetectorReport(1.0))
    watch.report("of_a_robot", DetectorReport(1.0))
    assert errors_of(watch.find_missing_detectors(2.0)) == []
    assert errors_of(watch.find_missing_detectors(16.0)) == [("detector_missing", "north")]
    # a detector that was never heard may still be starting
    assert errors_of(watch.find_missing_detectors(61.0)) == [("detector_missing", name) for name in ("north", "south")]


@pytest.mark.parametrize("offset, reported_age", [(0.0, []), (3600.0, ["3600.01"]), (-4.0, ["-3.30"])])
def test_clock_difference_is_reported_but_not_a_busy_computer(offset, reported_age):
    watch = CameraFaultFinder(["north"], 0.0)
    for step in range(20):
        delay = 0.01 if step % 8 == 0 else 0.7
        watch.report("north", DetectorReport(float(step), age=offset + delay))
    assert [notice.values["age"] for notice in watch.find_wrong_clocks(19.0)] == reported_age
    assert watch.find_wrong_clocks(30.0) == [], "its detector is gone, so its clock is no longer known"


@pytest.mark.parametrize(
    "file, report, has_old_pose, code",
    [
        (POSE, DetectorReport(1.0, POSE.frame, 500.0), False, ""),
        (POSE, DetectorReport(1.0), False, ""),  # no image yet
        (POSE, DetectorReport(1.0, POSE.frame, 504.0), False, ""),
        (POSE, DetectorReport(1.0, POSE.frame, 520.0), False, "camera_other_lens"),
        (POSE, DetectorReport(1.0, "head_camera", 500.0), False, "camera_frame_differs"),
        (CodedError("no_calibration", "there is no file"), DetectorReport(1.0), False, "camera_not_calibrated"),
        (CodedError("no_calibration", "there is no file"), DetectorReport(1.0), True, "camera_file_broken"),
        (CodedError("bad_calibration", "no YAML"), DetectorReport(1.0), False, "camera_file_broken"),
        (CodedError("shared_frame", cameras="north, south", frame="f"), DetectorReport(1.0), False, "shared_frame"),
    ],
)
def test_a_calibration_that_does_not_fit_is_reported_with_its_remedy(file, report, has_old_pose, code):
    watch = CameraFaultFinder(["north"], 0.0)
    watch.report("north", report)
    notices = watch.find_calibration_faults({"north": file}, ["north"] if has_old_pose else [], 1.0)
    assert [notice.code for notice in notices] == ([code] if code else [])
    for language in sentences.languages():
        for notice in notices:
            # a value that is missing would be written as its name
            named = re.findall(r"\{(\w+)\}", sentences.catalog(language)[notice.code])
            assert [name for name in named if f"({name})" in notice.sentence(language)] == []


def test_shared_frame_is_reported_before_calibration():
    watch = CameraFaultFinder(["north", "south"], 0.0)
    for name in ("north", "south"):
        watch.report(name, DetectorReport(1.0, "head_camera"))
    files = {"north": CodedError("no_calibration"), "south": POSE}
    assert watch.find_calibration_faults(files, [], 1.0) == []  # their detectors report the shared frame
    watch.report("north", DetectorReport(20.0, "head_camera"))
    # the other one is gone, so that nobody reports a shared frame any more
    assert ("camera_not_calibrated", "north") in errors_of(watch.find_calibration_faults(files, [], 20.0))


def test_two_files_that_name_each_others_frames_are_judged_together(tmp_path):
    def write(camera, frame):
        path = pose_file.calibration_path(str(tmp_path), camera)
        pose_file.write_pose(path, CameraPose(camera, "map", frame, np.eye(4)), [])

    def codes():
        files = read_files(str(tmp_path), ["a", "b", "c"])
        return {camera: getattr(file, "code", "") for camera, file in files.items()}

    write("a", "frame_b")
    assert codes() == {"a": "", "b": "no_calibration", "c": "no_calibration"}
    write("b", "frame_b")
    assert codes() == {"a": "shared_frame", "b": "shared_frame", "c": "no_calibration"}
    write("b", "frame_a")
    assert codes() == {"a": "", "b": "", "c": "no_calibration"}


def test_cameras_that_disagree_are_named_until_they_agree():
    watch, random = CameraFaultFinder((), 0.0), np.random.default_rng(5)

    def draw(start, south_offset, duration=30.0):
        """Draws where all three see the spot, their images at different times, south's at an offset [m]."""
        for camera, phase, offset in (("north", 0.0, 0.0), ("south", 0.05, south_offset), ("east", 0.02, 0.0)):
            for t in np.arange(start, start + duration, 0.12) + phase:
                point = np.array([2.0 + 0.5 * np.cos(0.4 * t) + offset, 1.0 + 0.5 * np.sin(0.4 * t)])
                watch.add_spot(camera, t, *(point + random.normal(0.0, 0.02, 2)))

    draw(100.0, 0.02)
    assert watch.find_disagreements(131.0) == []
    draw(200.0, 0.11)  # south was turned by two degrees
    notices = watch.find_disagreements(231.0)
    pairs = {(notice.values["first"], notice.values["second"]) for notice in notices}
    assert pairs == {("east", "south"), ("north", "south")}
    assert all(notice.code == "cameras_disagree" and 8 < int(notice.values["cm"]) < 14 for notice in notices)
    # south is calibrated again; the laser is still on, and the detector uses the old pose for a moment longer
    watch.forget_spots("south", 232.0)
    draw(230.5, 0.11, duration=5.5)
    assert watch.find_disagreements(237.0) == []
    draw(300.0, 0.0)
    assert watch.find_disagreements(331.0) == []


# ------------------------------------------------------------------ the distance between two cameras' sightings
def circle(offset=(0.0, 0.0), phase=0.0, seconds=10.0, gap=(), period=0.04):
    """Returns one camera's sightings (N, 3) of a spot that draws a circle at 0.6 m/s."""
    rng = np.random.default_rng(0)
    times = np.arange(0, seconds, period) + phase
    positions = np.column_stack([np.cos(0.6 * times), np.sin(0.6 * times)]) + offset
    sightings = np.column_stack([100.0 + times, positions + rng.normal(0, 0.001, positions.shape)])
    return sightings[(times < gap[0]) | (times > gap[1])] if gap else sightings


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.03, -0.02)])
@pytest.mark.parametrize("phase, period", [(0.017, 0.04), (0.009, 0.04), (0.08, 0.18)])
def test_distance_between_cameras_is_found_whatever_their_phases(offset, phase, period):
    first, second = circle(seconds=20.0, period=period), circle(offset, phase, 20.0, period=period)
    assert distance_between(first, second) == pytest.approx(math.hypot(*offset), abs=0.003)
    assert distance_between(second, first) == pytest.approx(math.hypot(*offset), abs=0.003)


@pytest.mark.parametrize("other", [{"seconds": 0}, {"phase": 50}, {"seconds": 0.5}, {"gap": (0.3, 9.7)}])
def test_cameras_that_hardly_see_the_spot_together_are_not_compared(other):
    assert math.isnan(distance_between(circle(), circle(**other)))


def test_a_gap_is_not_bridged():
    """Between two sightings far apart in time, the spot is not on the straight line between them."""
    assert distance_between(circle(), circle(gap=(2.0, 8.0))) < 0.003
