"""Reports on a terminal what happens in a running interaction."""
from __future__ import annotations

import contextlib
import time
from typing import Optional, Set, Tuple

from rich.console import Console
from rich.table import Table

from vb_core.geometry import chain_length
from vb_core.ros import messages
from vb_msgs.msg import BorderProgress

# a line for this many more spots: a stroke of 6.5 m makes some hundreds
_SPOTS_PER_LINE = 100


class ProgressLog:
    """Prints what is new about a system that an `Observer` watches, with the time since the start."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._started = time.monotonic()
        self._state = "default"
        self._answer: Optional[Tuple[str, str]] = None
        self._cameras: Set[str] = set()
        self._spots = 0
        self._seed_told = False
        self._doing = ""

    def say(self, text: str) -> None:
        """One line."""
        self._console.print(f"[dim]{time.monotonic() - self._started:6.1f} s[/dim]  {text}")

    def status(self, text: str):
        """A context whose `update` shows a line that changes; a log file gets the events alone."""
        if self._console.is_terminal:
            return self._console.status(text)
        return contextlib.nullcontext(_Silent())

    def tell(self, observer) -> None:
        """Says what has changed since the last call."""
        if observer.state:
            self._tell_state(observer.state)
        if observer.progress:
            self._tell_progress(observer.progress)
        doing = observer.lab.participant_doing if observer.lab else ""
        if doing and doing != self._doing:
            self._doing = doing
            self.say(f"the participant {doing}")

    def _tell_state(self, state) -> None:
        answer = (state.last_command, state.last_message)
        if state.name != self._state:
            self._state = state.name
            self.say(f"state [bold]{state.name}[/bold]" + (f": {state.last_message}" if state.last_message else ""))
        elif answer != self._answer and state.last_message and not state.last_success:
            self.say(f"answer to {state.last_command}: {state.last_message}")
        self._answer = answer

    def _tell_progress(self, progress: BorderProgress) -> None:
        newcomers = sorted(set(progress.cameras) - self._cameras)
        if newcomers:
            self._cameras.update(newcomers)
            self.say(f"camera {' and '.join(newcomers)} sees the spot")
        if progress.border_spots >= self._spots + _SPOTS_PER_LINE:
            self._spots = progress.border_spots - progress.border_spots % _SPOTS_PER_LINE
            self.say(f"{progress.border_spots} spots, {_chain_words(progress)}")
        if progress.has_seed and not self._seed_told:
            self._seed_told = True
            self.say(f"the seed point is at ({progress.seed.x:.2f}, {progress.seed.y:.2f}) m")


def live_line(observer) -> str:
    """One line about the present moment."""
    parts = []
    if observer.state:
        parts.append(f"state {observer.state.name}")
    if observer.progress:
        parts.append(f"{observer.progress.border_spots} spots, {_chain_words(observer.progress)}")
    if observer.lab and observer.lab.robot_poses:
        pose = observer.lab.robot_poses[0]
        parts.append(f"robot at ({pose.x:.1f}, {pose.y:.1f})")
        parts.append(f"real-time factor {observer.lab.real_time_factor:.2f}")
    return "  |  ".join(parts) or "..."


def result_table(summary: dict) -> Table:
    """The summary of a run for people."""
    table = Table(title="result", show_header=False)
    rows = [
        ("Jaccard index against the ground truth", f"{summary['jaccard']:.3f}"),
        *((f"time in {name}", f"{summary['time_s'][name]:.1f} s") for name in ("guide", "border", "seed", "total")),
        ("way before", _way(summary["path_before_m"])
         + (", crosses the area" if summary["path_before_crosses_border"] else ", does not cross the area")),
        ("way after", _way(summary["path_after_m"])
         + (", CROSSES the border" if summary["path_after_crosses_border"] else ", respects the border")),
        ("driven", f"{summary['drive_outcome']}, {_way(summary['path_driven_m'])} in {summary['drive_s']:.0f} s"
         + (", ENTERED the border" if summary["path_driven_crosses_border"] else ", kept out of the border")),
        ("real-time factor", f"{summary['real_time_factor']:.3f}"),
    ]
    for camera, counts in sorted(summary["frames"].items()):
        rate = counts["published"] / summary["duration_s"] if summary["duration_s"] else 0.0
        delay = ""
        if "delay_p95_ms" in counts:
            delay = f" after {counts['delay_median_ms']:.0f} ms (95 %: {counts['delay_p95_ms']:.0f})"
        searched = f"{counts['processed']} of {counts['published']} searched{delay}"
        rows.append((f"camera {camera}", f"{rate:.1f} frames/s, {searched}, spot in {counts['detected']}"))
    for row in rows:
        table.add_row(*row)
    return table


def _way(length: Optional[float]) -> str:
    return "none" if length is None else f"{length:.2f} m"


def _chain_words(progress: BorderProgress) -> str:
    if not progress.chain:
        return "no chain yet"
    length = chain_length(messages.array_from_points(progress.chain), progress.closed)
    return f"{'polygon' if progress.closed else 'open chain'} of {length:.2f} m"


class _Silent:
    def update(self, *_args, **_kwargs) -> None:
        """Nothing to show."""
