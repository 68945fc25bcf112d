"""Commands that are sent again are carried out once."""

from __future__ import annotations

import itertools
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from vb_voice_wizard.dialogue.answers import Answer
from vb_voice_wizard.dialogue.answers import AnswerCache


def counted():
    """A command whose answers say how often it was carried out."""
    return map(lambda count: Answer(True, "border_removed", {"borders": count}), itertools.count(1)).__next__


def test_the_same_id_is_carried_out_once_and_gets_the_same_answer():
    cache, do = AnswerCache(5.0), counted()
    # without an id everything is carried out
    answers = [cache.carry_out(identity, do).values["borders"] for identity in ("a", "a", "b", "", "", "a")]
    assert answers == [1, 1, 2, 3, 4, 1]


@pytest.mark.parametrize("patience, code", [(60.0, "saved"), (0.0, "busy")])
def test_a_repetition_waits_for_the_first_one_for_a_time(patience, code):
    cache, began, go_on = AnswerCache(patience), threading.Event(), threading.Event()

    def slow():
        began.set()
        assert go_on.wait(60)
        return Answer(True, "saved")

    with ThreadPoolExecutor() as pool:
        first = pool.submit(cache.carry_out, "a", slow)
        assert began.wait(60)
        second = pool.submit(cache.carry_out, "a", slow)
        if patience == 0.0:
            assert second.result(60).code == code
        go_on.set()
    assert (first.result().code, second.result().code) == ("saved", code)


def test_a_fault_is_not_an_answer():
    cache, do = AnswerCache(5.0), counted()
    with pytest.raises(ZeroDivisionError):
        cache.carry_out("a", lambda: Answer(1 // 0, ""))
    assert cache.carry_out("a", do).values == {"borders": 1}


def test_only_the_newest_answers_are_kept():
    cache, do = AnswerCache(5.0), counted()
    for number in range(1000):
        cache.carry_out(str(number), do)
    assert cache.carry_out("999", do).values == {"borders": 1000}
    assert cache.carry_out("899", do).values == {"borders": 1001}
