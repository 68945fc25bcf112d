"""Renders the wizard console's screen, and maps its keys to commands. Needs the messages, but no node.

Each key is one command, each event is one line, and the current state is shown below the last line. Borders are not
shown here, because the page and the smart display show them on the map.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any, Dict, List, Optional, Tuple

from rich.columns import Columns
from rich.console import RenderableType
from rich.text import Text

from vb_core import sentences
from vb_core.interaction_tables import COMMANDS, DEFAULT, STATES, STOP
from vb_core.notices import Notice, Severity
from vb_core.ros.messages import sentence_in
from vb_msgs.msg import BorderIssue, BorderPreview, BorderProgress, InteractionState

OK_STYLE, WARNING_STYLE, INFO_STYLE, ERROR_STYLE = "green", "yellow", "cyan", "bold red"
COMMAND_KEYS: Dict[str, str] = {command.key: name for name, command in COMMANDS.items()}
SEVERITY_STYLES = {Severity.INFO: INFO_STYLE, Severity.WARNING: WARNING_STYLE, Severity.ERROR: ERROR_STYLE}
QUIT_KEY = "q"
_IN_STATE_LINE = ("stopped", "interaction_ends_soon")  # notices that the state line already shows
_SEQUENCE = re.compile("\x1b(\\[[0-?]*[ -/]*[@-~]|O.|)")
_CONTROLS = dict.fromkeys([*range(0x20), *range(0x7F, 0xA0)])


def extract_keys(typed: str) -> str:
    """Returns the keys in terminal input. Arrow and function keys are left out, whose sequences may end with a letter."""
    return _SEQUENCE.sub("", typed)


def safe_text(text: str, style: str = "") -> Text:
    """Returns a text without control characters, which names and sentences from other programs may contain."""
    return Text(text.translate(_CONTROLS), style)


@dataclass
class ConsoleContent:
    """The newest messages, and the language in which they are shown."""

    state: Optional[InteractionState] = None  # None while no message arrives from the interaction manager
    progress: BorderProgress = field(default_factory=BorderProgress)
    preview: BorderPreview = field(default_factory=BorderPreview)
    notices: Tuple[Notice, ...] = ()  # the most severe first
    language: str = sentences.ENGLISH

    def translate(self, code: str, **values: Any) -> str:
        """Returns the text with a code in the operator's language."""
        return sentences.translate(code, values, self.language)

    def lines(self, now: float = 0.0) -> List[RenderableType]:
        """Renders the content at a ROS time [s]: state, drawing, keys, preview and notices, each sentence only once."""
        style_by_sentence = dict(self._preview())
        for notice in self.notices:
            if self.state is None or notice.code not in _IN_STATE_LINE:
                style_by_sentence.setdefault(f"! {notice.sentence(self.language)}", SEVERITY_STYLES[notice.severity])
        sentence_lines = [safe_text(sentence, style) for sentence, style in style_by_sentence.items()]
        return [self._state_line(now), self._keys(), *sentence_lines]

    def _state_line(self, now: float) -> Text:
        """Renders the first line: a stop, the state, its duration, the spots so far, and what people should do soon."""
        state = self.state
        progress = self.progress
        if state is None:
            return safe_text(self.translate("console_waiting_manager"), "bold yellow")
        text = Text()
        if state.stopped:
            text.append(f" {self.translate('console_stopped')} ", "bold white on red")
            text.append_text(safe_text(f" {state.stopped_by} ", "bold red"))
        color = STATES.get(state.name, DEFAULT).color
        text.append(f" {self.translate('state_' + state.name).upper()} ", f"reverse {color}")
        if state.interaction_id:
            text.append(f"  {_clock(state.guide_s + state.border_s + state.seed_s)}")
        if state.interaction_id and state.interaction_id == progress.interaction_id:
            counts = {"border": progress.border_spots, "seed": progress.seed_spots, "ignored": progress.ignored_spots}
            text.append(f"  {self.translate('console_spots', **counts)}")
            text.append_text(safe_text("  " + ", ".join(progress.cameras_seeing_spot), "bold green"))
        if state.confirm_save:
            text.append("  " + self.translate("console_confirm"), "bold yellow")
        if not state.ends_at.is_zero():
            time_left = _clock(state.ends_at.to_sec() - now)
            text.append("  " + self.translate("console_ends_in", time=time_left), "bold yellow")
        return text

    def _preview(self) -> List[Tuple[str, str]]:
        """Returns (sentence, style) for the effect of saving, then for each issue that this sentence does not contain."""
        preview = self.preview
        can_save = preview.available and preview.success
        sentence = sentence_in(preview, self.language)
        if can_save:
            sentence = self.translate("preview_restricts", area=f"{preview.area_m2:.2f}")
            if preview.free_parts > 1:
                sentence += " " + self.translate("preview_parts", parts=preview.free_parts)
        style = OK_STYLE if can_save else WARNING_STYLE
        lines = [(sentence, style)] if sentence else []
        for issue in preview.issues:
            text = sentence_in(issue, self.language)
            style = ERROR_STYLE if issue.severity == BorderIssue.ERROR else WARNING_STYLE
            if text not in sentence:
                lines.append((f"! {text}", style))
        return lines

    def _keys(self) -> Columns:
        # a stop needs no manager
        available = self.state.available_commands if self.state is not None else (STOP,)
        keys = [(key, "command_" + command, command in available) for key, command in COMMAND_KEYS.items()]
        columns = []
        for key, code, is_available in [*keys, (QUIT_KEY, "console_quit", True)]:
            style = "" if is_available else "dim"
            name = self.translate("console_space") if key == " " else key
            columns.append(Text(f" {name} ", f"reverse {style}") + Text(f" {self.translate(code)}", style))
        return Columns(columns)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(max(0, int(seconds)), 60)
    return f"{minutes}:{rest:02d}"
