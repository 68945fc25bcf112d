"""A program in a pseudo-terminal, for the rostests."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import termios
import threading

from vb_testing import wait_until


class Terminal:
    """The wizard console, or another command, in a pseudo-terminal; keeps all its output."""

    def __init__(self, command=("rosrun", "vb_voice_wizard", "wizard_console")):
        self.master, self.slave = pty.openpty()
        # 24 rows of 80 columns: the smallest usual over ssh
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        self.settings = termios.tcgetattr(self.slave)
        self.raw = b""
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), self.slave)
        run = ["bash", "-c", 'exec "$@"', "-", *command]
        self.process = subprocess.Popen(run, env={**os.environ, "TERM": "xterm"}, start_new_session=True, **streams)
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        while True:
            try:
                self.raw += os.read(self.master, 65536)
            except OSError:
                return  # the other end is closed

    @property
    def text(self):
        """All output so far, without escape sequences."""
        return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", self.raw.decode("utf-8", "replace"))

    def shows(self, text, since=0):
        """Waits until a text has been written, after the first `since` characters."""
        wait_until(lambda: text in self.text[since:], lambda: f"'{text}' on the screen, ending\n{self.text[-3000:]}")

    def press(self, key):
        """Types a key or a text."""
        os.write(self.master, key.encode())

    def leave(self):
        """Quits. Returns the exit status, and whether the terminal echoes again and reads line by line."""
        self.press("q")
        status = self.process.wait(timeout=240)
        same = termios.tcgetattr(self.slave)[3] == self.settings[3]
        os.close(self.slave)
        # the reader ends first: a closed file's descriptor may be reused by the next file opened
        self._reader.join()
        os.close(self.master)
        return status, same
