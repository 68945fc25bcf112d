"""Speech for the tests: espeak-ng in room noise, and the recogniser's results for a recording."""

import subprocess

import numpy as np
from scipy.signal import resample_poly

from vb_msgs.msg import Audio
from vb_voice_wizard.voice.endpointing import Endpointer

RATE = 16000
_ESPEAK_RATE = 22050


def say(text: str, voice: str = "en-us", pause: float = 0.6, snr_db: float = 20.0, seed: int = 0) -> np.ndarray:
    """Returns (N,) int16 at 16 kHz: a pause, the text, a pause, all in noise with a room's spectrum."""
    command = ["espeak-ng", "-v", voice, "-s", "150", "--stdout", text]
    data = subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout
    samples = np.frombuffer(data[44 : len(data) // 2 * 2], "<i2").astype(float)
    spoken = resample_poly(samples, 320, 441)
    assert 320 * _ESPEAK_RATE == 441 * RATE
    loud = np.flatnonzero(np.abs(spoken) > 0.02 * np.abs(spoken).max())
    spoken = spoken[loud[0] : loud[-1] + 1] / np.abs(spoken).max() * 8000
    silence = np.zeros(int(pause * RATE))
    clean = np.concatenate([silence, spoken, silence])
    level = np.sqrt(np.mean(spoken**2) / 10 ** (snr_db / 10))
    return (clean + room_noise(len(clean), level, seed)).clip(-32768, 32767).astype(np.int16)


def pieces(pcm: np.ndarray) -> list:
    """Splits a recording into messages of a tenth of a second each, as a microphone node publishes them."""
    parts = np.split(pcm, range(RATE // 10, len(pcm), RATE // 10))
    return [Audio(sample_rate=RATE, data=part.tobytes()) for part in parts]


def room_noise(count: int, level: float, seed: int = 0) -> np.ndarray:
    """Returns (count,) float samples of pink noise with this RMS level."""
    frequency = np.maximum(np.fft.rfftfreq(count, 1 / RATE), 40.0)
    white = np.random.default_rng(seed).normal(size=count)
    noise = np.fft.irfft(np.fft.rfft(white) / np.sqrt(frequency), count)
    return noise / noise.std() * level


def tone(hertz: float, duration: float) -> np.ndarray:
    """Returns (N,) int16, a beep."""
    return (6000 * np.sin(2 * np.pi * hertz * np.arange(int(duration * RATE)) / RATE)).astype(np.int16)


def utterances(pcm: np.ndarray) -> list:
    """Returns all utterances of a recording, (N,) int16, followed by a second of silence."""
    return Endpointer().push(np.concatenate([pcm, np.zeros(RATE, np.int16)]))


def examine(recognizer, pcm: np.ndarray) -> list:
    """Returns the recogniser's result for each utterance of a recording."""
    return [recognizer.classify(utterance) for utterance in utterances(pcm)]


def command_in(recognizer, pcm: np.ndarray):
    """Returns the first command in a recording, or None."""
    return next((result.command for result in examine(recognizer, pcm) if result.command), None)
