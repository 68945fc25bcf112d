#!/usr/bin/env python3
"""Makes config/voice/phones.npz (the phone network) and config/voice/decision.yaml (the recogniser's decision).

    bench/voice_training.py             both; about half an hour on two idle cores
    bench/voice_training.py refine      both, but the network that is there is only taught on
    bench/voice_training.py decision    the decision only, with the network that is there

The network learns phones from sentences and random words by the training voices, the decision from
commands and other sentences by the calibration voices, which the network never heard. Neither hears a
voice or a sentence of bench/voice.py.
"""
from __future__ import annotations

import argparse
import functools
import os
import sys
import time
from multiprocessing import Pool
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import resample_poly

import voice_speech as speech
from voice_speech import CALIBRATION_VOICES, COMMANDS, NOISES, RATE, TOP, TRAINING_MUSIC

from vb_voice_wizard import recognizer as recognition
from vb_voice_wizard.acoustic_model import SILENCE, AcousticModel, embedded_model
from vb_voice_wizard.phone_network import network_input
from vb_voice_wizard.phone_scoring import PhoneSet, PhraseScorer
from vb_voice_wizard.rivals import Lexicon
from vb_voice_wizard.speech_features import FRAME_LENGTH, FRAME_SHIFT, cepstra, clean_spectrum, dynamic, mel_spectrum, remove_noise

OUTPUT = TOP / "src" / "vb_voice_wizard" / "config" / "voice"
UTTERANCES = 4000
COPIES = 2
LAYERS = (384, 192)
RATES = (1e-3, 1e-3, 1e-3, 5e-4, 3e-4, 1e-4, 3e-5)
# teaching on: fewer utterances and smaller steps, so that what is known is kept
REFINE_UTTERANCES = 1500
REFINE_RATES = (3e-4, 3e-4, 1e-4, 3e-5)
ROOMS = (*NOISES, *TRAINING_MUSIC, "babble")
COMMON_WORDS = 4000
RANDOM_OTHERS = 900
# share of calibration's commands that has to be said again: the price of what else is let through
MISSED_COMMANDS = 0.02

_phones: Optional[PhoneSet] = None
_dictionary: Dict[str, List[List[str]]] = {}
_talkers: List[np.ndarray] = []


@functools.lru_cache(maxsize=None)
def common_words() -> List[str]:
    """The most probable words of the embedded language model."""
    folder = embedded_model().parent
    return list(dict.fromkeys(Lexicon(folder / "cmudict-en-us.dict", folder / "en-us.lm.bin").words))[:COMMON_WORDS]


def dictionary() -> Dict[str, List[List[str]]]:
    """The embedded pronunciation dictionary."""
    if not _dictionary:
        for line in (embedded_model().parent / "cmudict-en-us.dict").read_text().splitlines():
            word, *phones = line.split()
            _dictionary.setdefault(word.split("(")[0], []).append(phones)
    return _dictionary


def random_words(rng: np.random.Generator, most: int) -> str:
    """One to `most` common words, the commonest most often."""
    words = common_words()
    return " ".join(words[int(len(words) * rng.random() ** 2)] for _ in range(rng.integers(1, most + 1)))


# ------------------------------------------------------------------ the network
def _setup(talkers: List[np.ndarray]) -> None:
    global _phones
    _phones = PhoneSet(AcousticModel(embedded_model()))
    _talkers[:] = talkers
    dictionary()


def _labels(text: str, samples: np.ndarray) -> Optional[np.ndarray]:
    """The phone of each frame of clean speech, by aligning it with its text; None if that fails."""
    words = [word.strip(".,'").lower() for word in text.split()]
    if any(word not in _dictionary for word in words):
        return None
    variants = [[_dictionary[word][0] for word in words], [_dictionary[word][-1] for word in words]]
    likelihoods = _phones.likelihoods(dynamic(cepstra(remove_noise(mel_spectrum(samples)))))
    found = PhraseScorer(_phones, variants).align(likelihoods)
    alignment = found.trace(int(found.scores.argmax()))
    if alignment.score < -1e9:
        return None
    labels = np.full(len(likelihoods.best), len(_phones.names), dtype=np.int8)
    for name, first, behind in alignment.phones:
        if name != SILENCE:
            labels[first:behind] = _phones.index[name]
    return labels


