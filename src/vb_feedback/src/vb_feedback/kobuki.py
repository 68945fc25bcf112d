"""Maps states and sounds to those of a Kobuki base, the TurtleBot 2's: names to names, no ROS."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping

from vb_core.errors import ParameterError
from vb_core.parameters import Parameters, param
from vb_feedback.display.colours import STATE
from vb_feedback.sound.tone_synthesis import SOUNDS

# the constants of kobuki_msgs/Led and kobuki_msgs/Sound
LEDS = ("BLACK", "GREEN", "ORANGE", "RED")
BEEPS = ("ON", "OFF", "RECHARGE", "BUTTON", "ERROR", "CLEANINGSTART", "CLEANINGEND")


@dataclass(frozen=True)
class KobukiParams(Parameters):
    """Parameters of kobuki_feedback; config/kobuki_feedback.yaml says why.

    Raises:
        ParameterError: names the entry of a mapping that is not a state, sound or constant of Kobuki's.
    """

    leds: dict = param({"default": "BLACK", "border": "ORANGE", "seed": "GREEN", "guide": "RED"})
    sounds: dict = param({
        "border": "BUTTON", "seed": "BUTTON", "guide": "BUTTON", "default": "OFF", "success": "CLEANINGEND", "refusal": "ERROR",
        "asked": "RECHARGE", "stopped": "OFF",
    })

    def __post_init__(self) -> None:
        super().__post_init__()
        _check("leds", self.leds, tuple(STATE), LEDS)
        _check("sounds", self.sounds, tuple(SOUNDS), BEEPS)

    def led(self, state: str) -> str:
        """The name of Led's constant for a state; off for one that is not mapped."""
        return self.leds.get(state, "BLACK")

    def beep(self, sound: str) -> str:
        """The name of Sound's constant for a sound; "" for none."""
        return self.sounds.get(sound, "")


def _check(key: str, mapping: Mapping, known: tuple, values: tuple) -> None:
    for name, value in mapping.items():
        if name not in known:
            raise ParameterError(f"{key}/{name}", f"must be one of {', '.join(known)}")
        if value not in values:
            raise ParameterError(f"{key}/{name}", f"must be one of {', '.join(values)}, got {value!r}")
