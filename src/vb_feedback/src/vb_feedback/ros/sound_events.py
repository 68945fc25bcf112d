"""Decides which sound to play."""

from __future__ import annotations

from typing import List, Optional

from vb_core.interaction_tables import DEFAULT, QUESTIONS, state_by_name
from vb_core.sounds import ERROR, QUESTION, STOPPED, SUCCESS, TICK
from vb_msgs.msg import InteractionState

TICK_PERIOD = 0.5  # [s] shortest time between two ticks; one for each spot, 25 times a second, would sound like a buzz


class SoundEvents:
    """Converts states and spots to the names of sounds.

    There is a sound for each new state, a successful save, an error, a question, a stop, and when a drawing is about to
    be discarded. An accepted spot causes a soft tick, at most one every TICK_PERIOD. Time may jump back.
    """

    def __init__(self) -> None:
        self._state: Optional[InteractionState] = None
        self._last_tick: Optional[float] = None

    def on_state(self, state: InteractionState) -> List[str]:
        """Returns the names of a state message's sounds, in playing order.

        The first message, which reports the current state, and repeated messages cause no sound.
        """
        previous = self._state
        self._state = state
        if previous is None:
            return []
        sounds: List[str] = []
        answers = [(message.last_answered, message.last_command, message.last_code) for message in (previous, state)]
        is_new_answer = answers[0] != answers[1]
        if state.stopped and not previous.stopped:
            sounds.append(STOPPED)
        elif state.name != previous.name:
            is_saved = state.name == DEFAULT.name and state.last_outcome == "saved"
            sounds.append(SUCCESS if is_saved else state.name)
        elif is_new_answer and not state.last_success:
            sounds.append(QUESTION if state.last_code in QUESTIONS else ERROR)
        if previous.ends_at.is_zero() and not state.ends_at.is_zero():
            sounds.append(QUESTION)
        return sounds

    def on_spot(self, now: float) -> List[str]:
        """Returns a tick for a spot at time `now` [s] if the state collects spots and the last tick is old enough."""
        if self._state is None or not state_by_name(self._state.name).collects:
            return []
        if self._last_tick is not None and 0.0 <= now - self._last_tick < TICK_PERIOD:
            return []
        self._last_tick = now
        return [TICK]
