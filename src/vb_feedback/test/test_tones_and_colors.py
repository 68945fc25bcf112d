"""Sounds and colours."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import rospy
from hypothesis import given, settings
from hypothesis import strategies as st

from vb_core.vocabulary import STATES
from vb_feedback.display import colors
from vb_feedback.sound.sound_events import SoundEvents
from vb_msgs.msg import InteractionState


def state(name, second=0, refused="", **values):
    """A state message whose last command was answered at a second, and refused with a code if there is one."""
    answer = {"last_answered": rospy.Time(second), "last_success": not refused, "last_code": refused}
    return InteractionState(name=name, **answer, **values)


def test_tones_of_an_interaction():
    tones = SoundEvents()
    assert tones.on_spot(0.0) == []
    steps = (
        (state("default"), [], False),
        (state("border", 1), ["border"], True),
        (state("border", 1), [], True),
        (state("border", 2, "no"), ["error"], True),
        (state("border", 2, "no"), [], True),
        (state("border", 3, "no"), ["error"], True),
        (state("border", 4, "confirm_command"), ["question"], True),
        (state("seed", 4), ["seed"], True),
        (state("seed", 4, ends_at=rospy.Time(99)), ["question"], True),
        (state("seed", 4, ends_at=rospy.Time(99)), [], True),
        (state("seed", 4, stopped=True), ["stopped"], True),
        (state("guide", 5, stopped=True), ["guide"], False),
        (state("default", 6, last_outcome="saved"), ["success"], False),
        (state("border", 7, last_outcome="saved"), ["border"], True),
        (state("default", 8, last_outcome="cancelled"), ["default"], False),
    )
    for second, (message, sounds, tick) in enumerate(steps):
        assert tones.on_state(message) == sounds
        assert tones.on_spot(float(second)) == ["tick"] * tick


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0.0, 0.3), min_size=2, max_size=60))
def test_ticks_keep_their_distance(pauses):
    tones = SoundEvents()
    tones.on_state(state("border"))
    times = list(itertools.accumulate(pauses))
    ticks = [time for time in times if tones.on_spot(time)]
    assert ticks[0] == times[0]
    assert all(later - earlier >= 0.5 for earlier, later in zip(ticks, ticks[1:]))


def test_ticks_go_on_after_time_jumped_back():
    tones = SoundEvents()
    tones.on_state(state("seed"))
    assert tones.on_spot(1000.0) and tones.on_spot(1.0)


# Machado, Oliveira, Fernandes (2009), severity 1, on linear RGB
VISIONS = {
    "normal": np.eye(3),
    "protan": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deutan": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritan": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}


def lab(color, vision):
    rgb = np.array(color)
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(vision @ linear, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear
    f = np.cbrt(xyz / (0.9505, 1.0, 1.089))
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def over(color, ground, alpha):
    return colors.blend(ground, color, alpha)


CAMERAS = {f"camera {name}": colors.camera_color(name) for name in ("red", "green", "blue", "robot")}
GROUND = colors.rgb(30, 34, 42)  # of the words, rviz/smart_display.rviz
# what lies beside each other on the display and means different things
GROUPS = {
    "states": {name: colors.state_color(name) for name in STATES},
    "cameras": CAMERAS,
    # RViz's costmap colours 98 and 200, at the alpha of the config, on white floor
    "areas": {
        "saved": over((249 / 255, 0.0, 5 / 255), colors.WHITE, 0.6),
        "preview": over((1.0, 145 / 255, 0.0), colors.WHITE, 0.6),
        "floor": colors.WHITE,
        "wall": colors.BLACK,
    },
    "lines": {
        "drawn": colors.ORANGE,
        "hard": colors.CRIMSON,
        "soft": colors.blend(colors.CRIMSON, colors.WHITE, 0.33),
        "off": colors.GRAY,
        "path": colors.rgb(117, 80, 160),
        "floor": colors.WHITE,
        "wall": colors.BLACK,
    },
    "discs": {"robot": colors.YELLOW, "seed": colors.SKY_BLUE, "floor": colors.WHITE, **CAMERAS},
    "strip": {"ground": GROUND, "answer": colors.WHITE, "hint": colors.SKY_BLUE, "warning": colors.YELLOW},
}


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("vision", VISIONS)
def test_colours_are_told_apart_by_any_eye(vision, group):
    # a difference of 2.3 in CIELAB is just noticed side by side, one of 10 at a glance
    for (one, color), (other, second) in itertools.combinations(GROUPS[group].items(), 2):
        distance = np.linalg.norm(lab(color, VISIONS[vision]) - lab(second, VISIONS[vision]))
        assert distance > 15.0, f"{one} and {other}: {distance:.1f}"


def luminance(color):
    linear = [share / 12.92 if share <= 0.04045 else ((share + 0.055) / 1.055) ** 2.4 for share in color]
    return float(np.dot((0.2126, 0.7152, 0.0722), linear))


@pytest.mark.parametrize(
    "letters, ground",
    [
        (colors.WHITE, GROUND),
        (colors.PALE, GROUND),
        (colors.SKY_BLUE, GROUND),
        (colors.BLACK, colors.YELLOW),
        (colors.BLACK, colors.WHITE),
        *[(color, GROUND) for color in map(colors.state_color, STATES)],
        *[(colors.blend(color, colors.WHITE, 0.3), GROUND) for color in CAMERAS.values()],
    ],
)
def test_letters_contrast_with_their_ground(letters, ground):
    # WCAG 2.1: 3 for large letters, 4.5 for all
    light, dark = sorted((luminance(letters), luminance(ground)), reverse=True)
    assert (light + 0.05) / (dark + 0.05) > 4.0
