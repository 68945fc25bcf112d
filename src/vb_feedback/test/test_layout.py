"""Where things go on the smart display."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from refusals import refused
from vb_feedback.display.layout import (
    Box,
    fit_view,
    fit_texts,
    place_labels,
    place_words,
    transliterate,
    text_width,
    wrap,
)
from shape_boxes import contains
from vb_feedback.display.rviz_fonts import is_drawn, overlay_fonts

sizes = st.floats(0.5, 200.0)
places = st.floats(-1000.0, 1000.0)
aspects = st.floats(1.0, 3.0)


@settings(max_examples=40, deadline=None)
@given(places, places, sizes, sizes, aspects)
def test_the_map_is_whole_and_nothing_overlaps_it(x, y, width, height, aspect):
    extent = Box(x, y, x + width, y + height)
    layout = fit_view(extent, aspect)
    assert contains(layout.view, extent, 1e-6)
    assert math.isclose(layout.view.width / layout.view.height, aspect, rel_tol=1e-9)
    for part in (layout.panel, layout.strip):
        assert contains(layout.view, part, 1e-6) and not part.overlaps(layout.map)
    assert not layout.panel.overlaps(layout.strip)
    # no smaller view would do: the map touches its room's margin in one direction
    across = layout.panel.x0 - layout.view.x0
    upwards = layout.view.y1 - layout.strip.y1
    slack = min(across - width, upwards - height) / layout.unit
    assert math.isclose(slack, 0.03, abs_tol=1e-6)


@pytest.mark.parametrize("width, height, aspect", [(0, 5, 1.8), (8, 0, 1.8), (8, 5, 0.1), (8, 5, 50.0)])
def test_nonsense_is_refused(width, height, aspect):
    with refused("bad_layout"):
        fit_view(Box(0.0, 0.0, width, height), aspect)


words = st.text(alphabet=st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=25)


@settings(max_examples=40, deadline=None)
@given(st.lists(words, min_size=1, max_size=30), st.floats(3.0, 40.0))
def test_wrapped_lines_fit_and_lose_nothing(sentence, width):
    lines = wrap(" ".join(sentence), 1.0, width)
    assert all(text_width(line, 1.0) <= width for line in lines)
    assert "".join(lines).replace(" ", "") == "".join(sentence)


@settings(max_examples=70, deadline=None)
@given(
    st.lists(st.lists(words, min_size=1, max_size=30), min_size=1, max_size=3),
    st.floats(5.0, 40.0),
    st.floats(2.0, 5.0),
)
def test_texts_never_leave_the_box_that_they_share(sentences, width, height):
    texts, size = fit_texts([" ".join(sentence) for sentence in sentences], (1.0, 0.8, 0.5), width, height)
    assert len(texts) == len(sentences) and all(texts)
    assert all(text_width(text, size) <= width for text in texts)
    assert (1.0 + 1.2 * (sum(text.count("\n") + 1 for text in texts) - 1)) * size <= height + 1e-9
    for text, sentence in zip(texts, sentences):
        whole = text.replace("\n", "").replace(" ", "") == "".join(sentence)
        assert whole or text.endswith("...")


def test_words_stand_beside_each_other_centred():
    placed = place_words("define border\nsave", 10.0, 5.0, 1.0)
    assert [word for word, _, _ in placed] == ["define", "border", "save"]
    (_, x1, y1), (_, x2, y2), (_, x3, y3) = placed
    left, right = x1 - text_width("define", 1.0) / 2, x2 + text_width("border", 1.0) / 2
    assert math.isclose((left + right) / 2, 10.0) and math.isclose(x3, 10.0)
    assert x1 + text_width("define", 1.0) / 2 < x2 - text_width("border", 1.0) / 2
    assert y1 == y2 == 5.6 and y3 == 4.4


def test_plain_letters():
    # what the font has stays as it is, also if it comes in two parts
    for name in (
        "K\u00fcche \u2013 Caf\u00e9",
        "\u0141\u00f3d\u017a",
        "\u041a\u0443\u0445\u043d\u044f",
        "12 m\u00b2 \u201eab\u201c\u2026",
    ):
        assert transliterate(name) == name and all(map(is_drawn, name))
    assert transliterate("Ku\u0308che") == "K\u00fcche"
    # the rest in letters that people recognise, never in question marks
    assert transliterate("\u53a8\u623f") == "ChuFang" and transliterate("\u0645\u0637\u0628\u062e") == "mtbkh"
    assert transliterate("line\nbreak") == "line break"


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=30))
def test_any_name_is_shown_in_letters_that_can_be_drawn(name):
    shown = transliterate(name)
    assert all(map(is_drawn, shown))
    assert transliterate(shown) == shown and text_width(shown, 1.0) >= 0.0


def test_rviz_is_asked_for_the_letters(tmp_path):
    """A folder that stands for RViz's package: all its files, and a font that has what `transliterate` leaves."""
    fonts = tmp_path / "rviz" / "ogre_media" / "fonts"
    fonts.mkdir(parents=True)
    (tmp_path / "rviz" / "package.xml").write_text("<package/>")
    (tmp_path / "rviz" / "ogre_media" / "models").mkdir()
    (fonts / "f.ttf").write_text("letters")
    (fonts / "f.fontdef").write_text('font "F"\n{\n  type truetype\n  source f.ttf\n}\n')
    for _ in range(2):
        found = overlay_fonts(tmp_path / "rviz", tmp_path / "over") / "rviz"
        assert (found / "package.xml").read_text() == "<package/>" and (found / "ogre_media" / "models").is_dir()
        assert (found / "ogre_media" / "fonts" / "f.ttf").read_text() == "letters"
        lines = (found / "ogre_media" / "fonts" / "f.fontdef").read_text().splitlines()
        assert lines[-1] == "}" and lines[-2].startswith("  code_points 32-126 161-591")
    assert "code_points" not in (fonts / "f.fontdef").read_text()


boxes = st.builds(Box.centered, st.floats(-5, 15), st.floats(-5, 12), st.floats(0.5, 1.5), st.floats(0.2, 0.5))


@settings(max_examples=40, deadline=None)
@given(st.lists(boxes, max_size=6))
def test_labels_lie_on_the_map_and_not_on_each_other(wanted):
    within = Box(0.0, 0.0, 8.0, 6.0)
    placed = place_labels(wanted, within)
    if wanted and contains(within, wanted[0]):  # with room it stays
        assert placed[0].center == pytest.approx(wanted[0].center)
    for number, box in enumerate(placed):
        assert contains(within, box, 1e-6)
        assert math.isclose(box.width, wanted[number].width) and math.isclose(box.height, wanted[number].height)
        assert not any(box.overlaps(other) for other in placed[:number])


def test_labels_that_are_wanted_at_one_place_find_room():
    # five at the edge, and a flat one, whose own height is no measure of how far it has to go
    within, tall = Box(0.0, 0.0, 8.0, 6.0), Box.centered(0.0, 0.0, 1.0, 0.5)
    placed = place_labels([tall] * 5 + [Box.centered(0.0, 0.0, 1.0, 0.2)], within)
    assert not any(a.overlaps(b) for number, a in enumerate(placed) for b in placed[:number])
    # the last one in a column that is full but for its own height
    narrow = Box(0.0, 0.0, 1.0, 2.0)
    column = [Box.centered(0.5, y, 1.0, 0.5) for y in (0.25, 1.25, 1.75)]
    full = place_labels(column + [Box.centered(0.5, 1.9, 1.0, 0.4)], narrow)
    assert not any(full[3].overlaps(other) for other in full[:3]) and abs(full[3].center[1] - 0.75) < 0.06
