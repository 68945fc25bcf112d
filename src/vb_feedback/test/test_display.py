"""The smart display: its layout, what it shows, and its words, which can be read from afar."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from refusals import refused
from vb_feedback.display import colors, scene
from vb_feedback.display.layout import Rectangle, fit_texts, fit_view, place_labels, place_words, text_box
from vb_feedback.display.layout import is_drawable, text_width, transliterate, wrap
from vb_feedback.display.restriction_overlay import CLEAR, PREVIEW, STRIPE, draw_restrictions
from vb_feedback.display.rviz_config import overlay_fonts
from vb_feedback.display.scene import PLATE, TEXT
from vb_feedback.display.text_panel import PanelContent, PanelNotice, text_panel_shapes

COMMANDS = ("save", "define_border", "define_seed", "guide_robot", "cancel")
LONG = "The map integrator refuses this border because it would part the kitchen from the rest of the home, " * 2


def text_boxes(shapes):
    """Returns the bounding boxes of all texts and plates."""
    boxes = []
    for shape in shapes:
        x, y = shape.points[0] if shape.points else (0.0, 0.0)
        if shape.kind == TEXT:
            boxes.append(text_box(shape.text, x, y, shape.size[0]))
        elif shape.kind == PLATE:
            boxes.append(Rectangle.from_center(x, y, *shape.size))
    return boxes


def contains(outer, inner, tolerance=1e-9):
    """Returns whether one box is within another."""
    return min(inner.x0 - outer.x0, inner.y0 - outer.y0, outer.x1 - inner.x1, outer.y1 - inner.y1) >= -tolerance


# ------------------------------------------------------------------ layout
sizes = st.floats(0.5, 200.0)
places = st.floats(-1000.0, 1000.0)


@settings(max_examples=40, deadline=None)
@given(places, places, sizes, sizes, st.floats(1.0, 3.0))
def test_the_map_is_whole_and_nothing_overlaps_it(x, y, width, height, aspect):
    extent = Rectangle(x, y, x + width, y + height)
    layout = fit_view(extent, aspect)
    assert contains(layout.view, extent, 1e-6)
    assert math.isclose(layout.view.width / layout.view.height, aspect, rel_tol=1e-9)
    for part in (layout.panel, layout.strip):
        assert contains(layout.view, part, 1e-6)
        assert not part.overlaps(layout.map)
    assert not layout.panel.overlaps(layout.strip)
    # the view is as small as possible: in one direction the map touches the margin of its area
    across = layout.panel.x0 - layout.view.x0
    upwards = layout.view.y1 - layout.strip.y1
    slack = min(across - width, upwards - height) / layout.unit
    assert math.isclose(slack, 0.03, abs_tol=1e-6)


@pytest.mark.parametrize("width, height, aspect", [(0, 5, 1.8), (8, 0, 1.8), (8, 5, 0.1), (8, 5, 50.0)])
def test_an_impossible_layout_is_refused(width, height, aspect):
    with refused("bad_layout"):
        fit_view(Rectangle(0.0, 0.0, width, height), aspect)


WORDS = st.text(alphabet=st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=25)


@settings(max_examples=40, deadline=None)
@given(st.lists(WORDS, min_size=1, max_size=30), st.floats(3.0, 40.0))
def test_wrapped_lines_fit_and_lose_nothing(sentence, width):
    lines = wrap(" ".join(sentence), 1.0, width)
    assert all(text_width(line, 1.0) <= width for line in lines)
    assert "".join(lines).replace(" ", "") == "".join(sentence)


@settings(max_examples=70, deadline=None)
@given(st.lists(st.lists(WORDS, min_size=1, max_size=30), min_size=1, max_size=3), st.floats(5, 40), st.floats(2, 5))
def test_texts_never_leave_the_box_that_they_share(sentences, width, height):
    texts, size = fit_texts([" ".join(sentence) for sentence in sentences], (1.0, 0.8, 0.5), width, height)
    assert len(texts) == len(sentences)
    assert "" not in texts
    assert all(text_width(text, size) <= width for text in texts)
    assert (1.0 + 1.2 * (sum(text.count("\n") + 1 for text in texts) - 1)) * size <= height + 1e-9
    for text, sentence in zip(texts, sentences):
        whole = text.replace("\n", "").replace(" ", "") == "".join(sentence)
        assert whole or text.endswith("...")


def test_words_stand_beside_each_other_centred():
    words, (define, border, save), heights = zip(*place_words("define border\nsave", 10.0, 5.0, 1.0))
    assert words == ("define", "border", "save")
    assert heights == (5.6, 5.6, 4.4)
    half_define, half_border = text_width("define", 1.0) / 2, text_width("border", 1.0) / 2
    assert define + half_define < border - half_border
    assert (define - half_define + border + half_border) / 2 == pytest.approx(10.0)
    assert save == pytest.approx(10.0)


FONT_HAS = ["Küche – Café", "Łódź", "Кухня", "12 m² „ab“…"]
CONVERTED = [("Ku\u0308che", "Küche"), ("厨房", "ChuFang"), ("مطبخ", "mtbkh"), ("line\nbreak", "line break")]


@pytest.mark.parametrize("name, shown", [*zip(FONT_HAS, FONT_HAS), *CONVERTED])
def test_only_letters_that_the_font_lacks_become_those_that_people_recognise(name, shown):
    assert transliterate(name) == shown


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=30))
def test_any_name_is_shown_in_letters_that_can_be_drawn(name):
    shown = transliterate(name)
    assert all(map(is_drawable, shown))
    assert transliterate(shown) == shown
    assert text_width(shown, 1.0) >= 0.0


def test_rviz_is_asked_for_the_letters(tmp_path):
    """An overlay of RViz's package has all its files, and its font every letter that `transliterate` leaves."""
    fonts = tmp_path / "rviz" / "ogre_media" / "fonts"
    fonts.mkdir(parents=True)
    (tmp_path / "rviz" / "package.xml").write_text("<package/>")
    (tmp_path / "rviz" / "ogre_media" / "models").mkdir()
    (fonts / "f.ttf").write_text("letters")
    (fonts / "f.fontdef").write_text('font "F"\n{\n  type truetype\n  source f.ttf\n}\n')
    for _ in range(2):
        overlay = overlay_fonts(tmp_path / "rviz", tmp_path / "over") / "rviz"
        assert (overlay / "package.xml").read_text() == "<package/>"
        assert (overlay / "ogre_media" / "models").is_dir()
        assert (overlay / "ogre_media" / "fonts" / "f.ttf").read_text() == "letters"
        lines = (overlay / "ogre_media" / "fonts" / "f.fontdef").read_text().splitlines()
        assert lines[-2:] == ["  code_points 32-126 161-591 880-1279 8208-8230 8364-8364", "}"]
    assert "code_points" not in (fonts / "f.fontdef").read_text()


