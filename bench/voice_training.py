#!/usr/bin/env python3
"""Makes config/voice/commands.npz, the network that says which command an utterance is.

    bench/voice_training.py hear --seed 1 --seconds 600    makes lessons: out/bench/voice/training-1.npz; as many as you like
    bench/voice_training.py learn                          trains with all of them; a few minutes
    bench/voice.py --group development                     what the network makes of the development group
    bench/voice_training.py choose                         chooses the thresholds by that

A lesson is one utterance, cut out by the endpointing that the robot uses, as speech_model hears it. Two fifths are commands,
the rest what must not be taken for one: words that sound like one, parts of one, sentences, random words.
A missed command and a near miss that is taken cost the same, one more word: a command is accepted from where both happen
equally often, in steady noise. It is sure with a third of the doubt that the surest of the others left.
Nothing of the evaluation group is heard here.
"""
from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Tuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import voice_speech as speech
from voice_speech import MEANING, MUSIC, NETWORK, NOISES, RATE, TOP

from vb_voice_wizard.voice.endpointing import EndpointParams, utterances
from vb_voice_wizard.voice.speech_model import FOLDER, Beginnings, SpeechModel

LESSONS = TOP / "out" / "bench" / "voice"
TOKENS = 128  # of the 32,768: those that the decoder finds most probable after a beginning
# what else the decoder writes for commands; its continuations of these tell a command from what sounds like it
HEARD_AS = ["the fine", "and you", "re"]
COMPONENTS = 256  # of the lessons' variation: the rest is voice and room
HIDDEN = (192,)
EPOCHS = 40
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


def _training(rng: np.random.Generator) -> Iterator[Tuple[str, str, np.ndarray]]:
    """(text, voice, sound) without end."""
    voices, noises = speech.training_voices(), (*NOISES["training"], *MUSIC["training"], "babble")
    talkers = [speech.synthesise(("espeak-ng", "en-us+f2"), text) for text in speech.sentences("training_others")[:8]]
    talkers += [speech.synthesise(("flite", "rms"), text) for text in speech.sentences("training_others")[8:24]]
    # noise is cut out of long pieces: to make it for each lesson would take longer than all the rest
    long = {noise: speech.room_noise(rng, 25 * RATE, noise, talkers) for noise in noises}

    def noise_of(noise: str) -> Callable[[int], np.ndarray]:
        return lambda count: long[noise][rng.integers(len(long[noise]) - count) :][:count]

    for text in _texts(rng):
        program, name = voices[rng.integers(len(voices))]
        if program == "recorded":
            able = [one for one in speech.NEURAL["training"] if any((speech.RECORDINGS / one).glob(f"{text.replace(' ', '_')}-*.wav"))]
            name = able[rng.integers(len(able))] if able else ""
        try:
            clean = speech.synthesise((program, name), text, rng.uniform(0.75, 1.3), int(rng.integers(25, 76)))
        except (OSError, IndexError, ValueError, EOFError, speech.wave.Error, speech.subprocess.CalledProcessError):
            continue  # nobody recorded that
        if len(clean) > 2.5 * RATE:
            continue  # too long for a command, which needs no lesson
        for _ in range(5 if text in MEANING else 4):
            # playing faster or slower shifts pitch and formants alike, as a shorter or longer vocal tract does
            stretch = 1.0 if rng.random() < 0.25 else rng.uniform(0.85, 1.18)
            snr_db = rng.uniform(7, 14) if rng.random() < 0.65 else rng.uniform(3, 25)
            noise = str(rng.choice(noises))
            spoken = np.interp(np.arange(0, len(clean) - 1, 1.0 / stretch), np.arange(len(clean)), clean)
            yield text, f"{program} {name}", speech.in_a_room(rng, spoken, noise_of(noise), snr_db)


def hear(seed: int, seconds: float) -> None:
    """Writes a file of lessons."""
    rng, model, ends = np.random.default_rng(seed), SpeechModel(), time.monotonic() + seconds
    rows: List[Tuple[np.ndarray, str, str]] = []
    for text, voice, pcm in _training(rng):
        cut = [one.pcm for one in utterances(pcm, EndpointParams()) if not one.too_long]
        if cut:
            rows.append((model.moments(max(cut, key=len)).astype(np.float16), text, voice))
        if time.monotonic() > ends:
            break
    LESSONS.mkdir(parents=True, exist_ok=True)
    moments, texts, voices = zip(*rows)
    np.savez(str(LESSONS / f"training-{seed}.npz"), moments=np.concatenate(moments), count=np.array(list(map(len, moments))),
             texts=np.array(texts), voices=np.array(voices))
    print(f"{len(rows)} lessons, {sum(text in MEANING for text in texts)} of commands")


