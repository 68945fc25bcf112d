"""Which sound to make when."""
from __future__ import annotations

from typing import List, Optional

TICK = "tick"
SUCCESS = "success"
REFUSAL = "refusal"


class Tones:
    """Turns states and spots into the names of sounds.

    A tone per change of state, one for a save that worked, one for a refusal, and a soft tick per
    accepted spot, at most every `tick_period` seconds. Time may jump back.
    """

    def __init__(self, tick_period: float) -> None:
        self._tick_period = tick_period
        self._state: Optional[str] = None
        self._answer: Optional[tuple] = None
        self._last_tick: Optional[float] = None

    def on_state(self, name: str, success: bool, outcome: str, answer: tuple) -> List[str]:
        """A state message.

        Args:
            name: the state's name.
            success: whether the last command was accepted.
            outcome: of the interaction before: "saved" or "cancelled".
            answer: anything that changes when a command was answered and not when the message is
                only repeated.

        Returns:
            Names of sounds, in the order they are to be played. The first message makes none: it tells
            where the interaction stands, not that something happened.
        """
        sounds: List[str] = []
        if self._state is not None:
            if name != self._state:
                sounds.append(SUCCESS if name == "default" and outcome == "saved" else name)
            elif answer != self._answer and not success:
                sounds.append(REFUSAL)
        self._state, self._answer = name, answer
        return sounds

    def on_spot(self, now: float) -> List[str]:
        """A spot at a time [s]: a tick, if spots are wanted and the last one is long enough ago."""
        if self._state not in ("border", "seed"):
            return []
        if self._last_tick is not None and 0.0 <= now - self._last_tick < self._tick_period:
            return []
        self._last_tick = now
        return [TICK]
