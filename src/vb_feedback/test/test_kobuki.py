"""States and sounds on a Kobuki base."""
from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from vb_core.errors import ParameterError
from vb_feedback.display.colours import STATE
from vb_feedback.kobuki import BEEPS, LEDS, KobukiParams


def test_each_state_has_a_light_of_its_own_and_answers_differ():
    params = KobukiParams()
    lights = [params.led(state) for state in STATE]
    assert len(set(lights)) == len(STATE) and set(lights) == set(LEDS)
    assert params.led("no such state") == "BLACK"
    assert params.beep("success") != params.beep("refusal") and {params.beep("success"), params.beep("refusal")} < set(BEEPS)
    assert params.beep("tick") == params.beep("no such sound") == ""


def test_the_file_says_what_the_defaults_are():
    path = Path(__file__).resolve().parents[1] / "config" / "kobuki_feedback.yaml"
    assert KobukiParams.from_mapping(yaml.safe_load(path.read_text()), "~") == KobukiParams()


@pytest.mark.parametrize("key, mapping", [
    ("leds", {"border": "PINK"}), ("leds", {"boarder": "RED"}), ("sounds", {"seed": "MOO"}), ("sounds", {"default": False}),
    ("sounds", {"bang": "ON"}),
])
def test_mistakes_are_named(key, mapping):
    with pytest.raises(ParameterError) as caught:
        KobukiParams(**{key: mapping})
    assert f"{key}/{next(iter(mapping))}" in str(caught.value)
