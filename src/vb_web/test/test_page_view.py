"""The view's revisions, borders on the page, and its words."""

import json
import re
from pathlib import Path

import pytest
from geometry_msgs.msg import Point

from vb_testing import assert_fields
from vb_core import sentences
from vb_msgs.msg import VirtualBorder
from vb_web import page_messages
from vb_web.page_view import PageView, coarse_age, mark_borders, json_number

STATIC = Path(__file__).resolve().parents[1] / "src" / "vb_web" / "static"


def test_a_browser_gets_what_is_newer_than_it_knows():
    changes = []
    view = PageView(lambda: changes.append(1))
    assert view.changes_since(0) == (0, "")
    view.put("state", {"name": "border"})
    view.put("robots", {"": [1, 2, 3]})
    revision, text = view.changes_since(0)
    assert json.loads(text) == {"view": {"state": {"name": "border"}, "robots": {"": [1, 2, 3]}}}
    assert view.changes_since(revision) == (revision, "")
    view.put("state", {"name": "border"})  # unchanged
    view.put("state", {"name": "seed"})
    assert json.loads(view.changes_since(revision)[1]) == {"view": {"state": {"name": "seed"}}}
    assert json.loads(view.changes_since(0)[1])["view"]["robots"] == {"": [1, 2, 3]}
    assert len(changes) == 3


def test_nan_and_infinity_never_reach_json():
    assert [json_number(value) for value in (float("nan"), float("inf"), 1.23456)] == [None, None, 1.235]
    with pytest.raises(ValueError):
        PageView().put("robots", float("nan"))


def test_an_age_that_is_read_out_changes_seldom():
    assert [coarse_age(age) for age in (0.4, 2.9, 3.1, 7.0, 59.0, 119.0, 1e6)] == [0, 0, 3, 5, 50, 60, 3600]
    assert len({coarse_age(tenth / 10.0) for tenth in range(600)}) <= 10


def test_a_border_keeps_its_mark_while_it_exists():
    marks = mark_borders({}, ["rug", "bed", "bowl"])
    assert marks == {"rug": "A", "bed": "B", "bowl": "C"}
    marks = mark_borders(marks, ["new", "bowl", "bed"])
    assert marks == {"new": "D", "bowl": "C", "bed": "B"}
    many = [str(number) for number in range(60)]
    marks = mark_borders({}, many)
    assert len(set(marks.values())) == 60
    assert [marks["25"], marks["26"]] == ["Z", "A1"]
    assert mark_borders(marks, many[::-1]) == marks


def test_page_has_exactly_the_words_that_it_uses():
    def find_codes(paths):
        return {code for path in paths for code in re.findall(r"\bpage_[a-z_]+", path.read_text(encoding="utf-8"))}

    in_page = find_codes(STATIC.iterdir())
    used = in_page | find_codes(STATIC.parent.glob("*.py"))
    known = {code for code in sentences.catalog() if code.startswith("page_")}  # the same in all languages
    # a code that ends with _ is completed at run time; page_zone and page_title are also beginnings of other codes
    stems = ("page_title_", "page_zone_", *(code for code in used if code.endswith("_")))
    assert not [code for code in in_page - known if not code.endswith("_")]
    assert all(any(code.startswith(stem) for code in known) for stem in stems if stem in in_page)
    assert not [code for code in known - used if not code.startswith(stems)]


def test_the_page_loads_nothing_from_elsewhere():
    for path in STATIC.iterdir():
        text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"https?://|//cdn|@import|url\(|innerHTML|eval\(|style=", text), path.name


def test_an_unconfirmed_border_is_sent_before_and_after():
    points = [Point(0.0, 0.0, 0.0), Point(1.0, 0.0, 0.0), Point(1.0, 2.0, 0.0)]
    section = page_messages.border_section(VirtualBorder(before=points[:2], after=points))
    assert_fields(section, before=[0, 0, 100, 0], after=[0, 0, 100, 0, 100, 200])
