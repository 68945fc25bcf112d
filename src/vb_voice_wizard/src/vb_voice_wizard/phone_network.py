"""A small network that tells phones apart in noise: trained by bench/voice_training.py, evaluated in numpy.

The Gaussian model knows many real voices in quiet; the network knows synthetic ones in room noise.
Their scores are added (phone_scoring.combine).
"""
from __future__ import annotations

from pathlib import Path
from typing import List

import numpy as np

from vb_core.errors import CodedError

# the frames that are evaluated together: every second one, 0.1 s to both sides
CONTEXT = np.arange(-10, 11, 2)
_LOG_FLOOR = 1e-4


def network_input(spectrum: np.ndarray) -> np.ndarray:
    """Noise-removed mel power (T, 25) to (T, 275) float32: logarithms without their mean, with context."""
    logs = np.log(spectrum + _LOG_FLOOR)
    logs = (logs - logs.mean(axis=0)).astype(np.float32)
    rows = np.clip(np.arange(len(logs))[:, None] + CONTEXT, 0, len(logs) - 1)
    return logs[rows].reshape(len(logs), -1)


class PhoneNetwork:
    """Posteriors of phones, and of silence, per frame.

    Args:
        path: an .npz file with mean, deviation, prior, phones, and weights0, bias0, weights1 ...

    Raises:
        CodedError: "bad_phone_network" if it is not such a file.
    """

    def __init__(self, path: Path) -> None:
        try:
            with np.load(str(path), allow_pickle=False) as file:
                self.phones: List[str] = [str(phone) for phone in file["phones"]]
                self._mean = file["mean"].astype(np.float32)
                self._scale = 1.0 / file["deviation"].astype(np.float32)
                self._log_prior = np.log(file["prior"].astype(np.float64))
                count = sum(name.startswith("weights") for name in file.files)
                self._layers = [
                    (file[f"weights{index}"].astype(np.float32), file[f"bias{index}"].astype(np.float32))
                    for index in range(count)
                ]
        except (OSError, KeyError, ValueError) as error:
            raise CodedError("bad_phone_network", f"cannot read {path}: {error}") from error
        width = len(self._mean)
        for weights, bias in self._layers:
            if weights.shape != (width, len(bias)):
                raise CodedError("bad_phone_network", f"{path}: layers do not fit together")
            width = len(bias)
        if width != len(self.phones) or width != len(self._log_prior):
            raise CodedError("bad_phone_network", f"{path}: phones and outputs do not fit together")

    def log_posteriors(self, spectrum: np.ndarray) -> np.ndarray:
        """Noise-removed mel power (T, 25) to (T, len(phones)) natural logarithms."""
        values = (network_input(spectrum) - self._mean) * self._scale
        for number, (weights, bias) in enumerate(self._layers):
            values = values @ weights + bias
            if number + 1 < len(self._layers):
                np.maximum(values, 0.0, out=values)
        values -= values.max(axis=1, keepdims=True)
        return (values - np.log(np.exp(values).sum(axis=1, keepdims=True))).astype(np.float64)

    def scaled_likelihoods(self, posteriors: np.ndarray, floor: float = -12.0, prior_weight: float = 0.8) -> np.ndarray:
        """log p(x | phone) up to a constant: log posteriors, not below a floor, minus weighted log priors."""
        return np.maximum(posteriors, floor) - prior_weight * self._log_prior
