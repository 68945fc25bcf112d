"""What the smart display shows."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from vb_feedback.display import colors, scene
from vb_feedback.display.layout import Box, fit_view
from vb_feedback.display.restriction_overlay import CLEAR, PREVIEW, STRIPE, draw_restrictions
from vb_feedback.display.text_panel import PanelContent, words

from shape_boxes import COMMANDS, LONG, contains, text_boxes

LAYOUT = fit_view(Box(0, 0, 8, 5), 16 / 9)


def border(**changes):
    values = dict(name="Carpet", points=((1, 1), (3, 1), (3, 2), (1, 2)), closed=True, seed=(2, 1.5), area_m2=2.0)
    values.update(changes)
    return scene.Border(**values)


def test_borders_differ_by_kind():
    def outline(one):
        return [shape for shape in scene.borders(LAYOUT, [one]) if shape.namespace == "borders/outline"][0]

    hard, soft, off = outline(border()), outline(border(occupancy=0.4)), outline(border(enabled=False))
    assert sum(soft.colors[0]) > sum(hard.colors[0])
    assert len(set(off.colors[0])) == 1
    # four sides of a polygon, three of a curve
    assert (len(hard.points), len(outline(border(closed=False)).points)) == (8, 6)


def test_a_border_that_waits_for_a_person_is_shown_before_and_after():
    old, new = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]), [(4, 0), (6, 0), (6, 2), (4, 2)]
    shapes = {shape.namespace: shape for shape in scene.borders(LAYOUT, [border(before=old, after=new)])}
    before, after = shapes["borders/before"], shapes["borders/after"]
    assert before.colors != after.colors == shapes["borders/outline"].colors
    ends = np.array(before.points).reshape(-1, 2, 2)
    assert (np.abs(ends - 0.5).max(axis=2) == 0.5).all()  # on the old outline
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert 1.5 < lengths.sum() < 2.5  # dashes: about half of it
    assert len(after.points) == 8
    assert not {"borders/before", "borders/after"} & {shape.namespace for shape in scene.borders(LAYOUT, [border()])}


LONG_NAMES = ("Carpet in front of the fireplace and behind the sofa where the dog sleeps at night", "X" * 200, "")


@pytest.mark.parametrize(
    "stored",
    [[border(name=f"Border {number}", seed=(0.0, 0.0)) for number in range(4)]]
    + [[border(name=name, seed=(7.9, 0.1))] for name in LONG_NAMES],
)
def test_labels_stay_on_the_map_and_do_not_overlap(stored):
    shapes = scene.borders(LAYOUT, stored)
    plates, texts = (text_boxes([one for one in shapes if one.kind == kind]) for kind in (scene.PLATE, scene.TEXT))
    assert len(plates) == len(stored) and any(shape.text for shape in shapes)
    assert not any(one.overlaps(other) for one, other in itertools.combinations(plates, 2))
    assert all(contains(LAYOUT.map, plate) for plate in plates)
    assert all(any(contains(plate, text) for plate in plates) for text in texts)


def test_segments_join_at_corners():
    pairs = np.array(scene.segments([(0, 0), (2, 0), (2, 0), (2, 1)], True, 0.2)).reshape(-1, 2, 2)
    assert len(pairs) == 3
    np.testing.assert_allclose(pairs[0], [(-0.1, 0), (2.1, 0)])
    np.testing.assert_allclose(pairs[1], [(2, -0.1), (2, 1.1)])
    assert scene.segments([(1, 1)], True, 0.2) == () and scene.segments([], False, 0.2) == ()


def test_spots_fade_and_go():
    seen = [
        scene.TrailPoint("red", 1.0, 1.0, 10.0),
        scene.TrailPoint("red", 1.1, 1.0, 11.0),
        scene.TrailPoint("blue", 2.0, 2.0, 10.9),
    ]
    shapes = {shape.key: shape for shape in scene.live_spots(LAYOUT, seen, 11.0)}
    trail = shapes[("spots/red/trail", 0)]
    assert trail.points == ((1.0, 1.0), (1.1, 1.0)) and sum(trail.colors[0]) > sum(trail.colors[1])
    assert trail.colors[1] == colors.camera_color("red") != colors.camera_color("blue")
    assert shapes[("spots/red", 1)].points == ((1.1, 1.0),) and ("spots/blue", 1) in shapes
    # long ago; and time that jumped back: what seems to come from the future is left out
    for now in (20.0, 0.0):
        assert scene.live_spots(LAYOUT, seen, now) == []


def test_only_changes_are_sent():
    first = words(LAYOUT, PanelContent("border", 1, COMMANDS[:2], True, "Draw."))
    shown = {shape.key: shape for shape in first}
    assert len(shown) == len(first)
    assert scene.compare(shown, first) == ([], [])
    later = words(LAYOUT, PanelContent("border", 2, COMMANDS[:1], True, "Draw."))
    changed, gone = scene.compare(shown, later)
    assert [shape.namespace for shape in changed] == ["words/elapsed"]
    assert {namespace for namespace, _ in gone} == {"words/say/1"}


def test_every_shape_is_there_with_a_key_of_its_own():
    shapes = words(LAYOUT, PanelContent("border", 1, COMMANDS[:4], True, LONG, ("red", "blue", "green")))
    shapes += scene.borders(LAYOUT, [border(), border(name="Room two")]) + scene.robot("base_link", 0, 0.18)
    drawn = scene.drawing(LAYOUT, scene.Drawing(((1, 1), (2, 2)), ("", "red"), ((1, 1), (2, 2)), False, (3, 3)))
    shapes += drawn
    kinds = {"drawing/points", "drawing/rim", "drawing/chain", "drawing/seed"}
    assert {shape.namespace for shape in drawn} == kinds and scene.drawing(LAYOUT, scene.Drawing()) == []
    assert len({shape.key for shape in shapes}) == len(shapes)


# ----------------------------------------------------------------- restricted areas
def test_overlay_marks_only_what_borders_changed():
    physical = np.zeros((40, 60), np.int8)
    physical[:2] = 100
    physical[20:, 50:] = -1
    map_with_borders = physical.copy()
    map_with_borders[10:30, 10:30] = 100
    map_with_borders[32:38, 5:45] = 40
    found = draw_restrictions(physical, map_with_borders, 4)
    assert set(np.unique(found)) == {CLEAR, STRIPE}
    assert not found[(physical == map_with_borders)].any()
    hard, soft = found[11:29, 11:29] == STRIPE, found[33:37, 6:44] == STRIPE
    assert 0.4 < hard.mean() < 0.6 and 0 < soft.mean() < hard.mean()
    assert (found[10, 10:30] == STRIPE).all() and (found[10:30, 29] == STRIPE).all()
    assert not draw_restrictions(physical, physical, 4).any()


def test_what_save_would_restrict_is_told_from_what_is_saved():
    physical = np.zeros((40, 60), np.int8)
    map_with_borders, wanted = physical.copy(), np.zeros((40, 60), np.int8)
    map_with_borders[5:20, 5:20] = 100
    wanted[22:38, 30:55] = 100
    found = draw_restrictions(physical, map_with_borders, 4, wanted)
    assert set(np.unique(found[wanted > 0])) == {CLEAR, PREVIEW} and (found[wanted == 0] != PREVIEW).all()
    assert 0.4 < (found[23:37, 31:54] == PREVIEW).mean() < 0.6
    # stripes run down to the right here and up to the right there
    assert np.array_equal(found[8:14, 8:14], found[9:15, 7:13]) and np.array_equal(
        found[24:30, 32:38], found[25:31, 33:39]
    )
