"""What the wizard console shows, drawn with rich; no ROS."""
from __future__ import annotations

import collections
import textwrap
from dataclasses import dataclass, field
from typing import Deque, List, Tuple

from rich.console import Group, RenderableType
from rich.layout import Layout
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from vb_voice_wizard.console_keys import COMMAND_KEYS, KEY_HELP, BorderRow, Controls
from vb_voice_wizard.interaction import spoken

_STYLES = {"default": "white", "border": "orange1", "seed": "sky_blue2", "guide": "hot_pink"}
GOOD, BAD, NOTE = "green", "yellow", "cyan"

# [lines] what the parts of the screen take; the messages have the rest
_HEAD, _BODY, _PREVIEW, _KEYS = 1, 8, 5, 3
_LEAST_MESSAGES = 3
_WIDEST = 400


@dataclass
class View:
    """Everything the console knows; plain values."""

    master: str = ""  # the ROS master's address
    connected: bool = False  # whether it answers
    state: str = ""  # "": the interaction manager has not been heard yet
    away: Tuple[str, ...] = ()  # the nodes that do not answer
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
    robot: str = ""
    preview: str = ""  # what saving now would do, "": there is nothing to save yet
    preview_good: bool = False
    findings: Tuple[Tuple[str, bool], ...] = ()  # of the preview: what, and whether it forbids saving
    borders: Tuple[BorderRow, ...] = ()
    controls: Controls = field(default_factory=Controls)
    messages: Deque[Tuple[str, str, str]] = field(default_factory=lambda: collections.deque(maxlen=50))

    def say(self, clock: str, text: str, style: str) -> None:
        """Adds a message with the time of day; what repeats the last one is left out."""
        if not self.messages or self.messages[-1][1:] != (text, style):
            self.messages.append((clock, text, style))


