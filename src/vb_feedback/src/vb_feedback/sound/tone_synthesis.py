"""Synthesises the sounds: notes to samples. No files, no ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Tuple

import numpy as np

RATE = 48000  # [1/s] samples; native to sound cards

# share of full scale of the loudest note: leaves room for other programs' sounds
_PEAK = 0.6
# [s] over which a note swells and fades: shorter clicks
_FADE = 0.005


@dataclass(frozen=True)
class Note:
    """A tone with two soft overtones, or silence at frequency 0.

    Attributes:
        frequency: [Hz]
        seconds: [s]
        loudness: share of the loudest note.
    """

    frequency: float
    seconds: float
    loudness: float = 1.0


C5, E5, G5, C6, LOW = 523.25, 659.26, 783.99, 1046.50, 220.0
_REST = Note(0.0, 0.05)

# Going up: the interaction goes on; each active state ends on its own tone, a third or more from the next.
# Going down: back to Default. A refusal is low and repeated, a success the longest run up: both are told without
# knowing the others. A question is one tone twice; a stop falls from high to low. A spoken command that was
# understood is answered at once, short, before its own tone. A tick is far above all of them and soft: it comes often.
SOUNDS: Dict[str, Tuple[Note, ...]] = {
    "border": (Note(C5, 0.09), Note(E5, 0.16)),
    "seed": (Note(C5, 0.09), Note(G5, 0.16)),
    "guide": (Note(C5, 0.09), Note(C6, 0.16)),
    "default": (Note(E5, 0.09), Note(C5, 0.20)),
    "success": (Note(C5, 0.09), Note(E5, 0.09), Note(G5, 0.09), Note(C6, 0.30)),
    "question": (Note(E5, 0.10), _REST, Note(E5, 0.16)),
    "stopped": (Note(C6, 0.10), Note(LOW, 0.40)),
    "error": (Note(LOW, 0.16), _REST, Note(LOW, 0.24)),
    "recognized": (Note(1567.98, 0.08),),
    "tick": (Note(2093.0, 0.02, 0.15),),
}
TICK = "tick"

# overtones, as shares of the fundamental: small speakers do not reproduce the low ones' fundamental
_OVERTONES = (1.0, 0.3, 0.12)


def synthesize(name: str, volume: float = 1.0) -> np.ndarray:
    """Synthesises a sound as (N,) int16 at `RATE`, mono; empty for a name that is not known.

    Args:
        volume: 0 .. 1.
    """
    notes = SOUNDS.get(name, ())
    if not notes:
        return np.zeros(0, np.int16)
    wave = np.concatenate([_tone(note) for note in notes])
    return np.rint(wave * (_PEAK * min(1.0, max(0.0, volume)) * 32767.0)).astype(np.int16)


def _tone(note: Note) -> np.ndarray:
    """Synthesises a tone, (N,) float64, -1 .. 1."""
    time = np.arange(int(round(note.seconds * RATE))) / RATE
    if note.frequency <= 0:
        return np.zeros(len(time))
    wave = sum(
        share * np.sin(2.0 * np.pi * (order + 1) * note.frequency * time) for order, share in enumerate(_OVERTONES)
    )
    # swells at once, then fades like a struck bar
    envelope = np.minimum(1.0, time / _FADE) * np.minimum(1.0, (note.seconds - time) / _FADE)
    envelope = envelope * np.exp(-2.0 * time / note.seconds)
    return note.loudness * envelope * wave / sum(_OVERTONES)
