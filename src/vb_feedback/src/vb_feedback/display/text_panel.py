"""The text on the smart display: a panel to the right of the map, and a strip below it. No ROS."""

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

# letter heights as RViz measures them, as shares of the screen's height; docs/explanation/display.md has visual angles
TITLE, COMMAND, CLOCK, NAME, LABEL = 0.125, 0.088, 0.07, 0.062, 0.055
# letter heights of the strip's sentences; the largest at which all sentences fit is used
TEXT_SIZES = (0.088, 0.08, 0.074, 0.068, 0.062, 0.056, 0.05, 0.045)

MAX_COMMANDS = 4
MAX_CAMERAS = 3


@dataclass(frozen=True)
class PanelNotice:
    """A sentence that is shown below the last answer. A warning is highlighted."""

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
    """Writes state, time, commands and cameras into the panel, and the last answer and notices into the strip."""
    return _panel_shapes(layout, content) + _strip_shapes(layout, content)


def _panel_shapes(layout: Layout, content: PanelContent) -> List[Shape]:
    unit = layout.unit
    panel = layout.panel
    center = panel.center[0]
    width = panel.width - 0.03 * unit
    shapes: List[Shape] = []

    def write_line(name: str, text: str, offset: float, share: float, *tints: Color) -> None:
        text = transliterate(text)
        size = share * unit
        # letters are smaller if the text would be too wide, such as a long camera name
        size *= min(1.0, width / max(text_width(text, size), 1e-9))
        shapes.extend(text_shapes(f"words/{name}", text, center, panel.y1 - offset * unit, size, tints))

    if content.stopped:
        # stands in place of the state, where people look first when they wonder why nothing moves
        position = (center, panel.y1 - 0.08 * unit)
        size = (panel.width - 0.02 * unit, 1.2 * TITLE * unit)
        shapes.append(Shape("words/state/plate", 0, PLATE, (position,), Z_PLATE, size, (colors.YELLOW,)))
        write_line("state", content.translate("display_stopped"), 0.08, TITLE, colors.BLACK)
    else:
        title_code = "state_" + content.state if content.state in STATES else "display_not_ready"
        write_line("state", content.translate(title_code), 0.08, TITLE, colors.state_color(content.state))
    if content.state not in ("", DEFAULT.name):
        minutes, seconds = divmod(content.elapsed_s, 60)
        write_line("elapsed", f"{minutes}:{seconds:02d}", 0.185, CLOCK, colors.PALE)
    if content.commands:
        write_line("say", content.translate("display_say"), 0.253, LABEL, colors.PALE)
        rows = [words_of_name(command) for command in content.commands]
        rows[MAX_COMMANDS - 1 :] = [", ".join(rows[MAX_COMMANDS - 1 :])]  # none is left out: the last one is "stop"
        for number, text in enumerate(filter(None, rows)):
            write_line(f"say/{number}", text, 0.333 + 0.089 * number, COMMAND, colors.WHITE)
    cameras = content.cameras_seeing_spot
    if cameras:
        write_line("seen", content.translate("display_seen_by"), 0.676, LABEL, colors.PALE)
        names = [transliterate(camera).replace(" ", "_") for camera in cameras]
        tints = [colors.blend(colors.camera_color(camera), colors.WHITE, 0.3) for camera in cameras]
        if len(names) > MAX_CAMERAS:
            names[MAX_CAMERAS - 1 :] = [f"+{len(names) - MAX_CAMERAS + 1}"]
            tints[MAX_CAMERAS - 1 :] = [colors.PALE]
        write_line("seen/0", " ".join(names), 0.736, NAME, *tints)
    return shapes


def _strip_shapes(layout: Layout, content: PanelContent) -> List[Shape]:
    start = content.translate("display_start" if content.state else "display_waiting_system")
    answer = PanelNotice(transliterate(content.message or start), warning=not content.success)
    notices = [PanelNotice(transliterate(notice.text), notice.warning) for notice in content.notices]
    if answer.text not in [notice.text for notice in notices]:
        notices.insert(0, answer)
    unit = layout.unit
    strip = layout.strip
    width, height = strip.width - 0.08 * unit, strip.height - 0.03 * unit
    sizes = [share * unit for share in TEXT_SIZES]
    texts, size = fit_texts([notice.text for notice in notices], sizes, width, height)
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
            tint = colors.BLACK  # on a bright plate, by which people recognise a warning whatever their colour vision
            plate_width = text_width(text, size) + 0.04 * unit
            plate_height = text_height(lines, size) + (LINE_SPACING - 1.0) * size
            plate_size = (plate_width, plate_height)
            shapes.append(Shape(f"{name}/plate", 0, PLATE, ((x, center),), Z_PLATE, plate_size, (colors.YELLOW,)))
        shapes += text_shapes(name, text, x, center, size, (tint,))
    return shapes
