"""The printed board, rendered under a camera with noise and lens distortion; and whether cameras agree."""

import math
import re

import cv2
import numpy as np
import pytest

from board_scene import CAMERA, POSE, corners_on_map, render_board
from refusals import refused
from vb_core.camera_model import pixels_of
from vb_core.errors import CodedError
from vb_laser_detect.calibration.lens import PAPERS_MM, BoardParams, draw_board, find_board, write_board
from vb_laser_detect.calibration import camera_watch

BOARD = BoardParams.for_paper("A3")
PLACES = [((3.1, 3.2), -1.2), ((5.0, 3.0), 0.3), ((4.9, 1.7), 2.0), ((2.9, 2.0), 0.0)]


@pytest.mark.parametrize("seed", range(len(PLACES)))
def test_corners_are_found_to_a_fraction_of_a_pixel(seed):
    p1, yaw = PLACES[seed]
    image = render_board(BOARD, p1, yaw, np.random.default_rng(seed))
    # colour images are accepted too
    view = find_board(BOARD, cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if seed % 2 else image)
    assert len(view.ids) == 12
    truth = pixels_of(CAMERA, POSE, np.column_stack([corners_on_map(view.corners, p1, yaw), np.zeros(12)]))
    assert np.abs((view.pixels - truth).mean(axis=0)).max() < 0.06  # no bias: pixel centres are whole numbers
    assert np.linalg.norm(view.pixels - truth, axis=1).max() < 0.5


def test_boards_that_cannot_be_used_are_refused():
    rng = np.random.default_rng(2)
    with refused("no_board"):
        find_board(BOARD, np.full((1080, 1920), 110, np.uint8))
    with refused("board_too_small"):
        find_board(BOARD, render_board(BoardParams.for_paper("A4"), (4.0, 2.5), 0.2, rng))
    hidden = render_board(BOARD, (4.0, 2.5), 0.0, rng)
    middle = pixels_of(CAMERA, POSE, np.array([[4.2, 2.4, 0.0]]))[0].astype(int)
    cv2.circle(hidden, (int(middle[0]), int(middle[1])), 45, 60, -1)  # a foot
    with pytest.raises(CodedError) as raised:
        find_board(BOARD, hidden)
    assert raised.value.code in ("board_hidden", "no_board")


@pytest.mark.parametrize("paper", sorted(PAPERS_MM))
def test_the_board_fits_its_paper(paper):
    board = BoardParams.for_paper(paper)
    assert all(1e3 * side <= length - 10 for side, length in zip(board.size, PAPERS_MM[paper]))
    width, height = board.size
    assert draw_board(board, 1000.0).shape == (round(1e3 * height), round(1e3 * width))


def test_print_is_true_to_size(tmp_path):
    # the sheet and the pattern are measured in the file itself
    path = tmp_path / "board.png"
    write_board("A4", str(path))
    page = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert np.abs(np.subtract(page.shape, (210 / 25.4 * 300, 297 / 25.4 * 300))).max() <= 1
    view = find_board(
        BoardParams.for_paper("A4"), cv2.resize(page, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    )
    assert len(view.ids) == 12
    per_meter = np.linalg.norm(np.ptp(view.pixels, axis=0)) / np.linalg.norm(np.ptp(view.corners, axis=0))
    assert per_meter == pytest.approx(75 / 0.0254, rel=2e-3)
    pdf = tmp_path / "board.pdf"
    write_board("A3", str(pdf))
    content = pdf.read_bytes()
    (wide,) = re.findall(rb"/MediaBox \[ 0 0 ([0-9.]+)", content)
    assert content.startswith(b"%PDF") and float(wide) == pytest.approx(420 / 25.4 * 72, abs=0.2)  # points
    for file in ("board.txt", tmp_path / "no" / "x.png"):
        with refused("bad_file"):
            write_board("A3", str(file))
    with refused("unknown_paper"):
        write_board("A9", str(path))


# ------------------------------------------------------------------ cameras that overlap
def draw(offset=(0.0, 0.0), phase=0.0, seconds=10.0, gap=(), period=0.04):
    """Returns one camera's sightings of a spot that draws a circle at 0.6 m/s."""
    rng, result = np.random.default_rng(0), []
    for t in np.arange(0, seconds, period) + phase:
        if not gap or not gap[0] <= t <= gap[1]:
            place = np.array([math.cos(0.6 * t), math.sin(0.6 * t)]) + offset + rng.normal(0, 0.001, 2)
            result.append((100.0 + t, *place))
    return result


def distance_between(first, second):
    return camera_watch.distance_between(*(np.array(seen).reshape(-1, 3) for seen in (first, second)))


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.03, -0.02)])
@pytest.mark.parametrize("phase, period", [(0.017, 0.04), (0.009, 0.04), (0.08, 0.18)])
def test_distance_between_cameras_is_found_whatever_their_phases(offset, phase, period):
    first, second = draw(seconds=20.0, period=period), draw(offset, phase, 20.0, period=period)
    assert distance_between(first, second) == pytest.approx(math.hypot(*offset), abs=0.003)
    assert distance_between(second, first) == pytest.approx(math.hypot(*offset), abs=0.003)


@pytest.mark.parametrize(
    "other", [[], draw(phase=50.0), draw(seconds=0.5), draw(gap=(0.3, 9.7))], ids=["none", "later", "short", "a gap"]
)
def test_cameras_that_hardly_see_the_spot_together_are_not_compared(other):
    assert math.isnan(distance_between(draw(), other))


def test_a_gap_is_not_bridged():
    """Between two sightings far apart in time, the spot is not on the straight line between them."""
    assert distance_between(draw(), draw(gap=(2.0, 8.0))) < 0.003
