"""Synthetic speech in room noise, for training and for judging the voice recogniser.

Four groups of voices, sentences and styles of music that share none: "training" teaches the phone network, "calibration" the
decision; "development" is looked at while the recogniser is worked on, "evaluation" once, when it is frozen. Near misses come
from the dictionary (vb_voice_wizard.rivals), a third for each group that hears any, beside sentences written by hand.

Voices are from espeak-ng (accents and variants), flite and festival, all Debian packages:
apt-get install espeak-ng flite festival festvox-kdlpc16k festvox-kallpc16k festvox-us-slt-hts. A voice "recorded" is a folder
out/bench/recordings/NAME with a WAV file per text (make_recordings.py fills one with Piper's voice joe; people may too).
"""
from __future__ import annotations

import functools
import io
import itertools
import subprocess
import sys
import tempfile
import wave
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import List, Optional, Sequence, Tuple

import numpy as np
from scipy.signal import fftconvolve, resample_poly

TOP = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(TOP / "src" / package / "src") for package in ("vb_voice_wizard", "vb_core")]
RATE = 16000
GROUPS = ("calibration", "development", "evaluation")
RIVALS_SAID = 45  # near misses per command that are shared out among the groups
RECORDINGS = TOP / "out" / "bench" / "recordings"

from vb_voice_wizard import command_grammar  # noqa: E402
from vb_voice_wizard.acoustic_model import embedded_model  # noqa: E402
from vb_voice_wizard.rivals import PHONES, Lexicon  # noqa: E402

COMMANDS = {
    "define_border": "define border",
    "define_seed": "define seed",
    "guide_robot": "guide robot",
    "save": "save",
    "cancel": "cancel",
    "stop": "stop",
    "resume": "resume",
    "undo": "undo",
    "redo": "redo",
}

# what the interaction manager asks about when it is unclear
ASKED_ABOUT = ("save", "cancel", "resume", "undo", "redo")

Voice = Tuple[str, str]  # program, its name for the voice


def _espeak(accent: str, *variants: str) -> List[Voice]:
    return [("espeak-ng", accent + (f"+{variant}" if variant else "")) for variant in variants]


CALIBRATION_VOICES = [
    *_espeak("en-us", "", "f2", "m3", "f4", "m6", "Annie", "john", "linda", "Mike", "boris", "klatt2"),
    *_espeak("en-gb", "f1", "m1", "f5", "Andy", "adam", "steph"),
    *_espeak("en-gb-x-rp", "", "m2", "f3"),
    *_espeak("en-029", "m5", "f1"),
    ("flite", "rms"),
]
DEVELOPMENT_VOICES = [
    *_espeak("en-gb-scotland", "", "f3", "m7"),
    *_espeak("en-us-nyc", "", "f5", "belinda"),
    *_espeak("en-gb-x-gbclan", "m4"),
    *_espeak("en-gb-x-gbcwmd", ""),
    *_espeak("en-us", "benjamin", "pablo", "max", "zac", "Lee"),
    *_espeak("en-gb", "iven", "quincy"),
    ("flite", "awb"),
    ("festival", "ked_diphone"),
]
EVALUATION_VOICES = [
    *_espeak("en-us-nyc", "edward", "klatt3"),
    *_espeak("en-gb-scotland", "paul", "shelby"),
    *_espeak("en-gb-x-gbclan", "david", "Alicia"),
    *_espeak("en-gb-x-gbcwmd", "m8", "steph2", "Gene"),
    *_espeak("en-us", "paul"),
    *_espeak("en-gb", "shelby", "klatt3"),
    ("flite", "slt"),
    ("festival", "cmu_us_slt_arctic_hts"),
    ("recorded", "joe"),
    ("recorded", "joe_slow"),
    ("recorded", "joe_fast"),
    ("recorded", "joe_high"),
    ("recorded", "joe_low"),
]
TRAINING_ACCENTS = ("en-us", "en-gb", "en-gb-x-rp", "en-029")
# whispers, monsters and an announcer's echo: nobody would give commands with them
ODD_VARIANTS = {"whisper", "whisperf", "Demonic", "croak", "Mr serious", "fast", "UniRobot", "anikaRobot"}
NOISES = ("white", "pink", "brown", "hoth", "fan", "office")
# styles of music; no group hears those of another
TRAINING_MUSIC = ("piano", "strings")
DEVELOPMENT_MUSIC = ("organ", "band")
EVALUATION_MUSIC = ("guitar", "brass")


