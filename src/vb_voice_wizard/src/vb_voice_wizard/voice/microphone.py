"""Records from a microphone through ALSA's arecord: 16 kHz, mono, int16."""

from __future__ import annotations

import subprocess
import tempfile
import threading
from typing import Callable, Generator, Iterator, List, Optional

import numpy as np

SAMPLE_RATE = 16000  # [1/s] of all sound that is processed
CHUNK_SAMPLES = 800  # samples that `Microphone.get` returns at a time


def has_sound(pcm: np.ndarray) -> bool:
    """Returns whether samples (N,) int16 come from a microphone that is on, which always has some noise."""
    return len(pcm) > 0 and int(pcm.max()) - int(pcm.min()) > 2  # as int, because the difference may exceed int16


class Microphone:
    """Reads samples from a recording program's standard output, and restarts the program when it ends.

    Args:
        command: the program with its arguments; see `arecord_command`.
        on_trouble: called with the reason, a sentence, each time the program ends or cannot be started.
        retry: [s] pause before the next start.
    """

    def __init__(self, command: List[str], on_trouble: Callable[[str], None], retry: float = 2.0) -> None:
        self._command = command
        self._on_trouble = on_trouble
        self._retry = retry
        self._closing = threading.Event()
        self._process: Optional[subprocess.Popen] = None
        self._lock = threading.Lock()
        self._pieces = self._record()

    def get(self) -> Optional[np.ndarray]:
        """Waits for the next samples, (CHUNK_SAMPLES,) int16, or returns None once closed. For one thread only."""
        return next(self._pieces, None)

    def close(self) -> None:
        """Ends the program."""
        self._closing.set()
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                self._process.terminate()

    def _record(self) -> Iterator[np.ndarray]:
        while not self._closing.is_set():
            trouble = yield from self._record_once()
            if not self._closing.is_set():
                self._on_trouble(trouble)
                self._closing.wait(self._retry)

    def _record_once(self) -> Generator[np.ndarray, None, str]:
        """Yields the samples of one run of the program. Returns a sentence that says why it ended."""
        # stderr is a file, because the program would block once a pipe that nobody reads is full
        with tempfile.TemporaryFile() as stderr:
            try:
                with self._lock:
                    self._process = process = subprocess.Popen(self._command, stdout=subprocess.PIPE, stderr=stderr)
            except OSError as error:
                return f"cannot start {self._command[0]}: {error.strerror}; is alsa-utils installed?"
            with process.stdout as stdout:
                while len(data := stdout.read(2 * CHUNK_SAMPLES)) == 2 * CHUNK_SAMPLES:
                    yield np.frombuffer(data, dtype="<i2").astype(np.int16)
            process.wait()
            stderr.seek(0)
            messages = stderr.read().decode(errors="replace").strip().splitlines() or ["it said nothing"]
        return f"{self._command[0]} ended with status {process.returncode}: {messages[-1]}"


def arecord_command(device: str) -> list:
    """Returns the command line that records from an ALSA device in the model's format."""
    raw = "-q -t raw -f S16_LE -c 1 --buffer-time=200000".split()
    return ["arecord", *raw, "-r", str(SAMPLE_RATE), "-D", device]
