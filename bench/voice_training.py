#!/usr/bin/env python3
"""Makes config/voice/commands.npz, the network that says which command an utterance is.

    bench/voice_training.py hear --seed 1 --seconds 600    makes lessons: out/bench/voice/training-1.npz; as many as you like
    bench/voice_training.py hear --group development       the utterances that the thresholds are chosen with
    bench/voice_training.py learn                          trains with all of them; a minute

A lesson is one utterance, cut out by the endpointing that the robot uses, as speech_encoder hears it. Two fifths are commands,
the rest what must not be taken for one: words that sound like one, parts of one, sentences, random words.
The thresholds come from the development group alone. A missed command and a near miss that is taken cost the same, one more
word: a command is accepted from where both happen equally often, in steady noise. It is sure
with a third of the doubt that the surest of the others left. Nothing of the evaluation group (bench/voice.py) is heard here.
"""
from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Callable, Iterator, List, Tuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import voice_speech as speech
from voice_speech import MEANING, MUSIC, NOISES, RATE, TOP

from vb_voice_wizard.voice.endpointing import EndpointParams, utterances
from vb_voice_wizard.voice.speech_encoder import FEATURES, SpeechEncoder, word_shape

LESSONS = TOP / "out" / "bench" / "voice"
NETWORK = TOP / "src" / "vb_voice_wizard" / "config" / "voice" / "commands.npz"
HEARD_PLACES = 20  # of a lesson; a network may use fewer
PLACES = 10
COMPONENTS = 256  # of the lessons' variation: the rest is voice and room
HIDDEN = (192,)
EPOCHS = 25
DOUBT = 3.0  # how many times less of it than the surest near miss left is sure
PARTS = ["define", "border", "seed", "guide", "robot", "the robot", "border border", "stop it", "save it", "save file", "undo that"]


def _texts(rng: np.random.Generator) -> Iterator[str]:
    commands, near, others = list(MEANING), speech.sentences("training_near_misses"), speech.sentences("training_others")
    words = speech.sentences("common_words")
    while True:
        draw = rng.random()
        pool = commands if draw < 0.42 else near if draw < 0.75 else others if draw < 0.81 else PARTS if draw < 0.86 else None
        if pool is not None:
            yield str(rng.choice(pool))
        else:
            yield " ".join(words[int(len(words) * rng.random() ** 2)] for _ in range(rng.integers(1, 4)))


def _training(rng: np.random.Generator) -> Iterator[Tuple[str, str, str, np.ndarray]]:
    """(text, voice, noise, sound) without end."""
    voices, noises = speech.training_voices(), (*NOISES["training"], *MUSIC["training"], "babble")
    talkers = [speech.synthesise(("espeak-ng", "en-us+f2"), text) for text in speech.sentences("training_others")[:8]]
    talkers += [speech.synthesise(("flite", "rms"), text) for text in speech.sentences("training_others")[8:24]]
    # noise is cut out of long pieces: to make it for each lesson would take longer than all the rest
    long = {noise: speech.room_noise(rng, 25 * RATE, noise, talkers) for noise in noises}

    def noise_of(noise: str) -> Callable[[int], np.ndarray]:
        return lambda count: long[noise][rng.integers(len(long[noise]) - count) :][:count]

    for text in _texts(rng):
        voice = voices[rng.integers(len(voices))]
        try:
            clean = speech.synthesise(voice, text, rng.uniform(0.75, 1.3), int(rng.integers(25, 76)))
        except (OSError, IndexError, ValueError, EOFError, speech.wave.Error, speech.subprocess.CalledProcessError):
            continue  # nobody recorded that
        if len(clean) > 2.5 * RATE:
            continue  # too long for a command, which needs no lesson
        for _ in range(5 if text in MEANING else 4):
            # playing faster or slower shifts pitch and formants alike, as a shorter or longer vocal tract does
            stretch = 1.0 if rng.random() < 0.25 else rng.uniform(0.8, 1.22)
            snr_db = rng.uniform(7, 14) if rng.random() < 0.65 else rng.uniform(3, 25)
            noise = str(rng.choice(noises))
            spoken = np.interp(np.arange(0, len(clean) - 1, 1.0 / stretch), np.arange(len(clean)), clean)
            yield text, " ".join(voice), noise, speech.in_a_room(rng, spoken, noise_of(noise), snr_db)


def _development() -> Iterator[Tuple[str, str, str, np.ndarray]]:
    """The same of all that is planned for the development."""
    plans, talkers = speech.everything("development")
    for plan in plans:
        pcm = plan.speak(talkers)
        if pcm is not None:
            yield plan.text, " ".join(plan.voice), plan.noise, pcm


def hear(group: str, seed: int, seconds: float) -> None:
    """Writes a file of lessons."""
    rng, encoder, ends = np.random.default_rng(seed), SpeechEncoder(), time.monotonic() + seconds
    rows: List[Tuple[np.ndarray, str, str, str, float]] = []
    for text, voice, noise, pcm in _training(rng) if group == "training" else _development():
        cut = [one for one in utterances(pcm, EndpointParams()) if not one.too_long]
        if cut:
            longest = max(cut, key=lambda one: len(one.pcm)).pcm
            rows.append((word_shape(encoder.moments(longest), len(longest), HEARD_PLACES).astype(np.float16), text, voice, noise, len(cut)))
        elif group == "development":
            rows.append((np.zeros(HEARD_PLACES * FEATURES + 1, np.float16), text, voice, noise, 0))
        if time.monotonic() > ends:
            break
    LESSONS.mkdir(parents=True, exist_ok=True)
    shapes, texts, voices, noises, found = zip(*rows)
    np.savez(str(LESSONS / f"{group}-{seed}.npz"), shapes=np.array(shapes), texts=np.array(texts), voices=np.array(voices),
             noises=np.array(noises), found=np.array(found))
    print(f"{len(rows)} lessons, {sum(text in MEANING for text in texts)} of commands")


