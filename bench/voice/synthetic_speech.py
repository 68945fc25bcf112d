"""Synthetic speech in room noise, for judging the voice recogniser.

Three groups of voices, sentences, noises and styles of music that share none: "development" chooses what has to be
chosen, "ordinary" (American and British) and "evaluation" (speakers of other languages) judge once, when all is frozen.
Near misses are words that sound like commands, from a dictionary by phonetic distance and by hand.

Formant voices are from espeak-ng (accents and variants), recorded people's from flite (diphones and clusters) and
festival (diphones, hidden Markov model), all Debian packages: apt-get install espeak-ng flite festival festvox-kdlpc16k
festvox-kallpc16k festvox-us-slt-hts. A voice "recorded" is a folder out/bench/recordings/NAME with WAV files
TEXT-NUMBER.wav: recordings.py fills some with neural voices; people may fill others.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
import wave
import zlib
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np
from scipy.signal import fftconvolve, resample_poly

TOP = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(TOP / "src" / package / "src") for package in ("vb_voice_wizard", "vb_core")]

from vb_voice_wizard.recognizer import PHRASES  # noqa: E402

RATE = 16000
RECORDINGS = TOP / "out" / "bench" / "recordings"
MEANING = {text: command for command, texts in PHRASES.items() for text in texts}

Voice = Tuple[str, str]  # program, its name for the voice


def _espeak(accent: str, *variants: str) -> List[Voice]:
    return [("espeak-ng", accent + (f"+{variant}" if variant else "")) for variant in variants]


# Kokoro's voices, by the letters of their names: American, British, and speakers of other languages who
# speak English here. Left out, as nobody would give commands with them: those that whisper (af_nicole) and
# Father Christmas (.._santa).
KOKORO = {
    "development": (
        "af_aoede",
        "af_kore",
        "af_sky",
        "am_echo",
        "am_fenrir",
        "bf_isabella",
        "bm_lewis",
        "jf_alpha",
        "jf_gongitsune",
        "jf_nezumi",
        "jf_tebukuro",
        "jm_kumo",
        "af_alloy",
        "af_jessica",
        "af_river",
        "af_sarah",
        "am_eric",
        "am_liam",
        "am_onyx",
        "bf_alice",
        "bm_fable",
        "ef_dora",
        "em_alex",
        "ff_siwis",
        "hf_alpha",
        "hm_omega",
        "if_sara",
        "im_nicola",
        "pm_alex",
        "zf_xiaobei",
        "zm_yunjian",
    ),
    "ordinary": (
        "af_heart",
        "af_bella",
        "af_nova",
        "am_michael",
        "am_adam",
        "am_puck",
        "bf_emma",
        "bf_lily",
        "bm_george",
        "bm_daniel",
    ),
    "evaluation": (
        "hf_beta",
        "hm_psi",
        "pf_dora",
        "zf_xiaoni",
        "zf_xiaoxiao",
        "zf_xiaoyi",
        "zm_yunxi",
        "zm_yunxia",
        "zm_yunyang",
    ),
}
NEURAL = {  # what bench/voice/recordings.py records for each group
    "development": (*KOKORO["development"], "hibari", "joe"),
    "ordinary": KOKORO["ordinary"],
    "evaluation": KOKORO["evaluation"],
}
FORMANT = [  # and of diphones: other kinds of synthesiser, for development alone
    *_espeak("en-gb-scotland", "f3"),
    *_espeak("en-us-nyc", "edward"),
    *_espeak("en-gb-x-gbclan", "david"),
    *_espeak("en-us", "benjamin"),
    ("flite", "awb"),
    ("flite", "kal16"),
    ("flite", "rms"),
    ("flite", "slt"),
    ("festival", "ked_diphone"),
    ("festival", "kal_diphone"),
    ("festival", "cmu_us_slt_arctic_hts"),
]
VOICES = {
    group: [("recorded", name) for name in names] + (FORMANT if group == "development" else [])
    for group, names in NEURAL.items()
}
# no group hears the noises or music of another, but for "babble"
NOISES = {
    "development": ("white", "pink", "brown", "hoth", "fan", "office", "vacuum", "shower", "street"),
    "ordinary": ("fridge", "hairdryer", "sea"),
    "evaluation": ("rain", "train", "kettle"),
}
MUSIC = {
    "development": "piano strings organ band guitar brass marimba choir".split(),
    "ordinary": "flute banjo".split(),
    "evaluation": "harp accordion".split(),
}


def sentences(name: str) -> List[str]:
    """The lines of bench/voice/sentences/<name>.txt."""
    return (Path(__file__).parent / "sentences" / f"{name}.txt").read_text().split("\n")[:-1]


# ------------------------------------------------------------------ speech
def synthesise(voice: Voice, text: str, speed: float = 1.0, pitch: int = 50) -> np.ndarray:
    """Speaks a text: (N,) float64 at 16 kHz, silence trimmed, largest sample 1."""
    program, name = voice
    if program == "espeak-ng":
        command = ["espeak-ng", "-v", name, "-s", str(int(160 * speed)), "-p", str(pitch), "--stdout", text]
        data = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    elif program == "recorded":
        takes = sorted((RECORDINGS / name).glob(f"{text.replace(' ', '_')}-*.wav"))
        if not takes:
            raise FileNotFoundError(text)
        data = takes[pitch % len(takes)].read_bytes()
    else:
        with tempfile.NamedTemporaryFile(suffix=".wav") as file:
            if program == "flite":
                command = [
                    "flite",
                    "-voice",
                    name,
                    "--setf",
                    f"duration_stretch={1 / speed:.3f}",
                    "-t",
                    text,
                    "-o",
                    file.name,
                ]
            else:
                command = ["text2wave", "-eval", f"(voice_{name})", "-o", file.name]
            subprocess.run(
                command, input=text.encode(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True
            )
            data = Path(file.name).read_bytes()
    with wave.open(io.BytesIO(data)) as file:
        rate = file.getframerate()
    # espeak-ng writes to a pipe and cannot tell the length in the header
    samples = np.frombuffer(data[44 : len(data) // 2 * 2], "<i2").astype(float)
    common = int(np.gcd(rate, RATE))
    samples = resample_poly(samples, RATE // common, rate // common)
    loud = np.flatnonzero(np.abs(samples) > 0.02 * np.abs(samples).max())
    samples = samples[loud[0] : loud[-1] + 1]
    return samples / np.abs(samples).max()


# ------------------------------------------------------------------ rooms
def _colored(rng: np.random.Generator, count: int, exponent: float) -> np.ndarray:
    frequency = np.fft.rfftfreq(count, 1 / RATE)
    noise = np.fft.irfft(np.fft.rfft(rng.normal(size=count)) * np.maximum(frequency, 40.0) ** (-exponent / 2), count)
    return noise / noise.std()


def room_noise(rng: np.random.Generator, count: int, kind: str, talkers: Sequence[np.ndarray] = ()) -> np.ndarray:
    """(count,) samples of noise; "hoth" is about the spectrum of rooms, "babble" needs talkers."""
    if kind == "babble":
        noise = np.zeros(count)
        for _ in range(8):
            talker = talkers[rng.integers(len(talkers))]
            noise += np.resize(np.roll(talker, -int(rng.integers(len(talker)))), count) / talker.std()
        return noise
    if any(kind in styles for styles in MUSIC.values()):
        return music(rng, count, kind)
    colors = {
        "white": 0.0,
        "pink": 1.0,
        "brown": 2.0,
        "hoth": 1.6,
        "fan": 1.3,
        "office": 1.2,
        "vacuum": 0.7,
        "shower": 0.3,
        "street": 1.8,
        "rain": 0.5,
        "train": 1.5,
        "kettle": 1.0,
        "fridge": 2.2,
        "hairdryer": 0.4,
        "sea": 0.9,
    }
    noise = _colored(rng, count, colors[kind])
    if kind == "street":
        # cars pass
        noise *= 1.0 + 0.6 * np.sin(2 * np.pi * rng.uniform(0.2, 0.5) * np.arange(count) / RATE + rng.uniform(0, 6))
    if kind == "train":
        # wheels over the joints of the rails, two by two
        time = np.arange(count) / RATE * rng.uniform(1.2, 2.0) % 1.0
        noise *= 1.0 + 2.0 * (np.exp(-time * 30) + np.exp(-np.abs(time - 0.2) * 30))
    if kind == "kettle":
        # boils louder and louder
        noise *= np.linspace(0.5, 1.5, count)
    if kind == "sea":
        # waves come in
        noise *= 1.0 + 0.8 * np.sin(2 * np.pi * rng.uniform(0.1, 0.3) * np.arange(count) / RATE + rng.uniform(0, 6))
    if kind in ("fan", "vacuum", "fridge", "hairdryer"):
        lowest = {"fan": 80, "vacuum": 240, "fridge": 50, "hairdryer": 320}[kind]
        time, base = np.arange(count) / RATE, lowest * rng.uniform(1.0, 1.75)
        hum = sum(
            rng.uniform(0.2, 1) / k * np.sin(2 * np.pi * base * k * time + rng.uniform(0, 6)) for k in range(1, 8)
        )
        noise += 0.6 * hum / hum.std()
    if kind == "office":
        for _ in range(rng.poisson(1.5 * count / RATE)):
            at = int(rng.integers(count))
            length = min(int(0.06 * RATE), count - at)
            click = rng.uniform(1, 3) * rng.normal(size=length) * np.exp(-np.arange(length) / 200)
            noise[at : at + length] += click
    return noise


def music(rng: np.random.Generator, count: int, style: str) -> np.ndarray:
    """(count,) samples of music made up on the spot: chords and a melody over them; "band" has bass and drums too."""
    overtones, decay_s, attack_s, drums = {
        "piano": ((1.0, 0.5, 0.3, 0.15, 0.08), 0.5, 0.005, False),
        "strings": ((1.0, 0.7, 0.5, 0.4, 0.3, 0.2), 5.0, 0.12, False),
        "organ": ((1.0, 0.8, 0.1, 0.6, 0.1, 0.1, 0.1, 0.4), 9.0, 0.02, False),
        "guitar": ((1.0, 0.8, 0.6, 0.25, 0.3, 0.1), 0.25, 0.002, False),
        "brass": ((0.7, 1.0, 0.9, 0.7, 0.5, 0.4, 0.3), 4.0, 0.06, True),
        "marimba": ((1.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.15), 0.15, 0.002, False),
        "harp": ((1.0, 0.4, 0.2, 0.1), 0.7, 0.003, False),
        "flute": ((1.0, 0.3, 0.05), 7.0, 0.08, False),
        "banjo": ((0.8, 1.0, 0.7, 0.6, 0.4, 0.3, 0.2), 0.12, 0.001, True),
        "accordion": ((1.0, 0.9, 0.5, 0.6, 0.3, 0.3, 0.2, 0.15), 8.0, 0.05, True),
        "choir": ((1.0, 0.6, 0.8, 0.3, 0.2, 0.1), 6.0, 0.2, False),
        "band": ((1.0, 0.6, 0.45, 0.3, 0.25, 0.2, 0.1), 0.35, 0.003, True),
    }[style]
    sound = np.zeros(count)

    def play(at: int, semitone: float, seconds: float, loudness: float) -> None:
        length = min(int(seconds * RATE), count - at)
        time = np.arange(length) / RATE
        envelope = (
            np.minimum(time / attack_s, 1.0)
            * np.exp(-time / decay_s)
            * np.minimum((length - np.arange(length)) / 200.0, 1.0)
        )
        phase = (
            2 * np.pi * 261.63 * 2 ** (semitone / 12) * (time + 0.0008 * np.sin(2 * np.pi * 5.5 * time) * (decay_s > 1))
        )
        sound[at : at + length] += (
            loudness
            * envelope
            * sum(
                share * np.sin((k + 1) * phase)
                for k, share in enumerate(overtones)
                if 261.63 * 2 ** (semitone / 12) * (k + 1) < RATE / 2
            )
        )

    beat = int(60.0 / rng.uniform(80, 140) * RATE)
    key, start = rng.integers(-6, 6), -int(rng.integers(4 * beat))
    scale = np.array([0, 2, 4, 5, 7, 9, 11])
    for number, at in enumerate(range(start, count, beat)):
        if number % 4 == 0:
            root = int(rng.choice([0, 3, 4, 5]))
        if at < 0:
            continue
        chord = [key + scale[(root + step) % 7] + 12 * ((root + step) // 7) for step in (0, 2, 4)]
        if number % 4 == 0 or drums:
            for semitone in chord:
                play(at, semitone, 4 * beat / RATE if not drums else beat / RATE, 0.5)
        for half in range(int(rng.integers(1, 3))):
            if at + half * beat // 2 < count:
                play(at + half * beat // 2, key + 12 + int(rng.choice(scale)), beat / RATE, 0.8)
        if drums:
            play(at, chord[0] - 24, beat / RATE, 1.2)
            length = min(int(0.12 * RATE), count - at)
            sound[at : at + length] += (
                (1.5 if number % 2 else 0.7) * rng.normal(size=length) * np.exp(-np.arange(length) / 500)
            )
    return sound / max(sound.std(), 1e-9)


def in_a_room(
    rng: np.random.Generator, speech: np.ndarray, noise_of: Callable[[int], np.ndarray], snr_db: float = 10.0
) -> np.ndarray:
    """Speech with noise, in every other case with reverberation of 0.15 to 0.4 s, between two pauses: (N,) int16.

    The ratio counts the speech alone, its pauses before and after left out.

    Args:
        noise_of: returns so many samples of noise.
    """
    if rng.random() < 0.5:
        length = int(rng.uniform(0.15, 0.4) * RATE)
        tail = rng.normal(size=length) * 10 ** (-3 * np.arange(length) / length)
        tail *= rng.uniform(0.1, 0.35) / np.sqrt((tail**2).sum())
        tail[0] = 1.0
        speech = fftconvolve(speech, tail)
    # a microphone's sound goes on: where it ends soon after the speech, speech in music seems to have no end
    padded = np.pad(speech, (int(rng.uniform(0.3, 1.0) * RATE), int(rng.uniform(1.2, 1.6) * RATE)))
    noise = noise_of(len(padded))
    mixed = padded + noise * np.sqrt(np.mean(speech**2) / 10 ** (snr_db / 10) / np.mean(noise**2))
    return (mixed / np.abs(mixed).max() * rng.uniform(2000, 25000)).astype(np.int16)


# ------------------------------------------------------------------ utterances
@dataclass(frozen=True)
class Plan:
    """What is to be said, by whom, in which noise; everything else follows from it.

    Attributes:
        kind: "command", "other" or "near_miss".
    """

    kind: str
    text: str
    voice: Voice
    noise: str
    take: int
    snr_db: float = 10.0

    @property
    def command(self) -> str:
        """The command that is meant, or ""."""
        return MEANING.get(self.text, "")

    def speak(self, talkers: Sequence[np.ndarray] = ()) -> Optional[np.ndarray]:
        """(N,) int16; the same plan gives the same sound. None if the voice is not installed or has no such recording."""
        rng = np.random.default_rng(zlib.crc32(repr(self).encode()))
        try:
            speech = synthesise(
                self.voice, self.text, rng.uniform(0.8, 1.25), self.take + int(rng.integers(15, 36)) * 2
            )
        except (OSError, subprocess.CalledProcessError, wave.Error, EOFError):
            return None
        return in_a_room(rng, speech, lambda count: room_noise(rng, count, self.noise, talkers), self.snr_db)


def plans(group: str, voices: Sequence[Voice], takes: int, noises: Sequence[str], snr_db: float = 10.0) -> List[Plan]:
    """Every command by every voice `takes` times; every other sentence and near miss once."""
    rng = np.random.default_rng(zlib.crc32(f"{group} {noises}".encode()))

    def noise() -> str:
        return str(rng.choice(noises))

    recorded = {path.parts[-2:] for path in RECORDINGS.glob("*/*-0.wav")}

    def can_say(voice: Voice, text: str) -> bool:
        return voice[0] != "recorded" or (voice[1], f"{text.replace(' ', '_')}-0.wav") in recorded

    result = [
        Plan("command", text, voice, noise(), take, snr_db)
        for text in MEANING
        for voice in voices
        if can_say(voice, text)
        for take in range(takes)
    ]
    for kind, name in (("other", "others"), ("near_miss", "near_misses")):
        for text in sentences(f"{group}_{name}"):
            # as a person would, if one of these has been recorded
            able = [voice for voice in voices if can_say(voice, text)]
            able = [voice for voice in able if voice[0] == "recorded"] or able
            if able:
                result.append(Plan(kind, text, able[rng.integers(len(able))], noise(), 0, snr_db))
    return result


def everything(
    group: str, takes: int = 1, share: float = 1.0, snr_db: float = 10.0
) -> Tuple[List[Plan], List[np.ndarray]]:
    """What a group is judged by: in steady noise, over music, while people talk; and the talkers.

    Args:
        share: of the plans, at random, the same each time.

    Returns:
        The plans in a random order, but commands, near misses and others in turn: what is stopped early has
        as many of each; talkers' sound.
    """
    voices = VOICES[group]
    # the neural voices have not recorded such long sentences
    people = [voice for voice in voices if voice[0] != "recorded"] or [
        ("flite", "awb"),
        ("flite", "slt"),
        ("festival", "ked_diphone"),
    ]
    texts, rng = sentences(f"{group}_others"), np.random.default_rng(0)
    talkers = [
        synthesise(people[index % len(people)], f"{texts[index]}, {texts[-index - 1]}")
        for index in range(0, min(40, len(texts)), 2)
    ]
    planned = [
        plan
        for noises in (NOISES[group], MUSIC[group], ("babble",))
        for plan in plans(group, voices, takes, noises, snr_db)
    ]
    drawn = [planned[index] for index in rng.permutation(len(planned)) if rng.random() < share]
    kinds = [[plan for plan in drawn if plan.kind == kind] for kind in ("command", "near_miss", "other")]
    return [plan for together in zip_longest(*kinds) for plan in together if plan is not None], talkers