boxes = st.builds(Rectangle.from_center, st.floats(-5, 15), st.floats(-5, 12), st.floats(0.5, 1.5), st.floats(0.2, 0.5))


@settings(max_examples=40, deadline=None)
@given(st.lists(boxes, max_size=6))
def test_labels_lie_on_the_map_and_not_on_each_other(wanted):
    within = Rectangle(0.0, 0.0, 8.0, 6.0)
    placed = place_labels(wanted, within)
    if wanted and contains(within, wanted[0]):  # a label within the map stays in place
        assert placed[0].center == pytest.approx(wanted[0].center)
    for number, box in enumerate(placed):
        assert contains(within, box, 1e-6)
        assert (box.width, box.height) == pytest.approx((wanted[number].width, wanted[number].height), rel=1e-9)
        assert not any(box.overlaps(other) for other in placed[:number])


def test_labels_that_are_wanted_at_one_place_find_room():
    # five at the edge, and a flat one, which has to move farther than its own height
    tall, flat = Rectangle.from_center(0.0, 0.0, 1.0, 0.5), Rectangle.from_center(0.0, 0.0, 1.0, 0.2)
    placed = place_labels([*[tall] * 5, flat], Rectangle(0.0, 0.0, 8.0, 6.0))
    assert not any(a.overlaps(b) for a, b in itertools.combinations(placed, 2))
    # the last one fits into the column only exactly
    narrow = Rectangle(0.0, 0.0, 1.0, 2.0)
    column = [Rectangle.from_center(0.5, y, 1.0, 0.5) for y in (0.25, 1.25, 1.75)]
    *others, last = place_labels([*column, Rectangle.from_center(0.5, 1.9, 1.0, 0.4)], narrow)
    assert not any(last.overlaps(other) for other in others)
    assert last.center[1] == pytest.approx(0.75, abs=0.06)