def lessons(group: str) -> Tuple[np.ndarray, ...]:
    """(shapes at PLACES, texts, voices, noises, how many utterances were found) of all files of a group."""
    files = [np.load(str(path)) for path in sorted(LESSONS.glob(f"{group}-*.npz"))]
    shapes, *rest = (np.concatenate([file[name] for file in files]) for name in ("shapes", "texts", "voices", "noises", "found"))
    shapes = shapes.astype(np.float32)
    places = shapes[:, :-1].reshape(len(shapes), PLACES, HEARD_PLACES // PLACES, FEATURES).mean(axis=2)
    return (np.hstack([places.reshape(len(shapes), -1), shapes[:, -1:]]), *rest)


def learn(output: Path) -> None:
    """Writes the network."""
    from sklearn.decomposition import PCA
    from sklearn.neural_network import MLPClassifier

    commands = list(speech.COMMANDS)
    number = {text: commands.index(command) + 1 for text, command in MEANING.items()}
    shapes, texts, voices, _, _ = lessons("training")
    wanted = np.array([number.get(text, 0) for text in texts])
    print(f"{len(shapes)} lessons by {len(set(voices))} voices, {np.mean(wanted > 0):.2f} of commands")
    mean, deviation = shapes.mean(axis=0), shapes.std(axis=0) + 1e-3
    parts = PCA(COMPONENTS, whiten=True, svd_solver="randomized", random_state=0).fit((shapes - mean) / deviation)
    network = MLPClassifier(HIDDEN, alpha=1.0, batch_size=128, learning_rate_init=1e-3, max_iter=EPOCHS, random_state=0)
    network.fit(parts.transform((shapes - mean) / deviation), wanted)
    # scaling, components and first layer are one matrix
    project = (parts.components_ / np.sqrt(parts.explained_variance_)[:, None]).T
    weights, bias = list(network.coefs_), list(network.intercepts_)
    shift = -(mean / deviation + parts.mean_) @ project
    weights[0], bias[0] = (project / deviation[:, None]) @ weights[0], shift @ weights[0] + bias[0]
    arrays = {f"weights{index}": one.astype(np.float16) for index, one in enumerate(weights)}
    arrays.update({f"bias{index}": one.astype(np.float32) for index, one in enumerate(bias)})

    def save(threshold: float, sure: float) -> None:
        output.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(str(output), commands=np.array(commands), places=PLACES, threshold=threshold, sure=sure, **arrays)

    save(0.5, 1.0)
    _choose(output, save, commands)


def _choose(output: Path, save, commands: List[str]) -> None:
    """Chooses the thresholds with the development group."""
    from vb_voice_wizard.recognizer import CommandNetwork

    network = CommandNetwork(output)
    shapes, texts, voices, noises, found = lessons("development")
    chance = np.array([network.probabilities(shape) for shape in shapes]) * (found > 0)[:, None]
    best, sure_of = chance.argmax(axis=1), chance.max(axis=1)
    meant = np.array([commands.index(MEANING[text]) if text in MEANING else -1 for text in texts])
    near = np.isin(texts, speech.sentences("development_near_misses"))
    steady = np.isin(noises, NOISES["development"])
    right = np.where(best == meant, sure_of, 0.0)[steady & (meant >= 0)]
    threshold = float(min(np.linspace(0.01, 0.99, 99), key=lambda at: abs(np.mean(right < at) - np.mean(sure_of[near & steady] >= at))))
    asked = np.isin(best, [commands.index(name) for name in speech.ASKED_ABOUT])
    sure = float(1.0 - (1.0 - sure_of[(meant < 0) & asked].max()) / DOUBT)
    save(threshold, sure)
    print(f"threshold {threshold:.3f}, sure {sure:.4f}")
    for name, kinds in (("steady", NOISES["development"]), ("music", MUSIC["development"]), ("babble", ("babble",))):
        here = np.isin(noises, kinds)
        right = (best == meant) & (sure_of >= threshold)
        figures = [f"{100 * values.mean():.1f} % of {len(values)}" for values in (
            right[here & (meant >= 0)], (sure_of >= threshold)[here & near], (sure_of >= threshold)[here & ~near & (meant < 0)],
            (right & (sure_of >= sure))[here & (meant >= 0)],
        )]
        print(f"{name}: right {figures[0]}, near misses taken {figures[1]}, others {figures[2]}; sure {figures[3]}")
    wrong = np.flatnonzero((meant >= 0) & steady & ~((best == meant) & (sure_of >= threshold)))
    print("missed:", [(str(texts[row]), str(voices[row]), str(noises[row]), commands[best[row]], round(float(sure_of[row]), 2)) for row in wrong[:30]])
    taken = np.flatnonzero((meant < 0) & (sure_of >= threshold))
    print("taken:", [(str(texts[row]), commands[best[row]], round(float(sure_of[row]), 3)) for row in taken[:40]])


def main() -> None:
    """See the module's text."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("hear", "learn"))
    parser.add_argument("--group", choices=("training", "development"), default="training")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--output", type=Path, default=NETWORK)
    given = parser.parse_args()
    if given.what == "hear":
        hear(given.group, given.seed, given.seconds)
    else:
        learn(given.output)


if __name__ == "__main__":
    sys.exit(main())
