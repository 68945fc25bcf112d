"""Shows an image full-screen on a projector. It uses Python's Tk, because OpenCV's headless build has no windows."""

from __future__ import annotations

import threading
import time
from typing import Callable, Optional

import numpy as np

from vb_core.errors import CodedError

_POLL_PERIOD = 0.04  # [s] between checks for a new image


class ProjectorWindow:
    """A window without frame, title and pointer. It has a thread, because all calls of Tk must come from the same one.

    Args:
        x, y: [px] upper left corner of the projector's screen on the desktop.
        width, height: [px].
        start: starts a thread that runs a function, and handles the function's exceptions.

    Raises:
        CodedError: "no_window" if Tk is not installed or there is no screen.
    """

    def __init__(
        self, x: int, y: int, width: int, height: int, start: Callable[[Callable[[], None]], threading.Thread]
    ) -> None:
        self._geometry = f"{width}x{height}+{x}+{y}"
        self._lock = threading.Lock()
        self._next_image: Optional[bytes] = None
        self._closing = False
        self._ready = threading.Event()
        self._error = ""
        self._thread = start(self._run)
        self._ready.wait()
        if self._error:
            raise CodedError("no_window", self._error)

    def show(self, image: np.ndarray) -> None:
        """Shows an image (H, W, 3) uint8 rgb as soon as the thread checks for a new one."""
        height, width = image.shape[:2]
        # PPM, which Tk can read without further libraries
        data = b"P6 %d %d 255\n" % (width, height) + np.ascontiguousarray(image).tobytes()
        with self._lock:
            self._next_image = data

    def close(self) -> None:
        """Closes the window."""
        self._closing = True
        self._thread.join(5.0)

    def _run(self) -> None:
        try:
            import tkinter

            root = tkinter.Tk()
        except Exception as error:  # Tk is not installed, or finds no screen
            self._error = f"the projector's window needs a screen and Tk (apt-get install python3-tk): {error}"
            self._ready.set()
            return
        root.overrideredirect(True)
        root.geometry(self._geometry)
        root.configure(background="black", cursor="none")
        label = tkinter.Label(root, borderwidth=0, highlightthickness=0, background="black")
        label.pack(fill="both", expand=True)
        self._ready.set()
        displayed = None  # Tk shows an image only while it is referenced
        while not self._closing:
            with self._lock:
                data = self._next_image
                self._next_image = None
            if data is not None:
                displayed = tkinter.PhotoImage(data=data)
                label.configure(image=displayed)
            root.update()
            time.sleep(_POLL_PERIOD)
        # Tk's objects must be destroyed in the thread that created them
        root.destroy()
        displayed = label = root = None  # noqa: F841
