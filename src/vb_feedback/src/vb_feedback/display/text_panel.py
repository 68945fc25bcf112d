"""The text on the smart display: a panel to the right of the map, a strip below it. No ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import List, Tuple

from vb_core import sentences
from vb_core.interaction_tables import DEFAULT, STATES
from vb_core.sentences import words_of_name
from vb_feedback.display import colors
from vb_feedback.display.colors import Color
from vb_feedback.display.layout import LINE_SPACING, Layout, fit_texts, text_height, text_width, transliterate
from vb_feedback.display.scene import PLATE, Z_PLATE, Shape, text_shapes

# letter heights in RViz's measure, as shares of the screen's height; docs/explanation/display.md gives minutes of arc
TITLE, COMMAND, CLOCK, NAME, LABEL = 0.125, 0.088, 0.07, 0.062, 0.055
# letter heights of the strip's sentences, of which the largest that fits all sentences is used
TEXT_SIZES = (0.088, 0.08, 0.074, 0.068, 0.062, 0.056, 0.05, 0.045)

MAX_COMMANDS = 4
MAX_CAMERAS = 3


@dataclass(frozen=True)
class PanelNotice:
    """A sentence beside the last answer. A warning is highlighted."""

    text: str
    warning: bool = False


@dataclass(frozen=True)
class PanelContent:
    """The content of the display's text."""

    state: str = ""  # "" if no state is known yet
    elapsed_s: int = 0
    commands: Tuple[str, ...] = ()
    success: bool = True
    message: str = ""
    cameras_seeing_spot: Tuple[str, ...] = ()
    notices: Tuple[PanelNotice, ...] = ()
    stopped: bool = False
    language: str = sentences.ENGLISH

    def translate(self, code: str) -> str:
        """Returns a code's text in the display's language."""
        return sentences.translate(code, {}, self.language)


def text_panel_shapes(layout: Layout, content: PanelContent) -> List[Shape]:
    """Writes state, time, commands and cameras into the panel, the last answer and notices into the strip."""
    return _panel_shapes(layout, content) + _strip_shapes(layout, content)


def _panel_shapes(layout: Layout, content: PanelContent) -> List[Shape]:
    unit, panel = layout.unit, layout.panel
    center = panel.center[0]
    width = panel.width - 0.03 * unit
    shapes: List[Shape] = []

    def line(name: str, text: str, offset: float, share: float, *tints: Color) -> None:
        size = share * unit
        # text that is too wide, such as a long camera name, is shrunk
        text = transliterate(text)
        size *= min(1.0, width / max(text_width(text, size), 1e-9))
        shapes.extend(text_shapes(f"words/{name}", text, center, panel.y1 - offset * unit, size, tints))

    if content.stopped:
        # replaces the state, because a person who wonders why nothing moves reads this first
        position = (center, panel.y1 - 0.08 * unit)
        size = (panel.width - 0.02 * unit, 1.2 * TITLE * unit)
        shapes.append(Shape("words/state/plate", 0, PLATE, (position,), Z_PLATE, size, (colors.YELLOW,)))
        line("state", content.translate("display_stopped"), 0.08, TITLE, colors.BLACK)
    else:
        title = content.translate("state_" + content.state if content.state in STATES else "display_not_ready")
        line("state", title, 0.08, TITLE, colors.state_color(content.state))
    if content.state not in ("", DEFAULT.name):
        line("elapsed", f"{content.elapsed_s // 60}:{content.elapsed_s % 60:02d}", 0.185, CLOCK, colors.PALE)
    if content.commands:
        line("say", content.translate("display_say"), 0.253, LABEL, colors.PALE)
        rows = [words_of_name(command) for command in content.commands]
        rows[MAX_COMMANDS - 1 :] = [", ".join(rows[MAX_COMMANDS - 1 :])]  # the last one is "stop": never left out
        for number, text in enumerate(filter(None, rows)):
            line(f"say/{number}", text, 0.333 + 0.089 * number, COMMAND, colors.WHITE)
    if content.cameras_seeing_spot:
        line("seen", content.translate("display_seen_by"), 0.676, LABEL, colors.PALE)
        names = [transliterate(camera).replace(" ", "_") for camera in content.cameras_seeing_spot]
        tints = [colors.blend(colors.camera_color(camera), colors.WHITE, 0.3) for camera in content.cameras_seeing_spot]
        if len(names) > MAX_CAMERAS:
            names[MAX_CAMERAS - 1 :] = [f"+{len(names) - MAX_CAMERAS + 1}"]
            tints[MAX_CAMERAS - 1 :] = [colors.PALE]
        line("seen/0", " ".join(names), 0.736, NAME, *tints)
    return shapes


def _strip_shapes(layout: Layout, content: PanelContent) -> List[Shape]:
    start = content.translate("display_start" if content.state else "display_waiting_system")
    answer = PanelNotice(transliterate(content.message or start), warning=not content.success)
    notices = [PanelNotice(transliterate(notice.text), notice.warning) for notice in content.notices]
    if all(notice.text != answer.text for notice in notices):  # else it is already shown, as a notice
        notices.insert(0, answer)
    unit, strip = layout.unit, layout.strip
    width, height = strip.width - 0.08 * unit, strip.height - 0.03 * unit
    texts, size = fit_texts([notice.text for notice in notices], [share * unit for share in TEXT_SIZES], width, height)
    x, y = strip.center
    top = y + text_height(sum(text.count("\n") + 1 for text in texts), size) / 2.0
    shapes: List[Shape] = []
    for number, (text, notice) in enumerate(zip(texts, notices)):
        lines = text.count("\n") + 1
        center = top - text_height(lines, size) / 2.0
        top -= LINE_SPACING * lines * size
        name = "words/answer" if number == 0 else f"words/notice/{number}"
        tint = colors.WHITE if number == 0 else colors.SKY_BLUE
        if notice.warning:
            tint = colors.BLACK  # on a bright plate, so that people without colour vision recognise a warning too
            plate = (text_width(text, size) + 0.04 * unit, text_height(lines, size) + (LINE_SPACING - 1.0) * size)
            shapes.append(Shape(f"{name}/plate", 0, PLATE, ((x, center),), Z_PLATE, plate, (colors.YELLOW,)))
        shapes += text_shapes(name, text, x, center, size, (tint,))
    return shapes
