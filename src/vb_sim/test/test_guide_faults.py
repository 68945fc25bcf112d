"""A robot that is led stands 0.3 s after it must, on the simulated base with its own brakes."""
import math
from pathlib import Path

import numpy as np
import pytest

from vb_robot.safety import SafetyParams
from vb_robot.servoing import Servo, ServoParams
from vb_robot.view import FloorView, ViewParams, to_base
from vb_sim.models import load_models, section
from vb_sim.models_motion import LocalisationModel, RobotModel
from vb_sim.robot_body import RobotBody

MODELS = load_models(str(Path(__file__).resolve().parents[1] / "config" / "models.yaml"))
STEP, CONTROL, IMAGE = 0.01, 1.0 / 20.0, 1.0 / 25.0
FAULT_AT = 6.0


class Led:
    """A robot that follows a spot 0.15 m/s ahead of it; `fault` happens after FAULT_AT, `until` a time."""

    def __init__(self, fault="", until=math.inf, phase=0.0, latency=0.06):
        self.fault, self.until, self.latency = fault, until, latency
        models = section(MODELS, "robot", RobotModel), section(MODELS, "localisation", LocalisationModel)
        self.body = RobotBody((1.0, 2.0, 0.0), 0.18, *models, lambda x, y: 5.0, np.random.default_rng(1))
        self.servo = Servo(ServoParams(), SafetyParams(), FloorView(ViewParams()))
        self.now, self.next_control, self.next_image = 0.0, phase, 0.0
        self.images = []
        self.stood_at = None
        self.speeds = []

    def broken(self, fault):
        return self.fault == fault and FAULT_AT <= self.now < self.until

    def run(self, seconds):
        end = self.now + seconds
        while self.now < end:
            self.now += STEP
            spot = np.array([2.35 + 0.15 * self.now, 2.1])
            if self.now >= self.next_image:
                self.next_image += IMAGE
                if not self.broken("camera"):
                    self.images.append((self.now, spot))
            if self.now >= self.next_control:
                self.next_control += CONTROL
                if not self.broken("guide"):
                    self.control()
            self.body.step(STEP, self.now)
            speed = abs(self.body.velocity[0])
            self.speeds.append(speed)
            if self.now > FAULT_AT and speed == 0.0 and self.stood_at is None:
                self.stood_at = self.now
        return self

    def control(self):
        known = [image for image in self.images[-20:] if image[0] <= self.now - self.latency]
        place = to_base(known[-1][1][None], self.body.estimate())[0] if known else None
        free = 0.0 if self.broken("obstacle") else None if self.broken("pose") else math.inf
        motion = self.servo.step(CONTROL, place, self.now - known[-1][0] if known else 0.0, lambda v, w: free)
        self.body.command(motion.v, motion.w, self.now)


@pytest.mark.parametrize("phase", [0.0, 0.02, 0.04])
@pytest.mark.parametrize("fault", ["camera", "guide", "obstacle", "pose"])
def test_stands_in_time_and_goes_on(fault, phase):
    led = Led(fault, FAULT_AT + 5.0, phase).run(FAULT_AT + 4.9)
    assert led.speeds[int(5.8 / STEP)] > 0.1, "it was driving"
    began = led.images[-1][0] if fault == "camera" else FAULT_AT
    assert led.stood_at - began <= 0.3 + STEP, f"{led.stood_at - began:.2f} s"
    assert led.speeds[-1] == 0.0
    led.servo.reset()
    led.run(4.0)
    assert max(led.speeds[-200:]) > 0.1, "it goes on when the fault is over"
    assert max(led.speeds) <= 0.2 + 1e-6


def test_a_slow_computer_does_not_make_it_crawl():
    led = Led(latency=0.2).run(8.0)
    assert max(led.speeds[-200:]) > 0.1
