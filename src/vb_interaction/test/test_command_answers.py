"""Answers to commands that are repeated, and to undo and redo."""

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from geometry_msgs.msg import Point

from vb_msgs.msg import VirtualBorder
from vb_interaction.command_answers import Answer, AnswerCache
from vb_interaction.interaction_manager_node import _describe_change


def counting_command():
    """Returns a command whose answers say how often it was carried out."""
    return map(lambda count: Answer(True, "border_removed", {"borders": count}), itertools.count(1)).__next__


def test_the_same_id_is_carried_out_once_and_gets_the_same_answer():
    cache = AnswerCache(5.0)
    command = counting_command()
    # a command without an id is carried out each time
    answers = [cache.answer_once(identity, command).values["borders"] for identity in ("a", "a", "b", "", "", "a")]
    assert answers == [1, 1, 2, 3, 4, 1]


@pytest.mark.parametrize("patience, code", [(60.0, "saved"), (0.0, "busy")])
def test_a_repetition_waits_for_the_first_one_for_a_time(patience, code):
    cache = AnswerCache(patience)
    began, go_on = threading.Event(), threading.Event()

    def slow():
        began.set()
        assert go_on.wait(60)
        return Answer(True, "saved")

    with ThreadPoolExecutor() as pool:
        first = pool.submit(cache.answer_once, "a", slow)
        assert began.wait(60)
        second = pool.submit(cache.answer_once, "a", slow)
        if patience == 0.0:
            assert second.result(60).code == code
        go_on.set()
    assert [future.result().code for future in (first, second)] == ["saved", code]


def test_a_fault_is_not_an_answer():
    cache = AnswerCache(5.0)
    with pytest.raises(ZeroDivisionError):
        cache.answer_once("a", lambda: Answer(1 // 0, ""))
    assert cache.answer_once("a", counting_command()).values == {"borders": 1}


def test_only_the_newest_answers_are_kept():
    cache = AnswerCache(5.0)
    command = counting_command()
    for number in range(1000):
        cache.answer_once(str(number), command)
    assert cache.answer_once("999", command).values == {"borders": 1000}
    assert cache.answer_once("899", command).values == {"borders": 1001}


def rug(**changes):
    return VirtualBorder(**{"id": "b1", "name": "Rug", "enabled": True, **changes})


RUG, OFF, BED = rug(), rug(enabled=False), VirtualBorder(id="b2", name="Bed", enabled=True)
IDLE = VirtualBorder(id="b2", name="Bed", enabled=True, reason="inactive_on_this_map")


@pytest.mark.parametrize(
    "command, before, after, code, name",
    [
        ("undo", [RUG, BED], [RUG], "border_removed", "Bed"),
        ("undo", [RUG], [RUG, BED], "border_restored", "Bed"),
        ("undo", [RUG, BED], [OFF, IDLE], "border_disabled", "Rug"),
        ("undo", [OFF, BED], [RUG, BED], "border_enabled", "Rug"),
        ("undo", [RUG, BED], [rug(name="Carpet"), BED], "change_undone", "Carpet"),
        ("redo", [RUG, BED], [rug(name="Carpet"), BED], "change_redone", "Carpet"),
        ("undo", [RUG, BED], [rug(robots=["ada"]), BED], "change_undone", "Rug"),
        ("undo", [RUG, BED], [rug(occupancy=0.5), BED], "change_undone", "Rug"),
        ("undo", [RUG, BED], [rug(seed=Point(0.05, 0.0, 0.0)), BED], "change_undone", "Rug"),
        # displaced slightly on a map that has grown, which is no change
        ("undo", [RUG, BED], [rug(seed=Point(1e-3, 0.0, 0.0)), BED], "borders_changed", None),
        ("undo", [RUG], [OFF, BED], "borders_changed", None),
        ("undo", [RUG, IDLE], [RUG, BED], "borders_changed", None),  # only the map integrator's reason differs
    ],
)
def test_what_was_undone_is_named(command, before, after, code, name):
    by_id = [{border.id: border for border in borders} for borders in (before, after)]
    answer = _describe_change(command, *by_id)
    assert answer.code == code
    assert answer.values.get("borders") == name
