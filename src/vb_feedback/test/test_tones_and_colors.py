"""Sounds and colours, and both on a Kobuki base, without the need for its messages."""

import itertools
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import rospy
from hypothesis import given, settings, strategies as st

from vb_core.interaction_tables import STATES
from vb_feedback.display import colors
from vb_feedback.kobuki_feedback_node import KobukiFeedbackNode
from vb_feedback.ros.sound_events import SoundEvents
from vb_msgs.msg import InteractionState, Sound


def state(name, second=0, refused="", **values):
    """Returns a state message whose last command was answered at `second`, and refused if a code is given."""
    answer = {"last_answered": rospy.Time(second), "last_success": not refused, "last_code": refused}
    return InteractionState(name=name, **answer, **values)


def test_each_change_of_an_interaction_has_its_sound():
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
    for second, (message, sounds, is_ticking) in enumerate(steps):
        assert tones.on_state(message) == sounds
        assert tones.on_spot(float(second)) == (["tick"] if is_ticking else [])


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
    assert [tones.on_spot(now) for now in (1000.0, 1.0)] == [["tick"], ["tick"]]


# Machado, Oliveira, Fernandes (2009), severity 1: matrices (3, 3), row by row, on linear RGB
VISIONS = {
    "normal": [1, 0, 0, 0, 1, 0, 0, 0, 1],
    "protan": [0.152286, 1.052583, -0.204868, 0.114503, 0.786281, 0.099216, -0.003882, -0.048116, 1.051998],
    "deutan": [0.367322, 0.860646, -0.227968, 0.280085, 0.672501, 0.047413, -0.011820, 0.042940, 0.968881],
    "tritan": [1.255528, -0.076749, -0.178779, -0.078411, 0.930809, 0.147602, 0.004733, 0.691367, 0.303900],
}


def linear(color):
    """Converts sRGB to linear RGB."""
    return np.where(np.array(color) <= 0.04045, np.array(color) / 12.92, ((np.array(color) + 0.055) / 1.055) ** 2.4)


def lab(color, vision):
    seen = np.clip(np.reshape(vision, (3, 3)) @ linear(color), 0, 1)
    return cv2.cvtColor(np.float32([[seen]]), cv2.COLOR_LRGB2Lab)[0, 0]


CAMERAS = {f"camera {name}": colors.camera_color(name) for name in ("red", "green", "blue", "robot")}
GROUND = colors.rgb(30, 34, 42)  # behind the words, rviz/smart_display.rviz
FLOOR, WALL = {"floor": colors.WHITE}, {"wall": colors.BLACK}
# RViz's costmap colours 98 and 200 on white floor, with the configuration's alpha
SAVED, PREVIEW = (colors.blend(colors.WHITE, colors.rgb(*color), 0.6) for color in ((249, 0, 5), (255, 145, 0)))
BORDERS = {"hard": colors.CRIMSON, "soft": colors.blend(colors.CRIMSON, colors.WHITE, 0.33), "off": colors.GRAY}
GROUPS = {  # colours that may be adjacent on the display and have different meanings
    "states": {name: colors.state_color(name) for name in STATES},
    "areas": {"saved": SAVED, "preview": PREVIEW, **FLOOR, **WALL},
    "lines": {"drawn": colors.ORANGE, "path": colors.rgb(117, 80, 160), **BORDERS, **FLOOR, **WALL},
    "discs": {"robot": colors.YELLOW, "seed": colors.SKY_BLUE, **FLOOR, **CAMERAS},
    "strip": {"ground": GROUND, "answer": colors.WHITE, "hint": colors.SKY_BLUE, "warning": colors.YELLOW},
}


@pytest.mark.parametrize("group", GROUPS)
@pytest.mark.parametrize("vision", VISIONS)
def test_colours_can_be_distinguished_by_any_eye(vision, group):
    # a difference of 2.3 in CIELAB is just noticeable side by side, one of 10 at a glance
    for (one, color), (other, second) in itertools.combinations(GROUPS[group].items(), 2):
        distance = np.linalg.norm(lab(color, VISIONS[vision]) - lab(second, VISIONS[vision]))
        assert distance > 15.0, f"{one} and {other}: {distance:.1f}"


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
    dark, light = sorted(float(np.dot((0.2126, 0.7152, 0.0722), linear(color))) for color in (letters, ground))
    # WCAG 2.1: 3 for large letters, 4.5 for others
    assert (light + 0.05) / (dark + 0.05) > 4.0


class KobukiMessages:
    """The messages of kobuki_msgs, with the package's own constants."""

    class Led(SimpleNamespace):
        BLACK, GREEN, ORANGE, RED = range(4)

    class Sound(SimpleNamespace):
        ON, OFF, RECHARGE, BUTTON, ERROR, CLEANINGSTART, CLEANINGEND = range(7)


def test_lights_show_the_state_and_the_stop_and_errors_beep(monkeypatch):
    sent = []
    monkeypatch.setattr(rospy, "Subscriber", lambda *_args, **_named: None)

    def publisher(topic, *_args, **_named):
        return SimpleNamespace(publish=lambda message: sent.append((topic.rsplit("/", 1)[1], message.value)))

    monkeypatch.setattr(rospy, "Publisher", publisher)
    red = KobukiMessages.Led.RED
    node = KobukiFeedbackNode(KobukiMessages)
    node._on_state(InteractionState(name="guide"))
    node._on_state(InteractionState(name="guide", border_s=1.0))  # unchanged lights are not sent again
    node._on_state(InteractionState(name="default"))
    node._on_state(InteractionState(name="guide", stopped=True))
    assert sent == [("led1", red), ("led2", 0), ("led1", 0), ("led2", 0), ("led1", red), ("led2", red)]
    sent.clear()
    for name in ("tick", "error", "no such sound"):
        node._on_sound(Sound(name=name))
    assert sent == [("sound", KobukiMessages.Sound.ERROR)]