# ------------------------------------------------------------------ what is shown
LAYOUT = fit_view(Rectangle(0, 0, 8, 5), 16 / 9)


def border(**changes):
    values = dict(name="Carpet", points=((1, 1), (3, 1), (3, 2), (1, 2)), closed=True, seed=(2, 1.5), area_m2=2.0)
    return scene.DisplayedBorder(**{**values, **changes})


def test_borders_differ_by_kind():
    def outline(stored):
        return [shape for shape in scene.border_shapes(LAYOUT, [stored]) if shape.namespace == "borders/outline"][0]

    hard, soft, off = outline(border()), outline(border(occupancy=0.4)), outline(border(enabled=False))
    assert sum(soft.colors[0]) > sum(hard.colors[0])
    assert len(set(off.colors[0])) == 1
    # four sides of a polygon, three of a curve
    assert (len(hard.points), len(outline(border(closed=False)).points)) == (8, 6)


def test_an_unconfirmed_border_is_shown_before_and_after():
    old, new = [(0, 0), (1, 0), (1, 1), (0, 1)], [(4, 0), (6, 0), (6, 2), (4, 2)]
    shapes = {shape.namespace: shape for shape in scene.border_shapes(LAYOUT, [border(before=old, after=new)])}
    before, after = shapes["borders/before"], shapes["borders/after"]
    assert before.colors != after.colors == shapes["borders/outline"].colors
    ends = np.array(before.points).reshape(-1, 2, 2)
    assert (np.abs(ends - 0.5).max(axis=2) == 0.5).all()  # on the old outline
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    assert 1.5 < lengths.sum() < 2.5  # dashes cover about half of the outline
    assert len(after.points) == 8
    namespaces = {shape.namespace for shape in scene.border_shapes(LAYOUT, [border()])}
    assert not {"borders/before", "borders/after"} & namespaces


LONG_NAMES = ("Carpet in front of the fireplace and behind the sofa where the dog sleeps at night", "X" * 200, "")


@pytest.mark.parametrize(
    "stored",
    [[border(name=f"Border {number}", seed=(0.0, 0.0)) for number in range(4)]]
    + [[border(name=name, seed=(7.9, 0.1))] for name in LONG_NAMES],
)
def test_labels_stay_on_the_map_and_do_not_overlap(stored):
    shapes = scene.border_shapes(LAYOUT, stored)
    plates = text_boxes([shape for shape in shapes if shape.kind == PLATE])
    texts = text_boxes([shape for shape in shapes if shape.kind == TEXT])
    assert len(plates) == len(stored)
    assert any(shape.text for shape in shapes)
    assert not any(plate.overlaps(other) for plate, other in itertools.combinations(plates, 2))
    assert all(contains(LAYOUT.map, plate) for plate in plates)
    assert all(any(contains(plate, text) for plate in plates) for text in texts)


def test_segments_join_at_corners():
    pairs = np.array(scene.line_segments([(0, 0), (2, 0), (2, 0), (2, 1)], True, 0.2)).reshape(-1, 2, 2)
    assert len(pairs) == 3
    np.testing.assert_allclose(pairs[0], [(-0.1, 0), (2.1, 0)])
    np.testing.assert_allclose(pairs[1], [(2, -0.1), (2, 1.1)])
    assert scene.line_segments([(1, 1)], True, 0.2) == scene.line_segments([], False, 0.2) == ()


