"""Sounds and colours."""
from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vb_feedback import colours
from vb_feedback.tones import Tones


def test_tones_of_an_interaction():
    tones = Tones(0.5)
    assert tones.on_spot(0.0) == []
    assert tones.on_state("default", True, "", (0,)) == []
    assert tones.on_spot(0.5) == []
    assert tones.on_state("border", True, "", (1,)) == ["border"]
    assert tones.on_state("border", True, "", (1,)) == []
    assert tones.on_state("border", False, "", (2,)) == ["refusal"]
    assert tones.on_state("border", False, "", (2,)) == []
    assert tones.on_state("border", False, "", (3,)) == ["refusal"]
    assert tones.on_spot(1.0) == ["tick"]
    assert tones.on_state("seed", True, "", (4,)) == ["seed"]
    assert tones.on_state("guide", True, "", (5,)) == ["guide"]
    assert tones.on_spot(9.0) == []
    assert tones.on_state("default", True, "saved", (6,)) == ["success"]
    assert tones.on_state("border", True, "saved", (7,)) == ["border"]
    assert tones.on_state("default", True, "cancelled", (8,)) == ["default"]


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(0.0, 0.3), min_size=2, max_size=60))
def test_ticks_keep_their_distance(pauses):
    tones = Tones(0.5)
    tones.on_state("border", True, "", ())
    times = list(itertools.accumulate(pauses))
    ticks = [time for time in times if tones.on_spot(time)]
    assert ticks[0] == times[0]
    assert all(later - earlier >= 0.5 for earlier, later in zip(ticks, ticks[1:]))


def test_ticks_go_on_after_time_jumped_back():
    tones = Tones(0.5)
    tones.on_state("seed", True, "", ())
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


def lab(colour, vision):
    rgb = np.array(colour)
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    linear = np.clip(vision @ linear, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear
    f = np.cbrt(xyz / (0.9505, 1.0, 1.089))
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", VISIONS)
def test_colours_are_told_apart_by_any_eye(vision):
    cameras = [colours.camera_colour(name) for name in ("red", "green", "blue", "robot")]
    for group in (list(colours.STATE.values()), cameras):
        for one, other in itertools.combinations(group, 2):
            assert np.linalg.norm(lab(one, VISIONS[vision]) - lab(other, VISIONS[vision])) > 15.0


def test_cameras_keep_their_colour():
    assert colours.camera_colour("hall") == colours.camera_colour("hall")
    assert colours.camera_colour("")


def test_blend():
    assert colours.blend((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0.25) == (0.25, 0.25, 0.25)
    assert colours.blend((0.2, 0.2, 0.2), (1.0, 1.0, 1.0), -3.0) == (0.2, 0.2, 0.2)