def _lesson(job: Tuple[int, str, speech.Voice]) -> Optional[Tuple[np.ndarray, np.ndarray]]:
    """Inputs and labels of one utterance, said in several rooms by several lengths of the vocal tract."""
    number, text, voice = job
    rng = np.random.default_rng(number)
    try:
        clean = speech.synthesise(voice, text, rng.uniform(0.75, 1.3), int(rng.integers(25, 76)))
    except (OSError, IndexError, ValueError, speech.wave.Error, speech.subprocess.CalledProcessError):
        return None
    pad = RATE // 5
    quiet = np.concatenate([np.zeros(pad), clean * 8000, np.zeros(pad)])
    labels = _labels(text, quiet + rng.normal(0, 20, len(quiet)))
    if labels is None:
        return None
    inputs, wanted = [], []
    for _ in range(COPIES):
        # playing faster or slower shifts pitch and formants alike, as a shorter or longer vocal tract does
        stretch = 1.0 if rng.random() < 0.3 else rng.uniform(0.78, 1.25)
        spoken = resample_poly(clean, int(round(100 * stretch)), 100)
        stretch = len(spoken) / len(clean)
        snr_db = rng.uniform(7, 13) if rng.random() < 0.6 else rng.uniform(4, 22)
        noise = ROOMS[rng.integers(len(ROOMS))]
        pcm, before = speech.in_a_room(rng, spoken, noise, snr_db, _talkers)
        # cut as the endpointing cuts
        start = max(0, before - int(rng.uniform(0.12, 0.28) * RATE))
        pcm = pcm[start : before + len(spoken) + int(rng.uniform(0.12, 0.28) * RATE)]
        values = network_input(clean_spectrum(pcm))
        middle = np.arange(len(values)) * FRAME_SHIFT + FRAME_LENGTH // 2 - (before - start)
        source = np.floor((middle / stretch + pad - FRAME_LENGTH // 2) / FRAME_SHIFT + 0.5).astype(int)
        inside = (source >= 0) & (source < len(labels))
        inputs.append(values.astype(np.float16))
        wanted.append(np.where(inside, labels[np.clip(source, 0, len(labels) - 1)], len(_phones.names)))
    return np.vstack(inputs), np.concatenate(wanted).astype(np.int8)


def train_network(processes: int, output: Path, start: Optional[Path]) -> None:
    """Writes phones.npz; goes on from the network `start` if there is one."""
    from sklearn.neural_network import MLPClassifier

    rng = np.random.default_rng(0)
    voices, known, phrases = speech.training_voices(), speech.sentences("calibration_others"), list(COMMANDS.values())
    near = speech.near_misses("calibration")
    rates, count = (RATES, UTTERANCES) if start is None else (REFINE_RATES, REFINE_UTTERANCES)
    jobs = []
    for number in range(count):
        draw = rng.random()
        if draw < 0.15:
            text = phrases[rng.integers(len(phrases))]
        elif draw < 0.35:
            text = known[rng.integers(len(known))]
        elif draw < 0.55:
            text = near[rng.integers(len(near))]
        else:
            text = random_words(rng, 6)
        jobs.append((number, text, voices[rng.integers(len(voices))]))
    talkers = [speech.synthesise(voices[rng.integers(len(voices))], text) for text in known[:40]]
    started = time.monotonic()
    with Pool(processes, _setup, (talkers,)) as pool:
        lessons = [lesson for lesson in pool.imap(_lesson, jobs, chunksize=20) if lesson is not None]
    inputs = np.vstack([lesson[0] for lesson in lessons])
    labels = np.concatenate([lesson[1] for lesson in lessons])
    del lessons
    print(f"{len(labels)} frames of {len(voices)} voices after {time.monotonic() - started:.0f} s", flush=True)
    phones = [*PhoneSet(AcousticModel(embedded_model())).names, SILENCE]
    network = MLPClassifier(LAYERS, batch_size=512, alpha=3e-5, learning_rate_init=rates[0], random_state=0)
    prior = np.bincount(labels, minlength=len(phones)) / len(labels)
    if start is None:
        mean, deviation = inputs[::7].astype(np.float32).mean(axis=0), inputs[::7].astype(np.float32).std(axis=0)
    else:
        mean, deviation = _take_over(network, start, len(phones))
    for epoch, rate in enumerate(rates):
        order = rng.permutation(len(labels))
        for at in range(0, len(order), 65536):
            if hasattr(network, "_optimizer"):
                network._optimizer.learning_rate_init = rate
            rows = order[at : at + 65536]
            values = (inputs[rows].astype(np.float32) - mean) / deviation
            network.partial_fit(values, labels[rows], classes=np.arange(len(phones)))
        right = network.score(values, labels[rows])
        print(f"epoch {epoch + 1} of {len(rates)}: {100 * right:.1f} % of frames, {time.monotonic() - started:.0f} s", flush=True)
        arrays = {f"weights{index}": weights.astype(np.float16) for index, weights in enumerate(network.coefs_)}
        arrays.update({f"bias{index}": bias.astype(np.float16) for index, bias in enumerate(network.intercepts_)})
        np.savez_compressed(
            str(output / "phones.npz"),
            phones=np.array(phones),
            mean=mean,
            deviation=deviation,
            prior=prior,
            **arrays,
        )


def _take_over(network: Any, start: Path, phones: int) -> Tuple[np.ndarray, np.ndarray]:
    """Gives a network the weights of a file; returns the mean and deviation of its inputs."""
    with np.load(str(start), allow_pickle=False) as file:
        mean, deviation = file["mean"].astype(np.float32), file["deviation"].astype(np.float32)
        # one step, so that everything is allocated
        network.partial_fit(np.zeros((phones, len(mean)), np.float32), np.arange(phones), classes=np.arange(phones))
        for index in range(len(network.coefs_)):
            network.coefs_[index][:] = file[f"weights{index}"]
            network.intercepts_[index][:] = file[f"bias{index}"]
    return mean, deviation


# ------------------------------------------------------------------ the decision
_recognizer: Optional[recognition.CommandRecognizer] = None


def _setup_recognizer(network: str, decision: str) -> None:
    global _recognizer
    # threshold 0: with nothing in doubt there is no second look, the decision is made for the first one
    _recognizer = recognition.CommandRecognizer(recognition.RecognizerParams(network=network, decision=decision, threshold=0.0))


def _measure(plan: speech.Plan) -> List[Tuple[str, str, str, Tuple[float, ...]]]:
    """(kind, command meant, command found, measures) of each utterance that is found in a recording."""
    spoken = plan.speak()
    if spoken is None:
        return []
    issues = [issue for issue in _recognizer.examine(spoken.pcm) if issue.measures]
    return [(plan.kind, plan.command, issue.best, tuple(issue.measures)) for issue in issues]


def train_decision(processes: int, output: Path, takes: int) -> None:
    """Writes decision.yaml."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.preprocessing import StandardScaler

    path = output / "decision.yaml"
    names = recognition.MEASURES
    if not path.exists():
        _write_decision(path, np.zeros(len(names)), 0.0, 1.0, "")
    rng = np.random.default_rng(1)
    noises = (*NOISES, *TRAINING_MUSIC)
    jobs = speech.plans("calibration", CALIBRATION_VOICES, takes, noises)
    for take in range(RANDOM_OTHERS * takes // 4):
        voice, noise = CALIBRATION_VOICES[rng.integers(len(CALIBRATION_VOICES))], noises[rng.integers(len(noises))]
        text = random_words(rng, 4)
        if text not in COMMANDS.values():
            jobs.append(speech.Plan("", "other", text, voice, noise, take))
    with Pool(processes, _setup_recognizer, (str(output / "phones.npz"), str(path))) as pool:
        rows = [row for result in pool.imap(_measure, jobs, chunksize=20) for row in result]
    # a command taken for another one teaches nothing about commands and other speech
    rows = [row for row in rows if row[1] in ("", row[2])]
    values = np.array([row[3] for row in rows])
    right = np.array([row[1] != "" for row in rows])
    near = np.array([row[0] == "near_miss" for row in rows])
    scaler = StandardScaler().fit(values)
    model = LogisticRegression(C=0.3, max_iter=5000)
    model.fit(scaler.transform(values), right)
    weights = model.coef_[0] / scaler.scale_
    scores = values @ weights
    # a confidence of one half is where the wanted share of commands is let through
    offset = -float(np.quantile(scores[right], MISSED_COMMANDS))
    # without asking: what none of those reached that were no command, but were taken for one that is asked about
    asked = np.array([row[2] in speech.ASKED_ABOUT for row in rows])
    sure = 1.0 / (1.0 + np.exp(-(scores[~right & asked].max() + offset)))
    note = (
        f"{right.sum()} commands, {(~right & ~near).sum()} other utterances, {near.sum()} near misses; "
        f"accepted {100 * np.mean(scores[right] + offset >= 0):.1f} %, "
        f"{100 * np.mean(scores[~right & ~near] + offset >= 0):.1f} %, {100 * np.mean(scores[near] + offset >= 0):.1f} %"
    )
    print(note)
    _write_decision(path, weights, offset, float(np.ceil(sure * 1e4) / 1e4), note)


def _write_decision(path: Path, weights: np.ndarray, offset: float, sure: float, note: str) -> None:
    lines = [
        "# Made by bench/voice_training.py from synthetic voices in 10 dB of room noise and music; recognizer.MEASURES says what is weighed.",
        "# confidence = 1 / (1 + exp(-(weights . measures + offset)))",
        f"# {note}",
        f"offset: {offset:.4f}",
        f"sure: {sure:.4f}",
        "weights:",
    ]
    lines += [f"  {name}: {weight:.5f}" for name, weight in zip(recognition.MEASURES, weights)]
    path.write_text("\n".join(lines) + "\n")


def main() -> None:
    """See the module's text."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("all", "refine", "decision"), default="all")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--takes", type=int, default=4, help="how often the decision hears each command from each voice")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="folder to write to")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    if arguments.what != "decision":
        start = OUTPUT / "phones.npz" if arguments.what == "refine" else None
        train_network(arguments.processes, arguments.output, start)
    train_decision(arguments.processes, arguments.output, arguments.takes)


if __name__ == "__main__":
    sys.exit(main())
