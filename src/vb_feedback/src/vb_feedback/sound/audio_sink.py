"""Plays samples with ALSA's aplay, the counterpart of arecord, which voice recognition uses."""

from __future__ import annotations

import subprocess

import numpy as np

from vb_core.errors import CodedError
from vb_feedback.sound.tone_synthesis import RATE

# [s] beyond a sound's length, after which the device counts as stuck
_TIMEOUT = 3.0


def play(pcm: np.ndarray, device: str, program: str = "aplay") -> None:
    """Plays samples (N,) int16 at `tone_synthesis.RATE`, and waits until they have been played.

    Args:
        device: the device's ALSA name, as listed by `aplay -L`.
        program: aplay, or a program with the same arguments.

    Raises:
        CodedError: "no_audio" with the program's own reason.
    """
    try:
        result = subprocess.run(
            [program, "-q", "-D", device, "-t", "raw", "-f", "S16_LE", "-r", str(RATE), "-c", "1"],
            input=pcm.astype("<i2").tobytes(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=len(pcm) / RATE + _TIMEOUT,
        )
    except OSError as error:
        raise CodedError("no_audio", f"'{program}' cannot be run: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        raise CodedError("no_audio", "the sound device takes no samples") from None
    if result.returncode != 0:
        lines = result.stderr.decode(errors="replace").strip().splitlines()
        raise CodedError("no_audio", lines[-1] if lines else f"'{program}' failed")
