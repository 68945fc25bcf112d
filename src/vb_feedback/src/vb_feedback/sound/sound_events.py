"""Decides when to play which sound."""

from __future__ import annotations

from typing import List, Optional

from vb_core.sounds import ERROR, QUESTION, STOPPED, SUCCESS, TICK
from vb_core.vocabulary import DEFAULT, QUESTIONS, state_of
from vb_msgs.msg import InteractionState

TICK_PERIOD = 0.5  # [s] at 25 spots a second, a tick for each would be a buzz


class SoundEvents:
    """Turns states and spots into the names of sounds.

    There is one sound per new state, one for a successful save, one for an error, one for a question or a drawing about
    to be dropped, one for a stop, and a soft tick per accepted spot, at most one every TICK_PERIOD. Time may jump back.
    """

    def __init__(self) -> None:
        self._state: Optional[InteractionState] = None
        self._last_tick: Optional[float] = None

    def on_state(self, state: InteractionState) -> List[str]:
        """Returns the names of the sounds that a state message calls for, in playing order.

        The first message causes none: it reports the current state, not an event. Nor does a repeated message.
        """
        before, self._state = self._state, state
        if before is None:
            return []
        sounds: List[str] = []
        answers = [(one.last_answered, one.last_command, one.last_code) for one in (before, state)]
        if state.stopped and not before.stopped:
            sounds.append(STOPPED)
        elif state.name != before.name:
            saved = state.name == DEFAULT.name and state.last_outcome == "saved"
            sounds.append(SUCCESS if saved else state.name)
        elif answers[0] != answers[1] and not state.last_success:
            sounds.append(QUESTION if state.last_code in QUESTIONS else ERROR)
        if before.ends_at.is_zero() and not state.ends_at.is_zero():
            sounds.append(QUESTION)
        return sounds

    def on_spot(self, now: float) -> List[str]:
        """Returns a tick for a spot at a time [s], if the state collects spots and the last tick is long enough ago."""
        if self._state is None or not state_of(self._state.name).collects:
            return []
        if self._last_tick is not None and 0.0 <= now - self._last_tick < TICK_PERIOD:
            return []
        self._last_tick = now
        return [TICK]