def test_spots_fade_and_go():
    spots = [
        scene.TrailPoint("red", 1.0, 1.0, stamp=10.0),
        scene.TrailPoint("red", 1.1, 1.0, stamp=11.0),
        scene.TrailPoint("blue", 2.0, 2.0, stamp=10.9),
    ]
    shapes = {shape.key: shape for shape in scene.spot_shapes(LAYOUT, spots, now=11.0)}
    trail = shapes[("spots/red/trail", 0)]
    assert trail.points == ((1.0, 1.0), (1.1, 1.0))
    assert sum(trail.colors[0]) > sum(trail.colors[1])
    assert trail.colors[1] == colors.camera_color("red") != colors.camera_color("blue")
    assert [shapes[f"spots/{name}", 1].points for name in ("red", "blue")] == [((1.1, 1.0),), ((2.0, 2.0),)]
    # spots that are long past, or in the future because time jumped back, are left out
    for now in (20.0, 0.0):
        assert scene.spot_shapes(LAYOUT, spots, now) == []


def test_only_changes_are_sent():
    first = text_panel_shapes(LAYOUT, PanelContent("border", 1, COMMANDS[:2], True, "Draw."))
    shown = {shape.key: shape for shape in first}
    assert len(shown) == len(first)
    assert scene.find_changes(shown, first) == ([], [])
    later = text_panel_shapes(LAYOUT, PanelContent("border", 2, COMMANDS[:1], True, "Draw."))
    changed, removed = scene.find_changes(shown, later)
    assert [shape.namespace for shape in changed] == ["words/elapsed"]
    assert {namespace for namespace, _ in removed} == {"words/say/1"}


def test_every_shape_is_there_with_a_key_of_its_own():
    shapes = text_panel_shapes(LAYOUT, PanelContent("border", 1, COMMANDS[:4], True, LONG, ("red", "blue", "green")))
    shapes += scene.border_shapes(LAYOUT, [border(), border(name="Room two")]) + scene.robot_shapes("base_link", 0, 0.2)
    drawing = scene.Drawing(((1, 1), (2, 2)), ("", "red"), ((1, 1), (2, 2)), False, (3, 3))
    drawn = scene.drawing_shapes(LAYOUT, drawing)
    assert {shape.namespace.split("/")[1] for shape in drawn} == {"points", "rim", "chain", "seed"}
    shapes += drawn
    assert len({shape.key for shape in shapes}) == len(shapes)
    assert scene.drawing_shapes(LAYOUT, scene.Drawing()) == []


# ----------------------------------------------------------------- restricted areas
def test_overlay_marks_only_what_borders_changed():
    physical = np.zeros((40, 60), np.int8)
    physical[:2] = 100
    physical[20:, 50:] = -1
    map_with_borders = physical.copy()
    map_with_borders[10:30, 10:30] = 100
    map_with_borders[32:38, 5:45] = 40
    overlay = draw_restrictions(physical, map_with_borders, 4)
    assert set(np.unique(overlay)) == {CLEAR, STRIPE}
    assert not overlay[(physical == map_with_borders)].any()
    hard, soft = overlay[11:29, 11:29] == STRIPE, overlay[33:37, 6:44] == STRIPE
    assert 0.4 < hard.mean() < 0.6
    assert 0 < soft.mean() < hard.mean()
    assert {*overlay[10, 10:30], *overlay[10:30, 29]} == {STRIPE}  # the outline
    assert not draw_restrictions(physical, physical, 4).any()


def test_a_preview_differs_from_saved_stripes():
    physical = np.zeros((40, 60), np.int8)
    map_with_borders, planned = physical.copy(), physical.copy()
    map_with_borders[5:20, 5:20] = 100
    planned[22:38, 30:55] = 100
    overlay = draw_restrictions(physical, map_with_borders, 4, planned)
    assert set(np.unique(overlay[planned > 0])) == {CLEAR, PREVIEW}
    assert (overlay[planned == 0] != PREVIEW).all()
    assert 0.4 < (overlay[23:37, 31:54] == PREVIEW).mean() < 0.6
    # preview stripes run down to the right, those of saved areas up to the right
    assert np.array_equal(overlay[8:14, 8:14], overlay[9:15, 7:13])
    assert np.array_equal(overlay[24:30, 32:38], overlay[25:31, 33:39])


# ------------------------------------------------------------------ words
NOTICES = (PanelNotice("Saving would restrict 12.50 m2."), PanelNotice("Note: " + LONG, True))
LAB, STUDIO = Rectangle(-0.2, -0.2, 8.2, 5.2), Rectangle(-0.2, -0.2, 6.2, 4.2)


