"""When a robot follows the spot, and where the spot is for it while it moves and is localised anew."""
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from vb_core import geometry
from vb_robot.guiding import Frames, Guiding, GuidingParams
from vb_robot.safety import SafetyParams
from vb_robot.servoing import Servo, ServoParams
from vb_robot.sightings import BORDER, DEFAULT, GUIDE, SEED, Sighting
from vb_robot.view import FloorView, ViewParams

CONFIG = Path(__file__).resolve().parents[1] / "config" / "robot_guide.yaml"
STEP = 0.05


class Led:
    """A guiding robot that stands where it is told; spots are fed at 20 Hz with an age of 0.05 s."""

    def __init__(self, follow="auto", state=GUIDE):
        servo = Servo(ServoParams(), SafetyParams(), FloorView(ViewParams()))
        self.guiding = Guiding(GuidingParams(), follow, servo)
        self.now, self.T_map_odom, self.T_odom_base = 100.0, np.eye(4), np.eye(4)
        self.asked = []
        if state is not None:
            self.guiding.set_state(state, "a", self.now)

    def see(self, x, y, camera="robot", mobile=True, age=0.05):
        self.guiding.add(Sighting(self.now - age, (x, y), camera, mobile))

    def step(self, spot=None, localised=True):
        self.now += STEP
        if spot is not None:
            self.see(*spot)

        def odom_from_map(stamp):
            self.asked.append(stamp)
            return geometry.invert(self.T_map_odom) if localised else None

        frames = Frames(odom_from_map, lambda: geometry.invert(self.T_odom_base))
        return self.guiding.step(self.now, STEP, frames, lambda v, w: math.inf)

    def run(self, steps, spot=None):
        return [self.step(spot) for _ in range(steps)][-1]


FAR = (2.0, 0.0)  # so far ahead that the robot drives nearer


def test_leads_in_guide_and_stands_once_when_that_ends():
    led = Led()
    led.run(20, FAR)
    assert led.guiding.active and led.step(FAR).v > 0.1
    led.guiding.set_state(DEFAULT, "", led.now)
    motion = led.step(FAR)
    assert (motion.v, motion.w) == (0.0, 0.0) and not led.guiding.active
    assert led.step(FAR) is None, "the robot is somebody else's now"


@pytest.mark.parametrize("state", [BORDER, SEED])
@pytest.mark.parametrize(
    "follow, alone, watched", [("auto", True, False), ("true", True, True), ("false", False, False)])
def test_who_drives_while_a_border_is_drawn(follow, alone, watched, state):
    led = Led(follow, state)
    led.run(30, FAR)
    assert led.guiding.active == alone, "auto waits a second for a stationary camera, then people draw with it alone"
    led.see(*FAR, camera="red", mobile=False)
    led.step(FAR)
    assert led.guiding.active == watched


def test_auto_waits_for_a_stationary_camera():
    led = Led("auto", BORDER)
    led.run(10, FAR)
    assert not led.guiding.active
    assert not Led("auto", None).run(30, FAR)


def test_cameras_that_contributed_before_a_restart_count():
    led = Led("auto", BORDER)
    led.guiding.contributed("another", ["red"])
    led.run(30, FAR)
    assert led.guiding.active
    led.guiding.contributed("a", ["red", "robot"])
    led.step(FAR)
    assert not led.guiding.active


def test_of_two_robots_only_the_one_follows_that_sees_the_spot_longer():
    led = Led()
    for _ in range(20):
        led.see(*FAR, camera="bob")
        led.step()
    led.see(*FAR, camera="bob")
    led.step(FAR)
    assert not led.guiding.active


def test_spot_stays_where_it_is_on_the_floor_while_the_localisation_leaps():
    led = Led()
    led.run(20, FAR)
    led.T_map_odom = geometry.pose2d_transform(0.0, 3.0, 1.0)  # the next spots come by it, what is kept does not move
    assert abs(led.step().w) < 1e-9
    led.T_odom_base = geometry.pose2d_transform(0.0, 0.0, -0.6)  # but the robot's own turning does tell
    assert led.step().w > 0.0


def test_spot_waits_until_it_is_known_where_the_robot_was():
    led = Led()
    for _ in range(4):
        motion = led.step(FAR, localised=False)
    assert motion.v == 0.0 and motion.reason == "the spot is gone"
    led.asked.clear()
    led.run(4, FAR)
    assert led.step().v > 0.0
    assert all(np.diff(led.asked) >= 0.0), "the newest first, and none again"


def test_spot_of_the_state_before_does_not_count():
    led = Led()
    led.run(20, FAR)
    led.guiding.set_state(BORDER, "a", led.now)
    led.guiding.set_state(GUIDE, "a", led.now)
    assert led.step().reason == "the spot is gone"


def test_spot_that_is_gone_lets_it_stand():
    led = Led()
    led.run(30, FAR)
    for _ in range(8):
        motion = led.step()
    assert motion.v == 0.0, "0.4 s after the last image"


def test_the_file_of_parameters_has_the_defaults():
    settings = yaml.safe_load(CONFIG.read_text())
    own = {key: settings[key] for key in ("camera", "auto_wait", "mobile_cameras")}
    assert GuidingParams.from_mapping({**own, "mobile_cameras": tuple(own["mobile_cameras"])}) == GuidingParams()
    for group, params in (("servo", ServoParams), ("safety", SafetyParams), ("view", ViewParams)):
        assert params.from_mapping(settings[group]) == params()
