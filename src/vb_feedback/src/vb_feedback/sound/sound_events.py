"""Decides which sound to make when."""

from __future__ import annotations

from typing import List, Optional

from vb_core.sounds import ERROR, QUESTION, STOPPED, SUCCESS, TICK
from vb_core.vocabulary import DEFAULT, STATES

TICK_PERIOD = 0.5  # [s] at 25 spots a second one tick for each would be a buzz
# codes of answers that are a question, not an error
_QUESTIONS = ("confirm_save", "confirm_command")


class SoundEvents:
    """Turns states and spots into the names of sounds.

    A tone per change of state, one for a save that worked, one for an error, one for a question and for a drawing that
    is about to be dropped, one for a stop, and a soft tick per accepted spot, at most every TICK_PERIOD.
    Time may jump back.
    """

    def __init__(self) -> None:
        self._state: Optional[str] = None
        self._stopped = False
        self._ending = False
        self._answer: Optional[tuple] = None
        self._last_tick: Optional[float] = None

    def on_state(
        self,
        name: str,
        success: bool,
        outcome: str,
        answer: tuple,
        code: str = "",
        stopped: bool = False,
        ending: bool = False,
    ) -> List[str]:
        """Returns the sounds that a state message calls for.

        Args:
            name: the state's name.
            success: whether the last command was accepted.
            outcome: of the interaction before: "saved" or "cancelled".
            answer: anything that changes when a command was answered and not when the message is
                only repeated.
            code: of the last answer.
            stopped: whether robots are stopped.
            ending: whether the interaction ends by itself soon.

        Returns:
            Names of sounds, in playing order. The first message makes none: it tells
            the state of the interaction, not that something happened.
        """
        sounds: List[str] = []
        if self._state is not None:
            if stopped and not self._stopped:
                sounds.append(STOPPED)
            elif name != self._state:
                sounds.append(SUCCESS if name == DEFAULT.name and outcome == "saved" else name)
            elif answer != self._answer and not success:
                sounds.append(QUESTION if code in _QUESTIONS else ERROR)
            if ending and not self._ending:
                sounds.append(QUESTION)
        self._state, self._answer, self._stopped, self._ending = name, answer, stopped, ending
        return sounds

    def on_spot(self, now: float) -> List[str]:
        """Returns a tick for a spot at a time [s], if spots are wanted and the last tick is long enough ago."""
        if self._state not in STATES or not STATES[self._state].collects:
            return []
        if self._last_tick is not None and 0.0 <= now - self._last_tick < TICK_PERIOD:
            return []
        self._last_tick = now
        return [TICK]
