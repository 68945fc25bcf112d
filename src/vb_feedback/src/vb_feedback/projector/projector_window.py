"""Shows an image on a projector's full screen, by Tk: part of Python itself; OpenCV's headless build has no window."""

from __future__ import annotations

import threading
from typing import Any, Callable, Optional

import numpy as np

from vb_core.errors import CodedError

_LOOK_MS = 40  # how often the window checks for a newer image; a still image costs nothing else


class ProjectorWindow:
    """A window without frame, title and pointer. It has its own thread, since Tk wants one thread.

    Args:
        x, y: [px] place on the desktop: where the projector's screen begins.
        width, height: [px].
        start: starts a thread and handles its faults.

    Raises:
        CodedError: "no_window" if Tk is not installed or there is no screen.
    """

    def __init__(
        self, x: int, y: int, width: int, height: int, start: Callable[[Callable[[], None]], threading.Thread]
    ) -> None:
        self._geometry = f"{width}x{height}+{x}+{y}"
        self._lock = threading.Lock()
        self._next: Optional[bytes] = None
        self._closing = False
        self._ready = threading.Event()
        self._trouble = ""
        self._thread = start(self._run)
        self._ready.wait()
        if self._trouble:
            raise CodedError("no_window", self._trouble)

    def show(self, image: np.ndarray) -> None:
        """Shows (H, W, 3) uint8 rgb, as soon as the window looks for it."""
        height, width = image.shape[:2]
        # PPM is what Tk reads without any other library
        data = b"P6 %d %d 255\n" % (width, height) + np.ascontiguousarray(image).tobytes()
        with self._lock:
            self._next = data

    def close(self) -> None:
        """Closes the window."""
        self._closing = True
        self._thread.join(5.0)

    def _run(self) -> None:
        try:
            import tkinter
        except ImportError:
            self._trouble = "the projector's window needs Tk: apt-get install python3-tk, or set window to false"
            self._ready.set()
            return
        try:
            root = tkinter.Tk()
        except tkinter.TclError as error:
            self._trouble = f"there is no screen for the projector's window: {error}"
            self._ready.set()
            return
        faults = []

        def on_fault(_kind: Any, fault: BaseException, _trace: Any) -> None:
            # Tk would print it and go on with a window that never shows anything new
            faults.append(fault)
            root.quit()

        root.report_callback_exception = on_fault
        root.title("floor projector")
        root.overrideredirect(True)
        root.geometry(self._geometry)
        root.configure(background="black", cursor="none")
        label = tkinter.Label(root, borderwidth=0, highlightthickness=0, background="black")
        label.pack(fill="both", expand=True)
        shown = []  # Tk shows an image only as long as there is a reference to it

        def look() -> None:
            with self._lock:
                data, self._next = self._next, None
            if data is not None:
                shown[:] = [tkinter.PhotoImage(data=data)]
                label.configure(image=shown[0])
            if self._closing:
                root.destroy()
            else:
                root.after(_LOOK_MS, look)

        look()
        self._ready.set()
        root.mainloop()
        # Tk's objects must die in the thread that made them
        shown.clear()
        label = root = None  # noqa: F841
        if faults:
            raise faults[0]
