"""What the wizard console shows, drawn with rich. Needs the messages, no node."""

from __future__ import annotations

import collections
import textwrap
from dataclasses import dataclass, field
from typing import Any, Deque, Dict, List, Optional, Sequence, Tuple

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.layout import Layout
from rich.panel import Panel
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from vb_core import sentences
from vb_core.notices import Notice, Severity
from vb_core.ros.messages import mapping_from_values
from vb_core.vocabulary import DEFAULT, STATES
from vb_msgs.msg import BorderIssue, BorderPreview, BorderProgress, InteractionState, VirtualBorder

from vb_voice_wizard.console.keys import COMMAND_KEYS, QUIT_KEY

GOOD, BAD, NOTE = "green", "yellow", "cyan"

# [lines] heights of the parts of the screen; the messages have the rest
_HEAD, _BODY, _PREVIEW = 1, 6, 5
_MIN_MESSAGES = 3
_WIDEST = 400
_CONTROLS = dict.fromkeys(code for code in (*range(0x20), *range(0x7F, 0xA0)) if chr(code) != "\n")


@dataclass
class ConsoleContent:
    """Everything the screen shows: the newest messages, as they came."""

    state: Optional[InteractionState] = None  # None: the interaction manager is not heard
    progress: BorderProgress = field(default_factory=BorderProgress)
    preview: BorderPreview = field(default_factory=BorderPreview)
    borders: Sequence[VirtualBorder] = ()
    notices: Tuple[Notice, ...] = ()  # what holds now, the most severe first
    language: str = sentences.ENGLISH
    messages: Deque[Tuple[str, str, str]] = field(default_factory=lambda: collections.deque(maxlen=50))

    @property
    def drawn(self) -> BorderProgress:
        """What was drawn in the current interaction."""
        ours = self.state is not None and self.progress.interaction_id == self.state.interaction_id
        return self.progress if ours else BorderProgress()

    def words(self, code: str, **values: Any) -> str:
        """Returns the words for a code in the operator's language."""
        return sentences.translate(code, values, self.language)

    def sentence(self, said: Any) -> str:
        """Returns what a message with code, values and English sentence says, in the operator's language."""
        return (
            sentences.translate(said.code, mapping_from_values(said.values), self.language, said.message)
            if said.code
            else said.message
        )

    def add_message(self, clock: str, text: str, style: str) -> None:
        """Adds a message with the time of day, unless it repeats the last one."""
        if not self.messages or self.messages[-1][1:] != (text, style):
            self.messages.append((clock, text, style))


class _Printable:
    """A screen without control characters but its own: names and sentences come from elsewhere, and rich lets ESC pass."""

    def __init__(self, screen: RenderableType) -> None:
        self._screen = screen

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for text, style, control in console.render(self._screen, options):
            yield Segment(text if control else text.translate(_CONTROLS), style, control)


