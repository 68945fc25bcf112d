"""How each moment of an utterance sounds, as numbers that say little of voice, room and noise.

The idea: a network that its authors trained on very many hours of people's speech hears better than what one laboratory can
train on synthetic voices. This is the encoder of Moonshine (tiny, English; MIT licence); scripts/setup takes its file out of
the package moonshine-voice. Its decoder, which writes text, is not used.
"""
from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import onnxruntime

from vb_core.errors import CodedError

from vb_voice_wizard.voice.audio_sources import SAMPLE_RATE

MODEL = Path(sys.prefix) / "share" / "moonshine" / "encoder_model.ort"
FEATURES = 288  # numbers for each moment, about 41 moments a second
_PEAK = 0.5  # of full scale: loudness is no part of a word


class SpeechEncoder:
    """Moonshine's encoder; one thread, since each camera's detector wants its own core.

    Raises:
        CodedError: "no_speech_model" if its file is missing or unusable.
    """

    def __init__(self, model: Path = MODEL) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        try:
            self._session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime has its own kinds of errors for a missing file and for a bad one
            raise CodedError("no_speech_model", file=model, reason=" ".join(str(error).split())) from error

    def moments(self, pcm: np.ndarray) -> np.ndarray:
        """(N,) int16 at 16 kHz, a tenth of a second at least, to (T, FEATURES) float32."""
        samples = np.asarray(pcm, dtype=np.float32)[None]
        samples = samples * (_PEAK / max(1.0, float(np.abs(samples).max())))
        mask = np.ones(samples.shape, dtype=np.int64)
        return self._session.run(None, {"input_values": samples, "attention_mask": mask})[0][0]


def word_shape(moments: np.ndarray, samples: int, places: int) -> np.ndarray:
    """An utterance of any length as one vector: its moments at evenly spaced places, then its duration.

    Args:
        moments: (T, FEATURES).
        samples: length of the utterance.
        places: how many places.

    Returns:
        (places * FEATURES + 1,) float32.
    """
    last = len(moments) - 1
    at = np.clip((np.arange(places) + 0.5) / places * len(moments) - 0.5, 0.0, last)
    before = np.floor(at).astype(int)
    share = (at - before)[:, None]
    found = (1.0 - share) * moments[before] + share * moments[np.minimum(before + 1, last)]
    return np.append(found.reshape(-1), samples / SAMPLE_RATE).astype(np.float32)