def render(view: View, width: int = 80, height: int = 24) -> Layout:
    """The whole screen.

    Args:
        width, height: [columns, lines] of the terminal.
    """
    width = min(width, _WIDEST)
    free = height - _HEAD - _BODY - _PREVIEW - _KEYS - _LEAST_MESSAGES
    # a long list of borders may grow, but not at the messages' whole expense
    body = _BODY + max(0, min(free // 2, len(view.borders) + 2 - _BODY))
    preview = _PREVIEW if free >= 0 else 0
    messages = height - _HEAD - body - preview - _KEYS
    parts = [
        Layout(_head(view), name="head", size=_HEAD),
        Layout(name="body", size=body),
        Layout(_preview(view, width - 4), name="preview", size=preview, visible=preview > 0),
        Layout(_messages(view, width - 4, messages - 2), name="messages", visible=messages >= _LEAST_MESSAGES),
        Layout(_keys(view), name="keys", size=_KEYS),
    ]
    layout = Layout()
    layout.split_column(*parts)
    layout["body"].split_row(Layout(_interaction(view), ratio=3), Layout(_borders(view, body - 2), ratio=2))
    return layout


def _head(view: View) -> Text:
    if not view.connected:
        return Text(f"waiting for the ROS master at {view.master}", style="bold red")
    if not view.state:
        return Text("waiting for the interaction manager", style="bold yellow")
    text = Text(f" {view.state.upper()} ", style=f"bold reverse {_STYLES.get(view.state, 'white')}", no_wrap=True)
    if view.interaction_id:
        text.append(f"  {_clock(sum(view.times_s))}", style="bold not reverse")
    if view.away:
        text.append(f"  away: {', '.join(view.away)}", style="bold red not reverse")
    elif view.interaction_id:
        text.append(f"  interaction {view.interaction_id}", style="dim not reverse")
    return text


def _interaction(view: View) -> Panel:
    table = Table.grid(padding=(0, 2))
    table.add_column(style="dim", no_wrap=True)
    table.add_column(no_wrap=True, overflow="ellipsis")
    guide, border, seed = view.times_s
    table.add_row("time [s]", f"guide {guide:.1f}, border {border:.1f}, seed {seed:.1f}")
    table.add_row("spots", f"{view.border_spots} border, {view.seed_spots} seed, {view.ignored_spots} ignored")
    chain = view.progress_message or "none"
    if view.chain_points:
        chain = f"{view.chain_points} points, {'polygon' if view.closed else 'curve'}"
    table.add_row("chain", Text(chain))
    seeing = Text(", ".join(view.seeing) or "nobody", style="bold green" if view.seeing else "")
    table.add_row("seen by", seeing)
    table.add_row("cameras", Text(", ".join(view.cameras) or "none"))
    table.add_row("robot", Text(view.robot or "unknown"))
    return Panel(table, title="interaction", padding=(0, 1))


def _borders(view: View, room: int) -> Panel:
    chosen = view.controls.chosen(view.borders)
    first = 0
    if chosen is not None:
        # the chosen one is always on the screen
        first = max(0, min(view.borders.index(chosen) - room // 2, len(view.borders) - room))
    lines: List[RenderableType] = []
    for row in view.borders[first : first + room]:
        details = f" {row.area_m2:.2f} m\u00b2"
        if row.occupancy < 1.0:
            details += f" {row.occupancy:.0%}"
        if not row.enabled:
            details += " off"
        mark = "> " if row is chosen else "  "
        line = Table.grid(expand=True)
        line.add_column(no_wrap=True, overflow="ellipsis", ratio=1)
        line.add_column(no_wrap=True, justify="right")
        style = ("bold" if row is chosen else "") if row.enabled else "dim"
        line.add_row(Text(mark + row.name, style=style), Text(details, style=style))
        lines.append(line)
    return Panel(
        Group(*(lines or [Text("none", style="dim")])), title=f"borders ({len(view.borders)})", padding=(0, 1)
    )


def _preview(view: View, width: int) -> Panel:
    good = GOOD if view.preview_good else BAD
    lines = [Text(line, style=good) for line in _wrapped(view.preview, width)] if view.preview else []
    for what, forbids in view.findings:
        if what not in view.preview:
            lines += [Text(line, style="bold red" if forbids else BAD) for line in _wrapped(f"! {what}", width)]
    if not lines:
        lines = [Text("there is nothing to save yet", style="dim")]
    return Panel(Group(*lines[: _PREVIEW - 2]), title="save now", padding=(0, 1))


def _messages(view: View, width: int, room: int) -> Panel:
    lines: List[Text] = []
    for clock, text, style in view.messages:
        for number, line in enumerate(_wrapped(f"{clock} {text}", width)):
            if number == 0:
                lines.append(Text.assemble((clock, "dim"), (line[len(clock) :], style)))
            else:
                lines.append(Text(line, style=style))
    return Panel(Group(*lines[-room:] if room > 0 else []), title="messages", padding=(0, 1))


def _wrapped(text: str, width: int) -> List[str]:
    return textwrap.wrap(text, max(10, width), subsequent_indent="  ") or [""]


def _keys(view: View) -> Group:
    controls = view.controls
    chosen = controls.chosen(view.borders)
    name = chosen.name if chosen is not None else ""
    if controls.mode == "rename":
        return Group(
            Text.assemble(("new name of ", "bold"), f"{name}: {controls.text}", ("_", "blink")),
            Text("Enter takes it, Esc leaves the old one", style="dim"),
        )
    if controls.mode == "remove":
        return Group(
            Text(f"remove {name} from the map?", style="bold yellow"),
            Text("y removes it, any other key keeps it; undo brings it back", style="dim"),
        )
    commands, others = Text(no_wrap=True), Text(no_wrap=True)
    for key, command in COMMAND_KEYS.items():
        sensible = command in view.commands
        commands.append(f" {key} ", style="bold reverse" if sensible else "reverse dim")
        commands.append(f" {spoken(command)}  ", style="bold" if sensible else "dim")
    for key, meaning in KEY_HELP:
        others.append(f" {key} ", style="reverse")
        others.append(f" {meaning} ")
    return Group(commands, Text(), others)


def _clock(seconds: float) -> str:
    whole = max(0, int(seconds))
    return f"{whole // 60}:{whole % 60:02d}"