@pytest.mark.parametrize("extent", [LAB, STUDIO, Rectangle(-30, 7, 10, 12), Rectangle(2, 2, 4, 12)])
@pytest.mark.parametrize("aspect", [16 / 9, 16 / 10, 4 / 3])
@pytest.mark.parametrize("state", ["", "default", "border", "seed", "guide", "another"])
def test_words_overlap_neither_map_nor_each_other(extent, aspect, state):
    layout = fit_view(extent, aspect)
    many = ("red", "green", "blue", "a_camera_with_a_long_name", "hall", "robot", "one too many")
    commands = (), COMMANDS[:4], (*COMMANDS, "stop")
    for shown, message, cameras, notices in itertools.product(commands, ("Ok.", LONG), ((), many), ((), NOTICES)):
        shapes = text_panel_shapes(layout, PanelContent(state, 3599, shown, False, message, cameras, notices))
        for kind in (TEXT, PLATE):
            boxes = text_boxes([shape for shape in shapes if shape.kind == kind])
            for box, other in itertools.combinations(boxes, 2):
                assert not box.overlaps(other)
            for box in boxes:
                assert contains(layout.view, box)
                assert not box.overlaps(layout.map)


def arc_minutes(size, layout):
    """Returns the capitals' visual angle: 0.6 of RViz's text height, seen at 3 m on a 22 inch screen 0.274 m high."""
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
        (LONG[:100], (PanelNotice("Saving would be refused: the border separates nothing.", True),), 10.0),
    ],
)
def test_letters_can_be_read_from_three_metres(extent, message, notices, least):
    layout = fit_view(extent, 16 / 9)
    content = PanelContent("border", 10, COMMANDS[:4], True, message, ("red", "robot"), notices)
    texts = [shape for shape in text_panel_shapes(layout, content) if shape.kind == TEXT]
    angle = {shape.namespace: arc_minutes(shape.size[0], layout) for shape in texts}
    assert angle["words/state"] > 22.0
    assert min(angle[f"words/say/{number}"] for number in range(4)) > 16.0
    assert angle["words/answer"] >= least
    assert min(angle.values()) > 10.0


def texts_of(shapes):
    """Returns the texts by their namespaces, each as one string."""
    words = {}
    for shape in shapes:
        if shape.kind == TEXT:
            words.setdefault(shape.namespace, []).append(shape.text)
    return {name: " ".join(parts) for name, parts in words.items()}


@pytest.mark.parametrize("commands", [COMMANDS, (*COMMANDS, "stop")])
def test_every_command_that_can_be_said_is_shown(commands):
    texts = texts_of(text_panel_shapes(LAYOUT, PanelContent("seed", 65, commands, True, "Yes.")))
    shown = ", ".join(text for name, text in texts.items() if name.startswith("words/say/")).split(", ")
    assert shown == [command.replace("_", " ") for command in commands]


def test_an_answer_shown_as_a_notice_is_said_once():
    notices = (PanelNotice("Stopped: no robot drives.", warning=True), PanelNotice("The spot is seen."))
    content = PanelContent("seed", 1, (), True, notices[0].text, (), notices)
    texts = texts_of(text_panel_shapes(LAYOUT, content))
    shown = [texts[name] for name in texts if "answer" in name or "notice" in name]
    assert shown == ["Stopped: no robot drives.", "The spot is seen."]


def test_a_refusal_stands_out_for_every_eye():
    success = text_panel_shapes(LAYOUT, PanelContent("seed", 1, (), True, "Why not."))
    refusal = text_panel_shapes(LAYOUT, PanelContent("seed", 1, (), False, "Why not."))
    assert not [shape for shape in success if shape.kind == PLATE]
    (plate,) = [shape for shape in refusal if shape.kind == PLATE]
    answer = [shape for shape in refusal if shape.namespace == "words/answer"]
    assert plate.colors == (colors.YELLOW,)
    assert {shape.colors for shape in answer} == {(colors.BLACK,)}
    assert all(contains(text_boxes([plate])[0], text) for text in text_boxes(answer))
