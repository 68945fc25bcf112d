"""The words on the smart display: nothing overlaps, nothing is cut, everything can be read from afar."""

from __future__ import annotations

import itertools
import math

import pytest

from vb_feedback.display import colors
from vb_feedback.display.layout import Box, fit_view
from vb_feedback.display.scene import PLATE, TEXT
from vb_feedback.display.text_panel import PanelNotice, PanelContent, words

from shape_boxes import COMMANDS, LONG, contains, text_boxes

NOTICES = (PanelNotice("Saving would restrict 12.50 m2."), PanelNotice("Note: " + LONG, True))
LAB, STUDIO = Box(-0.2, -0.2, 8.2, 5.2), Box(-0.2, -0.2, 6.2, 4.2)
LAYOUT = fit_view(LAB, 16 / 9)


@pytest.mark.parametrize("extent", [LAB, STUDIO, Box(-30, 7, 10, 12), Box(2, 2, 4, 12)])
@pytest.mark.parametrize("aspect", [16 / 9, 16 / 10, 4 / 3])
@pytest.mark.parametrize("state", ["", "default", "border", "seed", "guide", "another"])
def test_words_overlap_neither_map_nor_each_other(extent, aspect, state):
    layout = fit_view(extent, aspect)
    many = ("red", "green", "blue", "a_camera_with_a_long_name", "hall", "robot", "one too many")
    for commands, cameras_seeing_spot, message, notices in itertools.product(
        ((), COMMANDS[:4], (*COMMANDS, "stop")), ((), many), ("Ok.", LONG), ((), NOTICES)
    ):
        shapes = words(layout, PanelContent(state, 3599, commands, False, message, cameras_seeing_spot, notices))
        for kind in (TEXT, PLATE):
            boxes = text_boxes([shape for shape in shapes if shape.kind == kind])
            for one, other in itertools.combinations(boxes, 2):
                assert not one.overlaps(other)
            for box in boxes:
                assert contains(layout.view, box) and not box.overlaps(layout.map)


def arc_minutes(size, layout):
    """Of the capitals' height, seen from 3 m on 22 inches at 16:9, 0.274 m high; capitals are 0.6 of RViz's text height."""
    return math.degrees(math.atan(size / layout.unit * 0.274 * 0.6 / 3.0)) * 60.0


@pytest.mark.parametrize("extent", [LAB, STUDIO])
@pytest.mark.parametrize(
    "message, notices, least",
    [
        # ISO 9241-303: at least 16 minutes of arc; Snellen: 20/40 eyes need 10
        ("Draw the border on the floor with the laser.", (), 16.0),
        ("Saved: the robot now stays out of this area.", (), 16.0),
        ("Point at the side that the robot must not enter.", (PanelNotice("Saving would restrict 2.50 m2."),), 14.0),
        ("Save needs a seed: say define seed, then point at the side that is off limits.", (), 14.0),
        (
            LONG[:100],
            (PanelNotice("Saving would be refused: the border separates nothing from the rest.", True),),
            10.0,
        ),
    ],
)
def test_letters_can_be_read_from_three_metres(extent, message, notices, least):
    layout = fit_view(extent, 16 / 9)
    angle = {}
    for shape in words(layout, PanelContent("border", 10, COMMANDS[:4], True, message, ("red", "robot"), notices)):
        if shape.kind == TEXT:
            angle[shape.namespace] = arc_minutes(shape.size[0], layout)
    assert angle["words/state"] > 22.0
    assert min(angle[f"words/say/{number}"] for number in range(4)) > 16.0
    assert angle["words/answer"] >= least
    assert min(angle.values()) > 10.0


def texts_of(shapes):
    found = {}
    for shape in shapes:
        if shape.kind == TEXT:
            found.setdefault(shape.namespace, []).append(shape.text)
    return {name: " ".join(parts) for name, parts in found.items()}


@pytest.mark.parametrize("commands", [COMMANDS, (*COMMANDS, "stop")])
def test_every_command_that_can_be_said_is_shown(commands):
    found = texts_of(words(LAYOUT, PanelContent("seed", 65, commands, True, "Yes.")))
    said = ", ".join(text for name, text in found.items() if name.startswith("words/say/")).split(", ")
    assert said == [command.replace("_", " ") for command in commands]


def test_an_answer_that_stands_as_a_notice_is_said_once():
    stopped, more = PanelNotice("Stopped: no robot drives.", True), PanelNotice("The spot is seen.")
    found = texts_of(words(LAYOUT, PanelContent("seed", 1, (), True, stopped.text, (), (stopped, more))))
    assert [found[name] for name in found if "answer" in name or "notice" in name] == [stopped.text, more.text]


def test_a_refusal_stands_out_for_every_eye():
    good, bad = (words(LAYOUT, PanelContent("seed", 1, (), success, "Why not.")) for success in (True, False))
    assert not [shape for shape in good if shape.kind == PLATE]
    plate = [shape for shape in bad if shape.kind == PLATE][0]
    answer = [shape for shape in bad if shape.namespace == "words/answer"]
    assert plate.colors == (colors.YELLOW,) and all(shape.colors == (colors.BLACK,) for shape in answer)
    box = text_boxes([plate])[0]
    assert all(contains(box, text) for text in text_boxes(answer))
