"""What the wizard console shows, drawn with rich; no ROS."""
from __future__ import annotations

import collections
import re
from dataclasses import dataclass, field
from typing import Deque, Dict, List, Tuple

from rich.console import Group
from rich.layout import Layout
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from vb_voice_wizard.interaction import CANCEL, DEFINE_BORDER, DEFINE_SEED, GUIDE_ROBOT, SAVE, spoken

COMMAND_KEYS: Dict[str, str] = {"b": DEFINE_BORDER, "d": DEFINE_SEED, "g": GUIDE_ROBOT, "s": SAVE, "c": CANCEL}
UNDO_KEY, REDO_KEY, QUIT_KEY = "u", "r", "q"

_STYLES = {"default": "white", "border": "orange1", "seed": "sky_blue2", "guide": "hot_pink"}
GOOD, BAD, NOTE = "green", "yellow", "cyan"


# an arrow or function key comes as an escape sequence
_ESCAPE = re.compile("\x1b(?:\\[[0-9;?]*[ -/]*[@-~]|O.|[^\\[O])?")


def keys_typed(text: str) -> str:
    """The letters among what a terminal sent, small; arrow and function keys are no commands."""
    return _ESCAPE.sub("", text).lower()


@dataclass
class View:
    """Everything the console knows; plain values."""

    master: str = ""  # the ROS master's address
    connected: bool = False  # whether it answers
    state: str = ""  # "": the interaction manager has not been heard yet
    manager_present: bool = False
    interaction_id: str = ""
    times_s: Tuple[float, float, float] = (0.0, 0.0, 0.0)  # guide, border, seed
    commands: Tuple[str, ...] = ()
    border_spots: int = 0
    seed_spots: int = 0
    ignored_spots: int = 0
    chain_points: int = 0
    closed: bool = False
    progress_message: str = ""
    seeing: Tuple[str, ...] = ()
    cameras: Tuple[str, ...] = ()
    borders: Tuple[Tuple[str, float, bool], ...] = ()  # name, area [m^2], enabled
    messages: Deque[Tuple[str, str, str]] = field(default_factory=lambda: collections.deque(maxlen=50))

    def say(self, clock: str, text: str, style: str) -> None:
        """Adds a message with the time of day; what repeats the last one is left out."""
        if not self.messages or self.messages[-1][1:] != (text, style):
            self.messages.append((clock, text, style))


def render(view: View, height: int = 24) -> Layout:
    """The whole screen.

    Args:
        height: [lines] of the terminal.
    """
    layout = Layout()
    layout.split_column(
        Layout(_head(view), name="head", size=3),
        Layout(name="body", minimum_size=8),
        Layout(_messages(view, max(3, height // 3 - 2)), name="messages", size=max(5, height // 3)),
        Layout(_keys(view), name="keys", size=4),
    )
    layout["body"].split_row(Layout(_interaction(view), ratio=3), Layout(_borders(view, max(3, height // 3)), ratio=2))
    return layout


def _head(view: View) -> Panel:
    if not view.connected:
        text = Text(f"waiting for the ROS master at {view.master}", style="bold red")
    elif not view.state:
        text = Text("waiting for the interaction manager", style="bold yellow")
    else:
        text = Text(f" {view.state.upper()} ", style=f"bold reverse {_STYLES.get(view.state, 'white')}")
        if view.interaction_id:
            text.append(f"  {_clock(sum(view.times_s))}", style="bold")
            text.append(f"  interaction {view.interaction_id}", style="dim")
        if not view.manager_present:
            text.append("  the interaction manager is away", style="bold red")
    return Panel(text, title="virtual borders: wizard console")


def _interaction(view: View) -> Panel:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column()
    guide, border, seed = view.times_s
    table.add_row("time [s]", f"guide {guide:.1f}, border {border:.1f}, seed {seed:.1f}")
    table.add_row("spots", f"{view.border_spots} border, {view.seed_spots} seed")
    table.add_row("spots ignored", str(view.ignored_spots))
    chain = view.progress_message or "none"
    if view.chain_points:
        chain = f"{view.chain_points} points, {'polygon' if view.closed else 'curve'}"
    table.add_row("chain", chain)
    seeing = Text(", ".join(view.seeing) or "nobody", style="bold green" if view.seeing else "")
    table.add_row("spot seen by", seeing)
    table.add_row("cameras so far", ", ".join(view.cameras) or "none")
    return Panel(table, title="interaction")


def _borders(view: View, room: int) -> Panel:
    lines: List[Text] = []
    for name, area, enabled in view.borders[-room:]:
        lines.append(Text(f"{name}  {area:.2f} m\u00b2{'' if enabled else '  off'}", style="" if enabled else "dim"))
    return Panel(Group(*(lines or [Text("none", style="dim")])), title=f"borders ({len(view.borders)})")


def _messages(view: View, room: int) -> Panel:
    lines = [
        Text.assemble((f"{clock} ", "dim"), (text, style), no_wrap=True, overflow="ellipsis")
        for clock, text, style in list(view.messages)[-room:]
    ]
    return Panel(Group(*lines), title="messages")


def _keys(view: View) -> Panel:
    text = Text()
    for key, command in COMMAND_KEYS.items():
        sensible = command in view.commands
        text.append(f" {key} ", style="bold reverse" if sensible else "reverse dim")
        text.append(f" {spoken(command)}  ", style="bold" if sensible else "dim")
    text.append("\n")
    for key, meaning in ((UNDO_KEY, "undo the last change of the map"), (REDO_KEY, "redo"), (QUIT_KEY, "quit")):
        text.append(f" {key} ", style="reverse")
        text.append(f" {meaning}  ")
    return Panel(text)


def _clock(seconds: float) -> str:
    whole = max(0, int(seconds))
    return f"{whole // 60}:{whole % 60:02d}"
