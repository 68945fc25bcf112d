"""Computes cepstra as PocketSphinx's acoustic model expects them (its en-us/feat.params), in numpy.

The library computes the same inside its decoder but does not expose them, and rejection needs scores
that its decoder does not expose either (see phone_scoring).
"""
from __future__ import annotations

import functools

import numpy as np
from scipy.fft import dct

SAMPLE_RATE = 16000
FRAME_SHIFT = 160
FRAME_LENGTH = 410
FRAMES_PER_SECOND = SAMPLE_RATE // FRAME_SHIFT

_FFT = 512
_FILTERS = 25
_CEPSTRA = 13
_LOWEST_HZ, _HIGHEST_HZ = 130.0, 6800.0
_WARPED_SHARE = 0.85
_PRE_EMPHASIS = 0.97
_LIFTER = 22
_LOG_FLOOR = 1e-4
# noise tracking, as the model was trained with (-remove_noise yes)
_POWER_DECAY = 0.7
_NOISE_RISE, _NOISE_FALL = 0.995, 0.5
_MASK_DECAY, _MASK_LEVEL = 0.85, 0.2
_MOST_GAIN = 20.0
_SMOOTHING = 4
# what is added to every piece of speech, relative to its own level: digital silence, which no microphone
# gives, has a logarithm unlike anything that the models know
_DITHER = 0.003
_DITHER_LEAST = 1.0
_FLOOR_OF_BAND, _FLOOR_OF_ALL = 0.01, 0.001


def _mel(hertz: np.ndarray) -> np.ndarray:
    return 2595.0 * np.log10(1.0 + np.asarray(hertz) / 700.0)


def _warped(hertz: np.ndarray, warp: float) -> np.ndarray:
    """Frequencies times `warp`, and from where that would leave the range on a straight line to the range's end."""
    knee = _WARPED_SHARE * _HIGHEST_HZ * min(1.0, 1.0 / warp)
    beyond = _HIGHEST_HZ - (_HIGHEST_HZ - knee * warp) / (_HIGHEST_HZ - knee) * (_HIGHEST_HZ - hertz)
    return np.where(hertz <= knee, hertz * warp, beyond)


