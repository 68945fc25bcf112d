"""The RViz configuration, fitted to a map and a screen."""

import pytest
import yaml

from refusals import refused
from vb_testing import TOP
from vb_feedback.display.layout import Rectangle, fit_view
from vb_feedback.display.rviz_config import screen_size, write_fitted_config

CONFIG = TOP / "rviz" / "smart_display.rviz"
LAB = Rectangle(0, 0, 8, 5)


@pytest.mark.parametrize("screen", [(1920, 1080), (1920, 1200), (1024, 768), (3440, 1440)])
@pytest.mark.parametrize("aspect", [None, 16 / 9])
@pytest.mark.parametrize("extent", [LAB, Rectangle(-20, -10, 30, 12), Rectangle(1, 1, 2, 9)])
def test_the_display_fills_the_screen(extent, aspect, screen, tmp_path):
    path = tmp_path / "new" / "fitted.rviz"
    write_fitted_config(str(CONFIG), path, extent, *screen, aspect)
    config = yaml.safe_load(path.read_text())
    view = config["Visualization Manager"]["Views"]["Current"]
    layout = fit_view(extent, aspect or screen[0] / screen[1])
    # an orthographic top view: Scale is in pixels per metre, about its centre
    used = [layout.view.width * view["Scale"] / screen[0], layout.view.height * view["Scale"] / screen[1]]
    assert max(used) == pytest.approx(1.0)
    assert min(used) > (0.7 if aspect else 0.999)
    assert (view["X"], view["Y"]) == pytest.approx(layout.view.center)
    assert (config["Window Geometry"]["Width"], config["Window Geometry"]["Height"]) == screen
    # nothing else is changed
    unchanged = yaml.safe_load(CONFIG.read_text())["Visualization Manager"]["Displays"]
    assert config["Visualization Manager"]["Displays"] == unchanged


def test_the_screens_size_is_read():
    said = "name of display:    :0\n  dimensions:    1280x720 pixels (338x190 millimeters)\n  resolution:    96x96 dots per inch"
    assert screen_size(said) == (1280, 720)
    assert screen_size("unable to open display") is None


@pytest.mark.parametrize(
    "text",
    ["", "{}", "{Visualization Manager: {Views: {}}}", "{", CONFIG.read_text().replace("TopDownOrtho", "Orbit")],
    ids=["empty", "nothing in it", "no view", "no YAML", "another view"],
)
def test_other_files_are_refused(text, tmp_path):
    source = tmp_path / "other.rviz"
    source.write_text(text)
    for path in (source, tmp_path / "none.rviz"):
        with refused("bad_config"):
            write_fitted_config(str(path), tmp_path / "fitted.rviz", LAB, 1920, 1080)
