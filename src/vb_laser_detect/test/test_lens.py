"""The printed board is found in rendered images, and a lens is estimated from views of it, against the truth."""

import re

import cv2
import numpy as np
import pytest

from board_scene import CAMERA, POSE, WIDE_CAMERA, corners_on_map, render_board, view_held_board
from refusals import refused
from vb_core.camera_model import project_to_pixels
from vb_core.errors import CodedError
from vb_laser_detect.calibration.lens import PAPERS_MM, BoardParams, LensCalibration, draw_board, find_board
from vb_laser_detect.calibration.lens import write_board

BOARD = BoardParams.for_paper("A3")
VIEWS = [((3.1, 3.2), -1.2, False), ((5.0, 3.0), 0.3, True), ((4.9, 1.7), 2.0, False), ((2.9, 2.0), 0.0, True)]


@pytest.mark.parametrize("place, yaw, color", VIEWS)
def test_corners_are_found_to_a_fraction_of_a_pixel(place, yaw, color):
    image = render_board(BOARD, place, yaw, np.random.default_rng(0))
    view = find_board(BOARD, cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if color else image)
    assert len(view.ids) == 12
    truth = project_to_pixels(CAMERA, POSE, np.column_stack([corners_on_map(view.corners, place, yaw), np.zeros(12)]))
    assert np.abs((view.pixels - truth).mean(axis=0)).max() < 0.06  # no bias: pixel centres are whole numbers
    assert np.linalg.norm(view.pixels - truth, axis=1).max() < 0.5


def test_boards_that_cannot_be_used_are_refused():
    rng = np.random.default_rng(2)
    bare_floor = np.full((1080, 1920), 110, np.uint8)
    with refused("no_board"):
        find_board(BOARD, bare_floor)
    small_board = render_board(BoardParams.for_paper("A4"), (4.0, 2.5), 0.2, rng)
    with refused("board_too_small"):
        find_board(BOARD, small_board)
    with_foot_on_it = render_board(BOARD, (4.0, 2.5), 0.0, rng)
    u, v = project_to_pixels(CAMERA, POSE, np.array([[4.2, 2.4, 0.0]]))[0].astype(int).tolist()
    cv2.circle(with_foot_on_it, (u, v), 45, 60, -1)
    with pytest.raises(CodedError) as raised:
        find_board(BOARD, with_foot_on_it)
    assert raised.value.code in ("board_hidden", "no_board")


@pytest.mark.parametrize("paper", sorted(PAPERS_MM))
def test_the_board_fits_its_paper(paper):
    board = BoardParams.for_paper(paper)
    assert all(1e3 * side <= length - 10 for side, length in zip(board.size, PAPERS_MM[paper]))
    width, height = board.size
    assert draw_board(board, 1000.0).shape == (round(1e3 * height), round(1e3 * width))


def test_printed_image_is_true_to_size(tmp_path):
    # the sheet and the pattern are measured in the file itself
    path = tmp_path / "board.png"
    write_board("A4", str(path))
    page = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert np.abs(np.subtract(page.shape, (210 / 25.4 * 300, 297 / 25.4 * 300))).max() <= 1
    small_page = cv2.resize(page, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    view = find_board(BoardParams.for_paper("A4"), small_page)
    assert len(view.ids) == 12
    pixels_per_meter = np.linalg.norm(np.ptp(view.pixels, axis=0)) / np.linalg.norm(np.ptp(view.corners, axis=0))
    assert pixels_per_meter == pytest.approx(75 / 0.0254, rel=2e-3)


def test_printed_pdf_is_true_to_size(tmp_path):
    path = tmp_path / "board.pdf"
    write_board("A3", str(path))
    content = path.read_bytes()
    (width,) = re.findall(rb"/MediaBox \[ 0 0 ([0-9.]+)", content)
    assert content.startswith(b"%PDF")
    assert float(width) == pytest.approx(420 / 25.4 * 72, abs=0.2)  # points


def test_print_that_is_impossible_is_refused(tmp_path):
    for file in ("board.txt", tmp_path / "no" / "x.png"):
        with refused("bad_file"):
            write_board("A3", str(file))
    with refused("unknown_paper"):
        write_board("A9", str(tmp_path / "board.png"))


# ------------------------------------------------------------------ the lens
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_lens_is_found_from_views(seed):
    rng, calibration = np.random.default_rng(seed), LensCalibration((1280, 720))
    while len(calibration.views) < 30:
        calibration.add(view_held_board(WIDE_CAMERA, rng))
    found, _ = calibration.solve()
    assert found.focal_px == pytest.approx(WIDE_CAMERA.focal_px, rel=0.012)
    # 90 % of the rays are within 0.01, which is 3 cm at 3 m, of their median error
    grid = np.stack(np.meshgrid(np.linspace(60, 1220, 9), np.linspace(60, 660, 7)), axis=-1).reshape(-1, 2)
    rays = (camera.pixels_to_rays(grid) for camera in (found, WIDE_CAMERA))
    found_directions, directions = (vectors / np.linalg.norm(vectors, axis=1)[:, None] for vectors in rays)
    errors = np.linalg.norm(found_directions - directions, axis=1)
    assert np.percentile(errors - np.median(errors), 90) < 0.01


def test_a_board_that_is_never_tilted_does_not_determine_the_lens():
    rng, calibration = np.random.default_rng(1), LensCalibration((1280, 720))
    for _ in range(80):
        calibration.add(view_held_board(WIDE_CAMERA, rng, tilt=0.0))
    with refused("board_not_tilted"):
        calibration.solve()


def test_the_same_view_does_not_count_twice():
    rng, calibration = np.random.default_rng(1), LensCalibration((1280, 720))
    while not calibration.add(view_held_board(WIDE_CAMERA, rng)):
        pass
    (view,) = calibration.views
    assert not calibration.add(view)
    with refused("too_few_views"):
        calibration.solve()