def _tokenise(text: str) -> List[int]:
    """A text as Moonshine writes it, with a capital first: the pair of pieces that makes the first token in its list is joined first."""
    found = []
    for word in (text[0].upper() + text[1:]).split():
        pieces = [letter.encode() for letter in "\u2581" + word]
        while True:
            joined = [_TOKENS.get(first + second, len(_TOKENS)) for first, second in zip(pieces, pieces[1:])]
            if not joined or min(joined) == len(_TOKENS):
                break
            at = int(np.argmin(joined))
            pieces[at : at + 2] = [pieces[at] + pieces[at + 1]]
        found += [_TOKENS[piece] for piece in pieces]
    return found


def _read_tokens() -> Dict[bytes, int]:
    """Number of each of Moonshine's tokens; each stands in the file behind its length, long ones have two bytes of length."""
    data, at, found, number = (FOLDER / "tokenizer.bin").read_bytes(), 0, {}, 0
    while at < len(data):
        length, at = data[at], at + 1
        if length >= 128:
            length, at = length - 128 + 128 * data[at], at + 1
        found[data[at : at + length]] = number  # a single letter is there twice: first as a mere byte, which is never written
        at, number = at + length, number + 1
    return found


_TOKENS = _read_tokens()


def learn(output: Path) -> None:
    """Writes the network."""
    from sklearn.decomposition import PCA
    from sklearn.neural_network import MLPClassifier

    commands, model = list(speech.COMMANDS), SpeechModel()
    files = [np.load(str(path)) for path in sorted(LESSONS.glob("training-*.npz"))]
    moments, count, texts, voices = (np.concatenate([file[name] for file in files]) for name in ("moments", "count", "texts", "voices"))
    heard = np.split(moments.astype(np.float32), np.cumsum(count)[:-1])
    beginnings = Beginnings([_tokenise(text) for text in (*MEANING, *HEARD_AS)])
    some = [np.exp(model.continuations(one, beginnings) / 2) for one in heard[:: len(heard) // 250 + 1]]
    tokens = np.argsort(-np.sum(some, axis=0), axis=1)[:, :TOKENS]
    shapes = np.array([np.take_along_axis(model.continuations(one, beginnings), tokens, 1).reshape(-1) for one in heard])
    wanted = np.array([commands.index(MEANING[text]) + 1 if text in MEANING else 0 for text in texts])
    print(f"{len(shapes)} lessons by {len(set(voices))} voices, {np.mean(wanted > 0):.2f} of commands")
    mean, deviation = shapes.mean(axis=0), shapes.std(axis=0) + 1e-2
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

    output.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        str(output), commands=np.array(commands), threshold=0.5, sure=1.0, texts=beginnings.texts, tokens=tokens.astype(np.uint16),
        **arrays,
    )


def choose(output: Path) -> None:
    """Writes the thresholds into the network."""
    with np.load(str(output)) as file:
        arrays = dict(file)
    results = json.loads((TOP / "out" / "bench" / "voice_development.json").read_text())["utterances"]
    found = [max(result["found"], key=lambda one: one[1], default=("", 0.0)) for result in results]
    best, chance = np.array([one[0] for one in found]), np.array([one[1] for one in found])
    meant, kind = (np.array([result[name] for result in results]) for name in ("command", "kind"))
    steady = np.isin([result["noise"] for result in results], NOISES["development"])
    right, near = np.where(best == meant, chance, 0.0)[steady & (kind == "command")], chance[steady & (kind == "near_miss")]
    threshold = min(np.linspace(0.01, 0.99, 99), key=lambda at: abs(np.mean(right < at) - np.mean(near >= at)))
    surest = chance[(kind != "command") & np.isin(best, speech.ASKED_ABOUT)].max()
    arrays.update(threshold=threshold, sure=1.0 - (1.0 - surest) / DOUBT)
    np.savez_compressed(str(output), **arrays)
    print(f"threshold {threshold:.3f}, sure {float(arrays['sure']):.4f}")


def main() -> None:
    """See the module's text."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("hear", "learn", "choose"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--output", type=Path, default=NETWORK)
    given = parser.parse_args()
    if given.what == "hear":
        hear(given.seed, given.seconds)
    else:
        {"learn": learn, "choose": choose}[given.what](given.output)


if __name__ == "__main__":
    sys.exit(main())
