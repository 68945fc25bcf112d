"""States and sounds on a Kobuki base."""

from vb_feedback.display.colors import STATE
from vb_feedback.kobuki_feedback_node import BEEPS, LEDS
from vb_feedback.sound.tone_synthesis import SOUNDS


def test_each_state_has_a_light_of_its_own_and_answers_differ():
    assert set(LEDS) == set(STATE) and len(set(LEDS.values())) == len(STATE)
    assert set(BEEPS) < set(SOUNDS) and BEEPS["success"] != BEEPS["error"]
