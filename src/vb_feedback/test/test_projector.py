"""The projector's calibration and its picture."""

import os
import subprocess

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from refusals import refused
from vb_testing import assert_fields, run_command, wait_until
from vb_core.errors import CodedError
from vb_core.grid_map import GridMap
from vb_core.ros import node
from vb_feedback.projector import floor_image
from vb_feedback.projector.floor_image import FloorContent, FloorImage
from vb_feedback.projector.projector_calibration import calibrate, markers, read_calibration, write_calibration
from vb_feedback.projector.projector_window import ProjectorWindow
from vb_feedback.display.scene import DisplayedBorder, Drawing

SIZE = (640, 400)


def marker_positions(pitch=0.3, yaw=0.4, height=2.5, x=0.0, y=0.0, mirrored=False):
    """Returns (4, 2) [m], where a pinhole projector above (x, y) shows its markers on the floor."""
    focal = 600.0
    c, s = np.cos(pitch), np.sin(pitch)
    tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.diag([1.0, -1.0, -1.0])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])
    pixels = markers(*SIZE) - (319.5, 199.5)
    if mirrored:
        pixels = pixels * (-1, 1)
    rays = np.column_stack([pixels / focal, np.ones(4)]) @ (turn @ tilt).T
    return rays[:, :2] * (height / -rays[:, 2:]) + (x, y)


def projected(matrix, points):
    """Returns points (N, 2) mapped by a homography."""
    return cv2.perspectiveTransform(np.asarray(points, float)[:, None], matrix)[:, 0]


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.6, 0.6), st.floats(-3.1, 3.1), st.floats(1.5, 6.0), st.floats(-200, 200), st.booleans())
def test_a_pinhole_projector_is_found_again(pitch, yaw, height, x, mirrored):
    floor = marker_positions(pitch, yaw, height, x, -x / 3, mirrored)
    calibration = calibrate(*SIZE, floor)
    np.testing.assert_allclose(projected(calibration.matrix, floor), markers(*SIZE), atol=0.05)
    corners = [(0, 0), (SIZE[0] - 1, 0), (SIZE[0] - 1, SIZE[1] - 1), (0, SIZE[1] - 1)]
    np.testing.assert_allclose(projected(calibration.matrix, calibration.footprint()), corners, atol=0.01)


def test_a_calibration_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "new" / "projector.yaml"
    written = calibrate(*SIZE, marker_positions())
    write_calibration(written, path)
    read = read_calibration(path)
    assert (read.width, read.height) == SIZE
    assert np.array_equal(read.matrix, written.matrix)


GOOD = [(0.0, 2.0), (3.0, 2.0), (3.0, 0.0), (0.0, 0.0)]


@pytest.mark.parametrize(
    "floor, code",
    [
        ([GOOD[0], GOOD[1], GOOD[1], GOOD[3]], "bad_click"),
        ([(0, 0), (1, 0), (2, 0), (0, 2)], "bad_click"),
        ([GOOD[0], GOOD[2], GOOD[1], GOOD[3]], "bad_click"),
        ([(0.0, 2.0), (3.0, 2.0), (1.0, 1.2), (0.0, 0.0)], "bad_click"),
        ([(0.0, 2.0), (3.0, 2.0), (1.7, 0.0), (1.3, 0.0)], "bad_calibration"),
    ],
    ids=["one clicked twice", "on a line", "in another order", "one inside the others", "beyond the horizon"],
)
def test_degenerate_clicks_are_refused(floor, code):
    with refused(code):
        calibrate(*SIZE, floor)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=4, max_size=4))
def test_any_four_clicks_are_fitted_or_refused(floor):
    try:
        calibration = calibrate(*SIZE, floor)
    except CodedError as error:
        assert error.code in ("bad_click", "bad_calibration")
        return
    np.testing.assert_allclose(projected(calibration.matrix, floor), markers(*SIZE), atol=0.5)


@pytest.mark.parametrize(
    "text",
    ["", "[1, 2]", "width: 10", "{width: x, height: 400, map_to_pixels: []}", "{"]
    + [f"{{width: 640, height: 400, map_to_pixels: {matrix}}}" for matrix in ([[1, 0], [0, 1]], [[0] * 3] * 3)],
)
def test_files_that_are_no_calibration_are_refused(tmp_path, text):
    path = tmp_path / "projector.yaml"
    path.write_text(text)
    with refused("bad_calibration"):
        read_calibration(path)
    with refused("no_calibration"):
        read_calibration(tmp_path / "none.yaml")


# ----------------------------------------------------------------- the picture
CALIBRATION = calibrate(*SIZE, marker_positions(0.2, 0.1, 2.5, 4.0, 2.0))
SQUARE = ((3.7, 1.9), (4.3, 1.9), (4.3, 2.3), (3.7, 2.3))


def render_borders(*borders, brightness=1.0):
    return FloorImage(CALIBRATION, brightness).render(FloorContent("default", borders))


def light_at(picture, x, y):
    """Returns how bright the picture is at a position on the floor [m], 0 .. 255."""
    column, row = np.rint(projected(CALIBRATION.matrix, [(x, y)])[0]).astype(int)
    return int(picture[row, column].max())


