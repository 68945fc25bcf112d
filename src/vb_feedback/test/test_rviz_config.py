"""Fitting the RViz config to a map and a screen."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
import yaml

from refusals import refused
from vb_core.errors import CodedError
from vb_feedback.display.layout import Box, fit_view
from vb_feedback.display.rviz_config import fit_config, screen_size, write_fitted

RVIZ = Path(__file__).resolve().parents[3] / "rviz"


def template():
    return yaml.safe_load((RVIZ / "smart_display.rviz").read_text())


@pytest.mark.parametrize("screen", [(1920, 1080), (1280, 720), (1024, 768)])
@pytest.mark.parametrize("extent", [Box(0, 0, 8, 5), Box(-20, -10, 30, 12), Box(1, 1, 2, 9)])
def test_every_part_of_the_display_is_on_the_screen(extent, screen):
    config = template()
    before = copy.deepcopy(config)
    fitted = fit_config(config, extent, *screen)
    assert config == before
    view = fitted["Visualization Manager"]["Views"]["Current"]
    layout = fit_view(extent, screen[0] / screen[1])
    # an orthographic view from above: pixels per metre about its centre
    for x, y in ((layout.view.x0, layout.view.y0), (layout.view.x1, layout.view.y1), extent.center):
        column = screen[0] / 2 + (x - view["X"]) * view["Scale"]
        row = screen[1] / 2 - (y - view["Y"]) * view["Scale"]
        assert -1e-6 <= column <= screen[0] + 1e-6 and -1e-6 <= row <= screen[1] + 1e-6
    assert (fitted["Window Geometry"]["Width"], fitted["Window Geometry"]["Height"]) == screen


@pytest.mark.parametrize("screen", [(1920, 1200), (1024, 768), (3440, 1440)])
def test_on_a_screen_of_another_aspect_nothing_is_cut(screen):
    layout = fit_view(Box(0, 0, 8, 5), 16 / 9)
    view = fit_config(template(), Box(0, 0, 8, 5), *screen, aspect=16 / 9)["Visualization Manager"]["Views"]["Current"]
    used = [layout.view.width * view["Scale"] / screen[0], layout.view.height * view["Scale"] / screen[1]]
    assert max(used) == pytest.approx(1.0) and min(used) > 0.7
    assert (view["X"], view["Y"]) == pytest.approx(layout.view.center)


def test_the_screens_size_is_read():
    said = "name of display:    :0\n  dimensions:    1280x720 pixels (338x190 millimeters)\n  resolution:    96x96 dots per inch"
    assert screen_size(said) == (1280, 720)
    assert screen_size("unable to open display") is None


@pytest.mark.parametrize("config", [None, {}, {"Visualization Manager": {"Views": {}}}])
def test_other_files_are_refused(config):
    with refused("bad_config"):
        fit_config(config, Box(0, 0, 8, 5), 1920, 1080)


def test_another_view_is_refused():
    config = template()
    config["Visualization Manager"]["Views"]["Current"]["Class"] = "rviz/Orbit"
    with pytest.raises(CodedError):
        fit_config(config, Box(0, 0, 8, 5), 1920, 1080)


def test_a_file_is_fitted(tmp_path):
    output = tmp_path / "new" / "fitted.rviz"
    write_fitted(str(RVIZ / "smart_display.rviz"), output, Box(-5, -2, 5, 2), 1920, 1080)
    assert yaml.safe_load(output.read_text()) == fit_config(template(), Box(-5, -2, 5, 2), 1920, 1080)
    with pytest.raises(CodedError, match="none.rviz"):
        write_fitted(str(tmp_path / "none.rviz"), output, Box(0, 0, 8, 5), 1920, 1080)
    with pytest.raises(CodedError, match="extent"):
        write_fitted(str(RVIZ / "smart_display.rviz"), output, Box(0, 0, 0, 4), 1920, 1080)
