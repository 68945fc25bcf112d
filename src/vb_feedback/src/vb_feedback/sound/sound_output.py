"""Synthesises the sounds, from notes to samples, and plays them. No files, no ROS."""

from __future__ import annotations

import subprocess

import numpy as np

from vb_core.errors import CodedError
from vb_core.sounds import PITCHES, SOUNDS, Note

_TIMEOUT = 3.0  # [s] a device that needs so much longer than the sound lasts is stuck
SAMPLE_RATE = 48000  # [1/s] sampling rate that sound cards use natively
_PEAK = 0.6  # amplitude of the loudest note, as a share of full scale; the rest is for sounds of other programs
_FADE = 0.005  # [s] fade-in and fade-out of a note, which would click if they were shorter
# amplitudes of the fundamental and of two overtones, which small speakers reproduce better than a low fundamental
_PARTIALS = (1.0, 0.3, 0.12)


def synthesize(name: str, volume: float = 1.0) -> np.ndarray:
    """Synthesises one of vb_core.sounds at a volume of 0 .. 1. Returns (N,) int16 at `SAMPLE_RATE`, mono."""
    wave = np.concatenate([_synthesize_note(note) for note in SOUNDS[name].notes])
    return np.rint(wave * (_PEAK * volume * 32767.0)).astype(np.int16)


def _synthesize_note(note: Note) -> np.ndarray:
    """Synthesises a tone, (N,) float64, -1 .. 1."""
    time = np.arange(int(round(note.seconds * SAMPLE_RATE))) / SAMPLE_RATE
    if not note.pitch:
        return np.zeros(len(time))
    phase = PITCHES[note.pitch] * time
    partials = [share * np.sin(2.0 * np.pi * order * phase) for order, share in enumerate(_PARTIALS, start=1)]
    # a sharp attack, then a decay like a struck bar's
    attack = np.minimum(1.0, time / _FADE)
    release = np.minimum(1.0, (note.seconds - time) / _FADE)
    decay = np.exp(-2.0 * time / note.seconds)
    envelope = attack * release * decay
    return note.loudness * envelope * sum(partials) / sum(_PARTIALS)


def play(pcm: np.ndarray, device: str, program: str = "aplay") -> None:
    """Plays samples (N,) int16 at `SAMPLE_RATE` with ALSA's aplay, and waits until they have been played.

    Args:
        device: the device's ALSA name, as listed by `aplay -L`.
        program: aplay, or a program with the same arguments.

    Raises:
        CodedError: "no_audio" with the program's own reason.
    """
    try:
        result = subprocess.run(
            [program, "-q", "-D", device, "-t", "raw", "-f", "S16_LE", "-r", str(SAMPLE_RATE), "-c", "1"],
            input=pcm.astype("<i2").tobytes(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=len(pcm) / SAMPLE_RATE + _TIMEOUT,
        )
    except OSError as error:
        raise CodedError("no_audio", f"'{program}' cannot be run: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        raise CodedError("no_audio", "the sound device takes no samples") from None
    if result.returncode != 0:
        lines = result.stderr.decode(errors="replace").strip().splitlines()
        raise CodedError("no_audio", lines[-1] if lines else f"'{program}' failed")
