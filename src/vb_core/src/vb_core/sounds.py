"""The table of the system's sounds, by the names that vb_msgs/Sound carries.

Rising tones mean that the interaction continues; each active state ends on its own tone, at least a third from any
other (vb_core.interaction_tables). Falling tones mean a return to Default, or a pause. A refusal is low and repeated. A
success is the longest rise, so that people recognise both without knowing the other sounds. A question repeats one
tone; a stop falls from high to low. A short tone acknowledges a spoken command at once, before the command's own sound.
Ticks are frequent, so they are soft, and far above all other sounds.

>>> round(SOUNDS["success"].seconds, 2), SOUNDS["border"].beep
(0.57, 'BUTTON')
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Tuple

from vb_core.interaction_tables import DEFAULT, STATES, State

# [Hz] pitches of the notes of five octaves in equal temperament; A4 is 440 Hz
_SEMITONES = {"C": -9, "D": -7, "E": -5, "F": -4, "G": -2, "A": 0, "B": 2}
PITCHES = {
    f"{name}{octave}": 440.0 * 2.0 ** (octave - 4 + semitone / 12.0)
    for octave in range(3, 8)
    for name, semitone in _SEMITONES.items()
}


@dataclass(frozen=True)
class Note:
    """A tone, or silence."""

    pitch: str  # one of PITCHES; "": silence
    seconds: float  # [s] duration
    loudness: float = 1.0  # relative to the loudest note, 0 .. 1.


@dataclass(frozen=True)
class Melody:
    """A sound: its notes, and the constant of kobuki_msgs/Sound that a Kobuki plays instead ("" for none)."""

    notes: Tuple[Note, ...]
    beep: str = ""

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return sum(note.seconds for note in self.notes)


def _melody_of_state(state: State) -> Melody:
    first, second = state.tone
    beep = "OFF" if state == DEFAULT else "BUTTON"
    return Melody((Note(first, 0.09), Note(second, 0.16)), beep)


_REST = Note("", 0.05)
TICK, SUCCESS, ERROR, QUESTION, STOPPED, RECOGNIZED = "tick", "success", "error", "question", "stopped", "recognized"
SOUNDS: Dict[str, Melody] = {
    **{name: _melody_of_state(state) for name, state in STATES.items()},
    SUCCESS: Melody((Note("C5", 0.09), Note("E5", 0.09), Note("G5", 0.09), Note("C6", 0.30)), "CLEANINGEND"),
    QUESTION: Melody((Note("E5", 0.10), _REST, Note("E5", 0.16)), "RECHARGE"),
    STOPPED: Melody((Note("C6", 0.10), Note("A3", 0.40)), "OFF"),
    ERROR: Melody((Note("A3", 0.16), _REST, Note("A3", 0.24)), "ERROR"),
    RECOGNIZED: Melody((Note("G6", 0.08),)),
    TICK: Melody((Note("C7", 0.02, 0.15),)),  # no beep: a Kobuki's are too loud for so frequent a sound
}