def training_voices() -> List[Voice]:
    """Every espeak-ng variant that no other group uses, in four accents, and one voice of flite."""
    listing = subprocess.run(["espeak-ng", "--voices=variant"], stdout=subprocess.PIPE, check=True).stdout.decode()
    variants = {line.split("!v/")[1].split("  ")[0].strip() for line in listing.splitlines() if "!v/" in line}
    used = {name.split("+")[1] for program, name in CALIBRATION_VOICES + DEVELOPMENT_VOICES + EVALUATION_VOICES if "+" in name}
    free = sorted(variants - used - ODD_VARIANTS)
    return [voice for accent in TRAINING_ACCENTS for voice in _espeak(accent, *free)] + [("flite", "kal16"), ("festival", "kal_diphone")] * 12


def sentences(name: str) -> List[str]:
    """The lines of bench/voice_sentences/<name>.txt."""
    return (Path(__file__).parent / "voice_sentences" / f"{name}.txt").read_text().split("\n")[:-1]


def near_misses(group: str) -> List[str]:
    """What sounds nearly like a command and is none: sentences written by hand, and every other rival of the dictionary."""
    return sentences(f"{group}_near_misses") + _rivals()[GROUPS.index(group) :: len(GROUPS)]


@functools.lru_cache(maxsize=None)
def _rivals() -> List[str]:
    """Texts that sound like commands, all commands in turn, the worst first."""
    folder = embedded_model().parent
    lexicon = Lexicon(folder / "cmudict-en-us.dict", folder / "en-us.lm.bin")
    files = [command_grammar.find("dictionary", "", "commands.dict")]
    words = {word for text in COMMANDS.values() for word in text.split()}
    sounds = command_grammar.read_dictionary(files[0], words, PHONES)
    lists = []
    for text in COMMANDS.values():
        variants = list(itertools.product(*(sounds[word] for word in text.split())))
        found = lexicon.rivals(text.split(), variants[0], {sum(variant, ()) for variant in variants}, RIVALS_SAID)
        lists.append([" ".join(rival.words) for rival in found])
    # by turns, so that every group gets its share of every command
    texts = [text for row in itertools.zip_longest(*lists) for text in row if text is not None and text not in COMMANDS.values()]
    return list(dict.fromkeys(texts))


