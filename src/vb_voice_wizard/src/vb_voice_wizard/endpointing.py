"""Finds where somebody speaks, in a live stream or in a recording, in whatever noise there is.

Per mel band the noise is a low percentile of the last seconds' power; a frame is speech if the mean
likelihood ratio of its bands against that noise is high (after Sohn, Kim and Sung, 1999).
"""
from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Deque, List, Optional

import numpy as np

from vb_core.parameters import Parameters, param

from vb_voice_wizard.speech_features import FRAME_LENGTH, FRAME_SHIFT, FRAMES_PER_SECOND, SAMPLE_RATE, mel_spectrum


@dataclass(frozen=True)
class EndpointParams(Parameters):
    """When speech starts and ends; config/voice_commands.yaml says why."""

    threshold: float = param(0.5, "", above=0.0, high=20.0)
    noise_window: float = param(3.0, "s", low=0.5, high=30.0)
    noise_percentile: float = param(30.0, "%", low=1.0, high=90.0)
    start_speech: float = param(0.08, "s", low=0.01, high=1.0)
    end_silence: float = param(0.25, "s", low=0.05, high=2.0)
    shortest: float = param(0.15, "s", low=0.0, high=5.0)
    longest: float = param(3.0, "s", low=0.5, high=30.0)
    padding: float = param(0.2, "s", low=0.0, high=1.0)


@dataclass(frozen=True)
class Utterance:
    """One piece of speech.

    Attributes:
        pcm: (N,) int16 samples at 16 kHz, padding included.
        start, end: [s] where the speech itself begins and ends, counted from the stream's first sample.
        too_long: it went on beyond the longest that is of interest; `pcm` is only its beginning.
    """

    pcm: np.ndarray
    start: float
    end: float
    too_long: bool = False


def _frames(seconds: float) -> int:
    return max(1, int(round(seconds * FRAMES_PER_SECOND)))


class Endpointer:
    """Cuts utterances out of a stream of samples.

    Args:
        params: see EndpointParams.
        recording: a whole recording to learn the noise from beforehand; None for a live stream, which
            learns as it goes.
    """

    def __init__(self, params: EndpointParams, recording: Optional[np.ndarray] = None) -> None:
        self._params = params
        self._window: Deque[np.ndarray] = deque(maxlen=_frames(params.noise_window))
        self._fixed = None
        if recording is not None and len(recording) >= FRAME_LENGTH:
            self._fixed = self._floor(_smooth(mel_spectrum(recording)))
        self._samples = np.zeros(0, dtype=np.int16)
        self._dropped = 0
        self._frame = 0
        self._recent: Deque[np.ndarray] = deque(maxlen=3)
        self._noise: Optional[np.ndarray] = self._fixed
        self._speech_run = 0
        self._first = -1
        self._last = -1
        self._overlong = False

    @property
    def speaking(self) -> bool:
        """Whether somebody speaks right now."""
        return self._first >= 0

    def push(self, pcm: np.ndarray) -> List[Utterance]:
        """Takes the stream's next samples, (N,) int16, any N; gives the utterances that ended in them."""
        self._samples = np.concatenate([self._samples, np.asarray(pcm, dtype=np.int16)])
        offset = self._frame * FRAME_SHIFT - self._dropped
        found = []
        for power in mel_spectrum(self._samples[offset:]):
            utterance = self._step(power)
            if utterance is not None:
                found.append(utterance)
        self._forget()
        return found

    def flush(self) -> List[Utterance]:
        """Ends the stream: an utterance under way is given as if silence followed."""
        utterance = self._finish() if self.speaking else None
        return [utterance] if utterance is not None else []

    def reset(self) -> None:
        """Drops an utterance under way; what is known about the noise stays."""
        self._first, self._speech_run, self._overlong = -1, 0, False

    # ------------------------------------------------------------------ one frame
    def _step(self, power: np.ndarray) -> Optional[Utterance]:
        params = self._params
        self._recent.append(power)
        smooth = np.mean(self._recent, axis=0)
        if self._fixed is None:
            self._window.append(smooth)
            # the floor moves slowly: ten times a second will do
            if self._noise is None or self._frame % 10 == 0:
                self._noise = self._floor(np.array(self._window))
        ratio = np.maximum(smooth / self._noise, 1.0)
        speech = float(np.mean(ratio - np.log(ratio) - 1.0)) > params.threshold
        frame, self._frame = self._frame, self._frame + 1
        if speech:
            self._speech_run += 1
            self._last = frame
            if not self.speaking and self._speech_run >= _frames(params.start_speech):
                self._first = frame - self._speech_run + 1
        else:
            self._speech_run = 0
        if not self.speaking:
            return None
        if frame - self._last >= _frames(params.end_silence):
            return self._finish()
        if not self._overlong and frame - self._first > _frames(params.longest):
            self._overlong = True
            return self._cut(too_long=True)
        return None

    def _finish(self) -> Optional[Utterance]:
        long_enough = self._last + 1 - self._first >= _frames(self._params.shortest)
        utterance = self._cut() if long_enough and not self._overlong else None
        self.reset()
        return utterance

    def _cut(self, too_long: bool = False) -> Utterance:
        padding = _frames(self._params.padding)
        start = max(0, (self._first - padding) * FRAME_SHIFT - self._dropped)
        end = (self._last + 1 + padding) * FRAME_SHIFT - self._dropped
        return Utterance(
            self._samples[start:end].copy(), self._first / FRAMES_PER_SECOND, (self._last + 1) / FRAMES_PER_SECOND, too_long
        )

    def _floor(self, powers: np.ndarray) -> np.ndarray:
        # the percentile lies below the mean of the noise; digital silence must not make every rustle speech
        return np.maximum(np.percentile(powers, self._params.noise_percentile, axis=0) * 1.25, 1e3)

    def _forget(self) -> None:
        keep_from = self._first if self.speaking and not self._overlong else self._frame
        keep_from -= _frames(self._params.padding) + _frames(self._params.start_speech) + 2
        count = keep_from * FRAME_SHIFT - self._dropped
        # in large steps: copying has its price
        if count > SAMPLE_RATE:
            self._samples = self._samples[count:]
            self._dropped += count


def _smooth(powers: np.ndarray) -> np.ndarray:
    sums = np.cumsum(np.vstack([np.zeros_like(powers[:1]), powers]), axis=0)
    high = np.arange(1, len(powers) + 1)
    low = np.maximum(high - 3, 0)
    return (sums[high] - sums[low]) / (high - low)[:, None]


def utterances(pcm: np.ndarray, params: EndpointParams) -> List[Utterance]:
    """All utterances of a recording, (N,) int16 at 16 kHz."""
    endpointer = Endpointer(params, recording=pcm)
    return endpointer.push(pcm) + endpointer.flush()