def test_things_lie_where_the_calibration_says():
    hard = render_borders(DisplayedBorder("b", SQUARE, True, (4, 2.1)))
    assert_fields(hard, shape=(400, 640, 3), dtype=np.uint8)
    assert all(light_at(hard, x, y) > 150 for x, y in SQUARE + ((4.0, 1.9), (3.7, 2.1)))
    assert light_at(hard, 4.0, 2.1) == light_at(hard, 4.5, 2.1) == 0
    soft = render_borders(DisplayedBorder("b", SQUARE, True, (4, 2.1), occupancy=0.2))
    assert 0 < light_at(soft, 4.0, 1.9) < light_at(hard, 4.0, 1.9)
    assert not render_borders(DisplayedBorder("b", SQUARE, True, (4, 2.1), enabled=False)).any()
    assert not render_borders().any()
    dim = render_borders(DisplayedBorder("b", SQUARE, True, (4, 2.1)), brightness=0.3)
    assert dim.max() == pytest.approx(0.3 * hard.max(), abs=3)


def test_the_drawing_keeps_off_the_spot():
    floor = FloorImage(CALIBRATION)
    drawing = Drawing(chain=((3.4, 2.1), (4.4, 2.1)), seed=(3.6, 1.8))
    whole = floor.render(FloorContent("border", (), drawing))
    part = floor.render(FloorContent("border", (), drawing, spot=(4.4, 2.1)))
    assert light_at(whole, 4.3, 2.1) > 150
    assert light_at(part, 4.3, 2.1) == 0
    assert light_at(part, 3.6, 2.1) > 150
    border = DisplayedBorder("b", ((3.4, 2.1), (4.4, 2.1)), False, (4, 2.3))
    with_border = floor.render(FloorContent("border", (border,), drawing, spot=(4.4, 2.1)))
    assert light_at(with_border, 4.3, 2.1) > 150
    # the seed is a ring
    assert light_at(whole, 3.6, 1.8) == 0
    assert light_at(whole, 3.75, 1.8) > 150


@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_what_save_would_restrict_is_striped(yaw):
    cells = np.zeros((80, 80), np.int8)
    region = GridMap(cells, 0.05, (2.0, 0.0, yaw))
    rows, columns = np.indices(cells.shape)
    centers = region.cell_to_world(np.column_stack([rows.ravel(), columns.ravel()]))
    inside = (np.abs(centers - (4.0, 2.1)) < (0.35, 0.25)).all(axis=1).reshape(cells.shape)
    region = region.with_data(np.where(inside, 100, 0).astype(np.int8))
    shown = FloorImage(CALIBRATION).render(FloorContent("default", region=region))
    grid = [(x, y) for x in np.linspace(3.72, 4.28, 29) for y in np.linspace(1.92, 2.28, 19)]
    assert 0.35 < np.mean([light_at(shown, x, y) > 40 for x, y in grid]) < 0.65
    assert all(light_at(shown, x, y) == 0 for x, y in ((3.5, 2.1), (4.5, 2.1), (4.0, 1.75), (4.0, 2.45)))


def test_nothing_looks_like_a_laser_spot():
    """Each connected region of light is longer than the largest spot that a detector accepts."""
    drawing = Drawing(chain=SQUARE, seed=(4.0, 2.1))
    for content in (
        FloorContent("border", (DisplayedBorder("b", SQUARE, True, (4, 2.1)),), drawing),
        FloorContent("seed", (), drawing),
    ):
        shown = FloorImage(CALIBRATION).render(content)
        count, _, boxes, _ = cv2.connectedComponentsWithStats((shown.max(axis=2) > 20).astype(np.uint8))
        for x, y, width, height, _ in boxes[1:]:
            floor = projected(np.linalg.inv(CALIBRATION.matrix), [(x, y), (x + width, y + height)])
            assert np.linalg.norm(floor[1] - floor[0]) > 0.16
        assert count > 1


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), min_size=2, max_size=6))
def test_whatever_is_drawn_nothing_breaks(chain):
    drawing = Drawing(chain=tuple(chain), closed=True, seed=chain[0])
    assert FloorImage(CALIBRATION).render(FloorContent("seed", (), drawing)).shape == (400, 640, 3)


# ----------------------------------------------------------------- the window
@pytest.fixture
def screen():
    # a fixed display number: servers that choose a free one at the same moment may collide
    display = f":{1000 + os.getpid() % 50000}"
    options = ["-screen", "0", "800x600x24", "-nolisten", "tcp"]
    server = subprocess.Popen(["Xvfb", display, *options], stderr=subprocess.DEVNULL)
    wait_until(lambda: run_command("xwininfo", "-root", "-display", display).returncode == 0, "Xvfb to come up")
    yield display
    server.terminate()
    server.wait()


def test_the_window_shows_each_pixel_where_it_belongs(screen, monkeypatch, tmp_path):
    pytest.importorskip("tkinter")
    monkeypatch.setenv("DISPLAY", screen)
    window = ProjectorWindow(100, 50, *SIZE, start=node.start_thread)
    picture = floor_image.draw_calibration_image(*SIZE, 0)
    picture[:, -3:] = (0, 200, 100)
    path = str(tmp_path / "screen.png")

    def is_shown():
        subprocess.run(["import", "-window", "root", path], check=True, env={**os.environ, "DISPLAY": screen})
        shown = cv2.cvtColor(cv2.imread(path), cv2.COLOR_BGR2RGB)
        return np.array_equal(shown[50 : 50 + SIZE[1], 100 : 100 + SIZE[0]], picture)

    try:
        window.show(picture)
        wait_until(is_shown, "the window to show the picture")
    finally:
        window.close()


def test_without_a_screen_there_is_a_reason(monkeypatch):
    pytest.importorskip("tkinter")
    monkeypatch.setenv("DISPLAY", ":63999")
    with refused("no_window"):
        ProjectorWindow(0, 0, *SIZE, start=node.start_thread)
