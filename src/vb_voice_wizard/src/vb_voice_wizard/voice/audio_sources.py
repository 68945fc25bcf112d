"""A microphone through ALSA's arecord: 16 kHz mono, int16."""

from __future__ import annotations

import subprocess
import tempfile
import threading
from typing import Callable, Optional

import numpy as np

SAMPLE_RATE = 16000  # [1/s] of all sound that is listened to


def has_sound(pcm: np.ndarray) -> bool:
    """Returns whether samples (N,) int16 come from a microphone that is on: the quietest one has its own noise."""
    return len(pcm) > 0 and int(pcm.max()) - int(pcm.min()) > 2  # loud ones differ by more than int16 holds


class Microphone:
    """Reads raw samples from a program that writes them to its standard output; starts it again when it ends.

    Args:
        command: the program with its arguments; see `arecord`.
        on_samples: called with (N,) int16 from a thread of this object.
        on_trouble: called with a sentence each time the program cannot be started or ends.
        chunk: how many samples to hand over at a time.
        retry: [s] how long to wait before another start.
        start: starts a thread and handles its faults.
    """

    def __init__(
        self,
        command: list,
        on_samples: Callable[[np.ndarray], None],
        on_trouble: Callable[[str], None],
        chunk: int = 800,
        retry: float = 2.0,
        *,
        start: Callable[[Callable[[], None]], threading.Thread],
    ) -> None:
        self._command = list(command)
        self._on_samples = on_samples
        self._on_trouble = on_trouble
        self._chunk = chunk
        self._retry = retry
        self._closing = threading.Event()
        self._process: Optional[subprocess.Popen] = None
        self._lock = threading.Lock()
        self._thread = start(self._run)

    def close(self) -> None:
        """Ends the program and the thread."""
        self._closing.set()
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                self._process.terminate()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while not self._closing.is_set():
            trouble = self._record()
            if self._closing.is_set():
                return
            self._on_trouble(trouble)
            self._closing.wait(self._retry)

    def _record(self) -> str:
        # what it says goes to a file: a program blocks once a pipe that nobody reads is full, and the system is deaf
        with tempfile.TemporaryFile() as said:
            try:
                with self._lock:
                    self._process = process = subprocess.Popen(self._command, stdout=subprocess.PIPE, stderr=said)
            except OSError as error:
                return f"cannot start {self._command[0]}: {error.strerror}; is alsa-utils installed?"
            with process.stdout as sound:
                while len(data := sound.read(2 * self._chunk)) == 2 * self._chunk:
                    self._on_samples(np.frombuffer(data, dtype="<i2").astype(np.int16))
            process.wait()
            said.seek(0)
            last = said.read().decode(errors="replace").strip().splitlines() or ["it said nothing"]
        return f"{self._command[0]} ended with status {process.returncode}: {last[-1]}"


def arecord(device: str) -> list:
    """Returns the command line that records from an ALSA device as the model wants it."""
    raw = "-q -t raw -f S16_LE -c 1 --buffer-time=200000".split()
    return ["arecord", *raw, "-r", str(SAMPLE_RATE), "-D", device]