def render(view: ConsoleContent, now: float = 0.0, width: int = 80, height: int = 24) -> RenderableType:
    """Writes the whole screen.

    Args:
        now: [s] ROS time.
        width, height: [columns, lines] of the terminal.
    """
    width = min(width, _WIDEST)
    keys = _keys(view, width)
    free = height - _HEAD - _BODY - _PREVIEW - len(keys) - _MIN_MESSAGES
    # a long list of borders may grow, but not at the messages' whole expense
    body = _BODY + max(0, min(free // 2, len(view.borders) + 2 - _BODY))
    preview = _PREVIEW if free >= 0 else 0
    messages = height - _HEAD - body - preview - len(keys)
    parts = [
        Layout(_head(view, now), name="head", size=_HEAD),
        Layout(name="body", size=body),
        Layout(_preview(view, width - 4), name="preview", size=preview, visible=preview > 0),
        Layout(_messages(view, width - 4, messages - 2), name="messages", visible=messages >= _MIN_MESSAGES),
        Layout(Group(*keys), name="keys", size=len(keys)),
    ]
    layout = Layout()
    layout.split_column(*parts)
    layout["body"].split_row(Layout(_interaction(view), ratio=3), Layout(_borders(view, body - 2), ratio=2))
    return _Printable(layout)


def _head(view: ConsoleContent, now: float) -> Text:
    state = view.state
    if state is None:
        return Text(view.words("console_waiting_manager"), style="bold yellow")
    text = Text(no_wrap=True)
    if state.stopped:
        # before everything else: on a narrow terminal the end of the line is cut
        text.append(f" {view.words('console_stopped')} ", style="bold white on red not reverse")
        if state.stopped_by:
            text.append(f" {view.words('console_stopped_by', who=state.stopped_by)} ", style="bold red not reverse")
    shown = STATES.get(state.name, DEFAULT)
    text.append(f" {view.words('state_' + state.name).upper()} ", style=f"bold reverse {shown.color}")
    if state.interaction_id:
        text.append(f"  {_clock(state.guide_s + state.border_s + state.seed_s)}", style="bold not reverse")
    if state.interaction_id:
        text.append(f"  {view.words('console_interaction')} {state.interaction_id}", style="dim not reverse")
    if state.confirm_save:
        text.append("  " + view.words("console_confirm"), style="bold yellow not reverse")
    if not state.ends_at.is_zero():
        left = _clock(state.ends_at.to_sec() - now)
        text.append("  " + view.words("console_ends_in", time=left), style="bold yellow not reverse")
    return text


def _interaction(view: ConsoleContent) -> Panel:
    say, drawn, state = view.words, view.drawn, view.state or InteractionState()
    guide, border, seed = (f"{seconds:.1f}" for seconds in (state.guide_s, state.border_s, state.seed_s))
    chain = view.sentence(drawn) if drawn.code not in ("", "ok") else say("console_none")
    if drawn.chain:
        chain = say("console_polygon" if drawn.closed else "console_curve", points=len(drawn.chain))
    seeing = ", ".join(drawn.cameras_seeing_spot) or say("console_nobody")
    before = [camera for camera in drawn.cameras if camera not in drawn.cameras_seeing_spot]
    if before:
        seeing = say("console_seen_of", now=seeing, before=", ".join(before))
    rows: Dict[str, Text] = {
        "console_time": Text(say("console_times", guide=guide, border=border, seed=seed)),
        "console_spots": Text(
            say("console_spot_counts", border=drawn.border_spots, seed=drawn.seed_spots, ignored=drawn.ignored_spots)
        ),
        "console_chain": Text(chain),
        "console_seen_by": Text(seeing, style="bold green" if drawn.cameras_seeing_spot else ""),
    }
    table = Table.grid(padding=(0, 2), expand=True)
    # a long value must not take the labels' room
    table.add_column(style="dim", no_wrap=True, min_width=max(len(say(label)) for label in rows))
    table.add_column(no_wrap=True, overflow="ellipsis", ratio=1)
    for label, value in rows.items():
        table.add_row(Text(say(label)), value)
    return Panel(table, title=say("console_interaction"), padding=(0, 1))


def _borders(view: ConsoleContent, room: int) -> Panel:
    lines: List[RenderableType] = []
    for row in view.borders[-room:]:  # the newest are at the end
        details = f" {row.area_m2:.2f} m\u00b2"
        if row.occupancy < 1.0:
            details += f" {row.occupancy:.0%}"
        if not row.enabled:
            details += " " + view.words("console_off")
        line = Table.grid(expand=True)
        line.add_column(no_wrap=True, overflow="ellipsis", ratio=1)
        line.add_column(no_wrap=True, justify="right")
        style = "" if row.enabled else "dim"
        line.add_row(
            Text(sentences.border_name(row.name, view.language) or row.id, style=style), Text(details, style=style)
        )
        lines.append(line)
    return Panel(
        Group(*(lines or [Text(view.words("console_none"), style="dim")])),
        title=view.words("console_borders", count=len(view.borders)),
        padding=(0, 1),
    )


def _preview(view: ConsoleContent, width: int) -> Panel:
    preview = view.preview
    good, text = preview.available and preview.success, view.sentence(preview)
    if good:
        text = view.words("preview_restricts", area=f"{preview.area_m2:.2f}")
        if preview.free_parts > 1:
            text += " " + view.words("preview_parts", parts=preview.free_parts)
    lines = [Text(line, style=GOOD if good else BAD) for line in _wrapped(text, width)] if text else []
    for issue in preview.issues:
        what, style = view.sentence(issue), "bold red" if issue.severity == BorderIssue.ERROR else BAD
        if what not in text:
            lines += [Text(line, style=style) for line in _wrapped(f"! {what}", width)]
    if not lines:
        lines = [Text(view.words("console_nothing_to_save"), style="dim")]
    return Panel(Group(*lines[: _PREVIEW - 2]), title=view.words("console_save_now"), padding=(0, 1))


_SEVERITY = {Severity.INFO: NOTE, Severity.WARNING: "bold " + BAD, Severity.ERROR: "bold red"}


def _messages(view: ConsoleContent, width: int, room: int) -> Panel:
    pinned: List[Text] = []
    for notice in view.notices:
        style = _SEVERITY.get(notice.severity, "bold red")
        pinned += [Text(line, style=style) for line in _wrapped(f"! {notice.sentence(view.language)}", width)]
    # current notices are pinned, but leave half the room to the latest messages
    pinned = pinned[: max(1, room // 2)]
    lines: List[Text] = []
    for clock, text, style in view.messages:
        for number, line in enumerate(_wrapped(f"{clock} {text}", width)):
            if number == 0:
                lines.append(Text.assemble((clock, "dim"), (line[len(clock) :], style)))
            else:
                lines.append(Text(line, style=style))
    left = room - len(pinned)
    return Panel(
        Group(*pinned, *(lines[-left:] if left > 0 else [])), title=view.words("console_messages"), padding=(0, 1)
    )


def _wrapped(text: str, width: int) -> List[str]:
    return textwrap.wrap(text, max(10, width), subsequent_indent="  ") or [""]


def _keys(view: ConsoleContent, width: int) -> List[Text]:
    available = view.state.available_commands if view.state is not None else ()
    keys = []
    for key, command in COMMAND_KEYS.items():
        sensible, shown = command in available, view.words("console_space") if key == " " else key
        style = ("bold reverse", "bold") if sensible else ("reverse dim", "dim")
        keys.append(Text.assemble((f" {shown} ", style[0]), (f" {view.words('command_' + command)} ", style[1])))
    keys.append(Text.assemble((f" {QUIT_KEY} ", "reverse"), f" {view.words('console_quit')} "))
    lines = [Text(no_wrap=True)]
    for text in keys:
        if lines[-1].cell_len + text.cell_len > width:
            lines.append(Text(no_wrap=True))
        lines[-1].append_text(text)
    return lines


def _clock(seconds: float) -> str:
    whole = max(0, int(seconds))
    return f"{whole // 60}:{whole % 60:02d}"