@functools.lru_cache(maxsize=8)
def _filter_bank(warp: float = 1.0) -> np.ndarray:
    """Triangular filters of unit area, (_FFT // 2 + 1, _FILTERS); edges rounded to the transform's bins."""
    bin_hz = SAMPLE_RATE / _FFT
    mels = np.linspace(_mel(_LOWEST_HZ), _mel(_HIGHEST_HZ), _FILTERS + 2)
    edges = _warped(700.0 * (10.0 ** (mels / 2595.0) - 1.0), warp)
    if warp == 1.0:
        edges = np.floor(edges / bin_hz + 0.5) * bin_hz  # as the model was trained
    hertz = np.arange(_FFT // 2 + 1) * bin_hz
    left, centre, right = edges[:-2], edges[1:-1], edges[2:]
    rising = (hertz[:, None] - left) / (centre - left)
    falling = (right - hertz[:, None]) / (right - centre)
    return np.clip(np.minimum(rising, falling), 0.0, None) * 2.0 / (right - left)


_WINDOW = np.hamming(FRAME_LENGTH)
_LIFT = 1.0 + _LIFTER / 2.0 * np.sin(np.arange(_CEPSTRA) * np.pi / _LIFTER)


def mel_spectrum(pcm: np.ndarray, warp: float = 1.0) -> np.ndarray:
    """Power in mel bands.

    Args:
        pcm: (N,) samples, 16 kHz mono, full scale 32768.
        warp: by which the bands are moved up: 1.18 takes formants that are 1.18 times too high to where the models
            expect them (vocal tract length normalisation, Lee and Rose 1996).

    Returns:
        (T, 25) float64, T = 1 + (N - 410) // 160, or no row if it is shorter than a frame.
    """
    samples = np.asarray(pcm, dtype=np.float64)
    if samples.size < FRAME_LENGTH:
        return np.zeros((0, _FILTERS))
    emphasised = samples.copy()
    emphasised[1:] -= _PRE_EMPHASIS * samples[:-1]
    frames = np.lib.stride_tricks.sliding_window_view(emphasised, FRAME_LENGTH)[::FRAME_SHIFT]
    power = np.abs(np.fft.rfft(frames * _WINDOW, _FFT)) ** 2
    return power @ _filter_bank(warp)


def remove_noise(spectrum: np.ndarray) -> np.ndarray:
    """Subtracts slowly varying noise from mel power, (T, 25) to (T, 25).

    A running low envelope per band is the noise; temporal masking and smoothing of the gain over
    neighbouring bands keep artefacts down.
    """
    if len(spectrum) == 0:
        return spectrum.copy()
    cleaned = np.empty_like(spectrum)
    power = spectrum[0].copy()
    noise = power / _MOST_GAIN
    floor = power / _MOST_GAIN
    peak = np.zeros_like(power)
    bands = np.arange(_FILTERS)
    low, high = np.maximum(bands - _SMOOTHING, 0), np.minimum(bands + _SMOOTHING, _FILTERS - 1) + 1
    for row, now in enumerate(spectrum):
        power = _POWER_DECAY * power + (1.0 - _POWER_DECAY) * now
        noise = _low_envelope(power, noise)
        signal = np.maximum(power - noise, 1.0)
        floor = _low_envelope(signal, floor)
        peak = peak * _MASK_DECAY
        masked = np.where(signal < _MASK_DECAY * peak, peak * _MASK_LEVEL, signal)
        peak = np.maximum(peak, signal)
        gain = np.clip(np.maximum(masked, floor) / np.maximum(power, 1e-30), 1.0 / _MOST_GAIN, _MOST_GAIN)
        sums = np.concatenate(([0.0], np.cumsum(gain)))
        cleaned[row] = now * (sums[high] - sums[low]) / (high - low)
    return cleaned


def clean_spectrum(pcm: np.ndarray, warp: float = 1.0) -> np.ndarray:
    """Mel power of a piece of speech, (N,) to (T, 25), with its noise removed; `warp` as in `mel_spectrum`.

    A recording without noise gets a little first; in a room's noise it makes no difference.
    """
    samples = np.asarray(pcm, dtype=np.float64)
    if samples.size < FRAME_LENGTH:
        return np.zeros((0, _FILTERS))
    # always the same noise: the same recording gets the same answer
    dither = np.random.default_rng(0).normal(size=samples.size)
    samples = samples + dither * (_DITHER * np.sqrt(np.mean(samples**2)) + _DITHER_LEAST)
    spectrum = mel_spectrum(samples, warp)
    return remove_noise(spectrum + _FLOOR_OF_BAND * spectrum.mean(axis=0) + _FLOOR_OF_ALL * spectrum.mean())


def _low_envelope(value: np.ndarray, envelope: np.ndarray) -> np.ndarray:
    keep = np.where(value >= envelope, _NOISE_RISE, _NOISE_FALL)
    return keep * envelope + (1.0 - keep) * value


def cepstra(spectrum: np.ndarray) -> np.ndarray:
    """Liftered cepstra (T, 13) of a mel power spectrum (T, 25)."""
    return dct(np.log(spectrum + _LOG_FLOOR), type=2, norm="ortho", axis=1)[:, :_CEPSTRA] * _LIFT


def dynamic(static: np.ndarray) -> np.ndarray:
    """Cepstra, their first and their second differences, (T, 13) to (3, T, 13); the mean is taken off."""
    if len(static) == 0:
        return np.zeros((3, 0, _CEPSTRA))
    static = static - static.mean(axis=0)
    padded = np.pad(static, ((3, 3), (0, 0)), mode="edge")
    count = len(static)

    def at(offset: int) -> np.ndarray:
        return padded[3 + offset : 3 + offset + count]

    return np.stack([static, at(2) - at(-2), (at(3) - at(-1)) - (at(1) - at(-3))])