# ------------------------------------------------------------------ speech
def synthesise(voice: Voice, text: str, speed: float = 1.0, pitch: int = 50) -> np.ndarray:
    """Speaks a text: (N,) float64 at 16 kHz, silence trimmed, largest sample 1."""
    program, name = voice
    if program == "espeak-ng":
        command = ["espeak-ng", "-v", name, "-s", str(int(160 * speed)), "-p", str(pitch), "--stdout", text]
        data = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    elif program == "recorded":
        data = (RECORDINGS / name / f"{text.replace(' ', '_')}.wav").read_bytes()
    else:
        with tempfile.NamedTemporaryFile(suffix=".wav") as file:
            if program == "flite":
                command = ["flite", "-voice", name, "--setf", f"duration_stretch={1 / speed:.3f}", "-t", text, "-o", file.name]
            else:
                command = ["text2wave", "-eval", f"(voice_{name})", "-o", file.name]
            subprocess.run(command, input=text.encode(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=True)
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
def _coloured(rng: np.random.Generator, count: int, exponent: float) -> np.ndarray:
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
    if kind in TRAINING_MUSIC + DEVELOPMENT_MUSIC + EVALUATION_MUSIC:
        return music(rng, count, kind)
    noise = _coloured(rng, count, {"white": 0.0, "pink": 1.0, "brown": 2.0, "hoth": 1.6, "fan": 1.3, "office": 1.2}[kind])
    if kind == "fan":
        time, base = np.arange(count) / RATE, rng.uniform(80, 140)
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
        "band": ((1.0, 0.6, 0.45, 0.3, 0.25, 0.2, 0.1), 0.35, 0.003, True),
    }[style]
    sound = np.zeros(count)

    def play(at: int, semitone: float, seconds: float, loudness: float) -> None:
        length = min(int(seconds * RATE), count - at)
        time = np.arange(length) / RATE
        envelope = np.minimum(time / attack_s, 1.0) * np.exp(-time / decay_s) * np.minimum((length - np.arange(length)) / 200.0, 1.0)
        phase = 2 * np.pi * 261.63 * 2 ** (semitone / 12) * (time + 0.0008 * np.sin(2 * np.pi * 5.5 * time) * (decay_s > 1))
        sound[at : at + length] += loudness * envelope * sum(
            share * np.sin((k + 1) * phase) for k, share in enumerate(overtones) if 261.63 * 2 ** (semitone / 12) * (k + 1) < RATE / 2
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
            sound[at : at + length] += (1.5 if number % 2 else 0.7) * rng.normal(size=length) * np.exp(-np.arange(length) / 500)
    return sound / max(sound.std(), 1e-9)


def in_a_room(
    rng: np.random.Generator, speech: np.ndarray, kind: str, snr_db: float = 10.0, talkers: Sequence[np.ndarray] = ()
) -> Tuple[np.ndarray, int]:
    """Speech with noise, in every other case with reverberation of 0.15 to 0.4 s, between two pauses.

    The ratio counts the speech alone, its pauses before and after left out.

    Returns:
        (N,) int16, and the index of the first sample of speech.
    """
    if rng.random() < 0.5:
        length = int(rng.uniform(0.15, 0.4) * RATE)
        tail = rng.normal(size=length) * 10 ** (-3 * np.arange(length) / length)
        tail *= rng.uniform(0.1, 0.35) / np.sqrt((tail**2).sum())
        tail[0] = 1.0
        speech = fftconvolve(speech, tail)
    before, after = int(rng.uniform(0.3, 1.0) * RATE), int(rng.uniform(0.4, 1.0) * RATE)
    padded = np.concatenate([np.zeros(before), speech, np.zeros(after)])
    noise = room_noise(rng, len(padded), kind, talkers)
    noise *= np.sqrt(np.mean(speech**2) / 10 ** (snr_db / 10) / np.mean(noise**2))
    mixed = padded + noise
    return (mixed / np.abs(mixed).max() * rng.uniform(2000, 25000)).astype(np.int16), before


# ------------------------------------------------------------------ utterances
@dataclass(frozen=True)
class Spoken:
    """One utterance to be recognised: its command or "", kind "command", "other" or "near_miss", and the sound."""

    command: str
    kind: str
    text: str
    voice: Voice
    noise: str
    pcm: np.ndarray


@dataclass(frozen=True)
class Plan:
    """What is to be said, by whom, in which noise; everything else follows from it."""

    command: str
    kind: str
    text: str
    voice: Voice
    noise: str
    take: int
    snr_db: float = 10.0

    def speak(self, talkers: Sequence[np.ndarray] = ()) -> Optional[Spoken]:
        """Makes the sound; the same plan gives the same sound. None if the voice is not installed."""
        rng = np.random.default_rng(zlib.crc32(repr(self).encode()))
        try:
            speech = synthesise(self.voice, self.text, rng.uniform(0.8, 1.25), int(rng.integers(30, 71)))
        except (OSError, subprocess.CalledProcessError, wave.Error, EOFError):
            return None
        pcm, _ = in_a_room(rng, speech, self.noise, self.snr_db, talkers)
        return Spoken(self.command, self.kind, self.text, self.voice, self.noise, pcm)


def plans(group: str, voices: Sequence[Voice], takes: int, noises: Sequence[str] = NOISES, snr_db: float = 10.0) -> List[Plan]:
    """Every command by every voice `takes` times; every other sentence and near miss by `takes` voices."""
    rng = np.random.default_rng(zlib.crc32(group.encode()))

    def noise() -> str:
        return noises[rng.integers(len(noises))]

    result = [
        Plan(command, "command", text, voice, noise(), take, snr_db)
        for command, text in COMMANDS.items()
        for voice in voices
        for take in range(takes)
    ]
    for kind, texts in (("other", sentences(f"{group}_others")), ("near_miss", near_misses(group))):
        for text in texts:
            for take, index in enumerate(rng.permutation(len(voices))[:takes]):
                result.append(Plan("", kind, text, voices[index], noise(), take, snr_db))
    return result
