"""Child processes of a script: a roslaunch with its own master.

The kernel ends a child when its parent ends, however that happens. No handler has to run, so that neither SIGTERM nor
SIGKILL leaves a roslaunch behind; roslaunch then ends its nodes.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import socket
import subprocess
from pathlib import Path
from typing import Any, List, Sequence

_PORTS = range(20000, 32768)  # below Linux's ephemeral ports
_OWN_GROUP: Any = {"stdin": subprocess.DEVNULL, "stderr": subprocess.STDOUT, "start_new_session": True}


def free_port(preferred: int = 0) -> int:
    """Finds an unused TCP port on loopback: the preferred one if it is free.

    Any other port lies outside the ephemeral range, so that no connection takes it before its server listens.
    """
    while True:
        port = preferred or secrets.choice(_PORTS)
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # connections in TIME_WAIT do not count
            with contextlib.suppress(OSError):
                probe.bind(("127.0.0.1", port))
                return port
        preferred = 0


def spawn(command: Sequence[str], **options: Any) -> subprocess.Popen:
    """Starts a command that gets SIGTERM when the calling thread ends. `options` are Popen's.

    Its own children get no signal: it has to end them itself, as roslaunch does.
    """
    return subprocess.Popen(["setpriv", "--pdeathsig", "TERM", *command], **options)


class ChildProcess:
    """A child process in its own group, so that everything it started ends with it. See `spawn`."""

    def __init__(self, command: List[str], log: Path) -> None:
        self.log = log
        log.parent.mkdir(parents=True, exist_ok=True)
        with open(str(log), "w") as output:
            self._process = spawn(command, stdout=output, **_OWN_GROUP)

    @property
    def running(self) -> bool:
        """Whether the process has not ended yet."""
        return self._process.poll() is None

    def tail(self, lines: int = 8) -> str:
        """Returns the last lines that the process wrote."""
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])

    def stop(self, timeout: float = 12.0) -> None:
        """Interrupts the process. If it does not end in time, terminates and then kills its group."""
        for sign, seconds in ((signal.SIGINT, timeout), (signal.SIGTERM, 3.0), (signal.SIGKILL, 3.0)):
            if not self.running:
                return
            # roslaunch ends its nodes itself when interrupted; only later signals go to the whole group
            send = os.kill if sign == signal.SIGINT else os.killpg
            with contextlib.suppress(ProcessLookupError, subprocess.TimeoutExpired):
                send(self._process.pid, sign)
                self._process.wait(seconds)


def start_roslaunch(files: Sequence[Path], log: Path, port: int, **arguments: Any) -> ChildProcess:
    """Starts launch files with these arguments. Their nodes use the master at this port, which roslaunch starts."""
    words = []
    for name, value in arguments.items():
        text = str(value).lower() if isinstance(value, bool) else str(value)
        words.append(f"{name}:={text}")
    return ChildProcess(["roslaunch", "-p", str(port), *map(str, files), *words], log)
