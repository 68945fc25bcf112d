"""Commands that are sent again are carried out once."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from vb_voice_wizard.session import Answer
from vb_voice_wizard.dialogue.answer_cache import AnswerCache


class Counter:
    def __init__(self):
        self.count = 0

    def __call__(self):
        self.count += 1
        return Answer(True, "border_removed", {"borders": str(self.count)})


def test_the_same_id_is_carried_out_once_and_gets_the_same_answer():
    cache, do = AnswerCache(5.0), Counter()
    first = cache.carry_out("a", do)
    assert cache.carry_out("a", do) == first and do.count == 1
    assert cache.carry_out("b", do) != first and do.count == 2
    for count in (3, 4):  # without an id everything is carried out
        assert cache.carry_out("", do).success and do.count == count


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
    cache, do = AnswerCache(5.0), Counter()
    with pytest.raises(ZeroDivisionError):
        cache.carry_out("a", lambda: Answer(1 // 0, ""))
    assert cache.carry_out("a", do).success and do.count == 1


def test_only_the_newest_answers_are_kept():
    cache, do = AnswerCache(5.0), Counter()
    for number in range(1000):
        cache.carry_out(str(number), do)
    assert cache.carry_out("999", do).values == {"borders": "1000"}
    assert cache.carry_out("899", do).values == {"borders": "1001"}
