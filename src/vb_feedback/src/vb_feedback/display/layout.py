"""The layout of the smart display: the map, a panel to its right, and a strip below it.

The view is a rectangle in the map frame with the screen's aspect ratio. Letter sizes are given as shares of its height,
so that letters have the same size on the screen for any map.
"""

from __future__ import annotations

import unicodedata
from dataclasses import dataclass
from functools import lru_cache
from typing import List, Sequence, Tuple

import numpy as np
from anyascii import anyascii
from PIL import ImageFont

from vb_core.errors import CodedError

PANEL_WIDTH = 0.5  # width of the panel, as a share of the view's height
STRIP_HEIGHT = 0.23  # height of the strip, as a share of the view's height
MAP_MARGIN = 0.015  # free margin around the map, as a share of the view's height
MAX_PANEL_WIDTH = 0.38  # largest width of the panel, as a share of the view's width; limits it on nearly square screens
LINE_SPACING = 1.2  # distance between lines, in letter heights
_USUAL_GAP = 0.1  # gap between two labels, in heights of the label that is moved
_MIN_GAP = 1e-6  # gap between two labels where there is little room, in the same unit
# characters: Latin with all accents, Greek and Cyrillic, punctuation from dashes to the ellipsis, and the euro sign
DRAWABLE_RANGES = ((32, 126), (161, 591), (880, 1279), (8208, 8230), (8364, 8364))


@dataclass(frozen=True)
class Rectangle:
    """A rectangle [m] in the map frame."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> float:
        """[m]"""
        return self.x1 - self.x0

    @property
    def height(self) -> float:
        """[m]"""
        return self.y1 - self.y0

    @property
    def center(self) -> Tuple[float, float]:
        """(x, y) [m]"""
        return (self.x0 + self.x1) / 2.0, (self.y0 + self.y1) / 2.0

    def overlaps(self, other: "Rectangle") -> bool:
        """Returns whether the two share an area. Touching edges do not count."""
        return self.x0 < other.x1 and other.x0 < self.x1 and self.y0 < other.y1 and other.y0 < self.y1

    def extend(self, width: float, height: float) -> "Rectangle":
        """Returns a box with the same centre that is wider and higher by `width` and `height` [m]."""
        return Rectangle.from_center(*self.center, self.width + width, self.height + height)

    @staticmethod
    def from_points(points: np.ndarray) -> "Rectangle":
        """Makes the smallest box that contains points (N, 2) [m]."""
        x0, y0 = np.min(points, axis=0).tolist()
        x1, y1 = np.max(points, axis=0).tolist()
        return Rectangle(x0, y0, x1, y1)

    @staticmethod
    def from_center(x: float, y: float, width: float, height: float) -> "Rectangle":
        """Makes a box from its centre and size [m]."""
        return Rectangle(x - width / 2.0, y - height / 2.0, x + width / 2.0, y + height / 2.0)


@dataclass(frozen=True)
class Layout:
    """The parts of the view, which do not overlap."""

    view: Rectangle
    map: Rectangle
    panel: Rectangle
    strip: Rectangle

    @property
    def unit(self) -> float:
        """[m] the view's height, the unit of letter sizes."""
        return self.view.height


def fit_view(extent: Rectangle, aspect: float) -> Layout:
    """Returns the layout of the smallest view that shows the whole map beside panel and strip.

    Args:
        aspect: the screen's width divided by its height.

    Raises:
        CodedError: "bad_layout" for an empty map, or an aspect that is not 0.5 .. 5.
    """
    panel = min(PANEL_WIDTH / aspect, MAX_PANEL_WIDTH)
    map_width = (1.0 - panel) * aspect - 2.0 * MAP_MARGIN  # of the map's area, as a share of the view's height
    map_height = 1.0 - STRIP_HEIGHT - 2.0 * MAP_MARGIN  # as a share of the view's height
    if extent.width <= 0 or extent.height <= 0:
        raise CodedError("bad_layout", f"the map's extent is {extent.width} m x {extent.height} m")
    if not 0.5 <= aspect <= 5.0:
        raise CodedError("bad_layout", f"the screen's aspect must be 0.5 to 5, got {aspect}")
    height = max(extent.width / map_width, extent.height / map_height)
    width = aspect * height
    x, y = extent.center
    x0 = x - (1.0 - panel) * width / 2.0
    y1 = y + (1.0 - STRIP_HEIGHT) * height / 2.0
    view = Rectangle(x0, y1 - height, x0 + width, y1)
    panel_left = x0 + (1.0 - panel) * width
    strip_top = view.y0 + STRIP_HEIGHT * height
    panel_box = Rectangle(panel_left, strip_top, view.x1, view.y1)
    strip_box = Rectangle(view.x0, view.y0, view.x1, strip_top)
    return Layout(view, extent, panel_box, strip_box)


# ----------------------------------------------------------------- letters
_FONT_FILE = "LiberationSans-Regular.ttf"  # RViz's font; if it is not installed, Pillow's default is about as wide
_MEASURING_SIZE = 1000  # [px] font size at which letters are measured
_SPACE = 0.31  # [font sizes] width of a space between words, which RViz makes too wide, see `place_words`
# font size, as a share of the height of an RViz text marker; measured: 0.83 to 0.84 for words of 4 to 11 letters
_FONT_SHARE = 0.84


def is_drawable(character: str) -> bool:
    """Returns whether RViz can draw a character, if it uses the fonts of `rviz_config.overlay_fonts`."""
    return any(first <= ord(character) <= last for first, last in DRAWABLE_RANGES)


def transliterate(text: str) -> str:
    """Converts a text to characters that RViz can draw. All others are transliterated by anyascii."""
    composed = unicodedata.normalize("NFC", text)
    drawable = "".join(letter if is_drawable(letter) else _transliterate(letter) for letter in composed)
    return " ".join(drawable.split())


def _transliterate(letter: str) -> str:
    kind = unicodedata.category(letter)
    if kind.startswith("M"):
        return ""
    return " " if kind.startswith(("C", "Z")) else anyascii(letter) or "_"


@lru_cache(maxsize=None)
def _font() -> ImageFont.FreeTypeFont:
    try:
        return ImageFont.truetype(_FONT_FILE, _MEASURING_SIZE)
    except OSError:
        return ImageFont.load_default(_MEASURING_SIZE)


@lru_cache(maxsize=2000)
def _width(letter: str) -> float:
    """Measures the advance of a letter, in font sizes. RViz does not use kerning."""
    return _SPACE if letter == " " else _font().getlength(letter) / _MEASURING_SIZE


def text_width(text: str, size: float) -> float:
    """Measures the width [m] of a text's longest line, in letters of `size` [m]."""
    line_widths = [sum(map(_width, line)) for line in text.split("\n")]
    return size * _FONT_SHARE * max(line_widths)


def place_words(text: str, x: float, y: float, size: float) -> List[Tuple[str, float, float]]:
    """Centres a text at (x, y) [m]. Returns each word and the word's centre. Newlines separate lines.

    RViz makes spaces more than twice as wide as they should be, so each word becomes a separate marker.
    """
    lines = text.split("\n")
    placed = []
    for number, line in enumerate(lines):
        left = x - text_width(line, size) / 2.0
        baseline = y + ((len(lines) - 1) / 2.0 - number) * LINE_SPACING * size
        words = line.split(" ")
        for index, word in enumerate(words):
            text_before = " ".join([*words[:index], ""]) if index else ""
            offset = text_width(text_before, size)
            if word:
                placed.append((word, left + offset + text_width(word, size) / 2.0, baseline))
    return placed


def text_box(text: str, x: float, y: float, size: float) -> Rectangle:
    """Returns the box of a text centred at (x, y) [m]. Newlines separate lines."""
    return Rectangle.from_center(x, y, text_width(text, size), text_height(text.count("\n") + 1, size))


def wrap(text: str, size: float, width: float) -> List[str]:
    """Breaks a sentence into lines no wider than `width` [m]. A word wider than that is split."""
    lines: List[str] = []
    for word in text.split():
        while text_width(word, size) > width and len(word) > 1:
            length = len(word) - 1
            while length > 1 and text_width(word[:length], size) > width:
                length -= 1
            lines.append(word[:length])
            word = word[length:]
        if lines and text_width(f"{lines[-1]} {word}", size) <= width:
            lines[-1] = f"{lines[-1]} {word}"
        else:
            lines.append(word)
    return lines


def fit_texts(texts: Sequence[str], sizes: Sequence[float], width: float, height: float) -> Tuple[List[str], float]:
    """Wraps sentences, one below the other, at the largest size [m] at which they fit a box. Returns texts and size.

    If they do not fit even at the last and smallest size, they are shortened, the longest ones first. A shortened
    sentence ends with an ellipsis, and keeps at least one line.
    """
    for size in sizes:
        wrapped = [wrap(text, size, width) for text in texts]
        if text_height(sum(map(len, wrapped)), size) <= height:
            return ["\n".join(lines) for lines in wrapped], size
    max_lines = max(len(texts), int((height / size - 1.0) / LINE_SPACING) + 1)
    line_counts = [len(lines) for lines in wrapped]
    while sum(line_counts) > max_lines:
        line_counts[line_counts.index(max(line_counts))] -= 1
    return [_truncate(lines, count, size, width) for lines, count in zip(wrapped, line_counts)], size


def text_height(lines: int, size: float) -> float:
    """Returns the height [m] of lines of text in letters of `size` [m]."""
    return (1.0 + LINE_SPACING * (lines - 1)) * size


def _truncate(lines: List[str], count: int, size: float, width: float) -> str:
    if count >= len(lines):
        return "\n".join(lines)
    last = lines[count - 1]
    while last and text_width(last + "...", size) > width:
        last = last[:-1]
    return "\n".join([*lines[: count - 1], last.rstrip() + "..."])


def place_labels(desired: Sequence[Rectangle], within: Rectangle) -> List[Rectangle]:
    """Moves labels up or down, as little as needed to be inside a box and, if there is enough room, not to overlap."""
    placed: List[Rectangle] = []
    for box in desired:
        desired_y = box.center[1]
        for gap in (_USUAL_GAP, _MIN_GAP):
            # the nearest room, if there is any, begins at an edge or next to a label: no other heights need to be tried
            heights = [desired_y, within.y0, within.y1]
            for other in placed:
                step = (other.height + box.height) / 2.0 + gap * box.height
                heights += [other.center[1] + step, other.center[1] - step]
            options = [_move_inside(box, y, within) for y in heights]
            free = [option for option in options if not any(map(option.overlaps, placed))]
            if free:
                break
        # if there is no room anywhere, the label stays at the desired height, which is the first option
        candidates = free or options[:1]
        placed.append(min(candidates, key=lambda option: abs(option.center[1] - desired_y)))
    return placed


def _move_inside(box: Rectangle, y: float, within: Rectangle) -> Rectangle:
    """Moves a box to the height y [m] of its centre, and then as little as needed to be inside another box."""
    half_width, half_height = box.width / 2.0, box.height / 2.0
    # a box that is too large touches the left and the lower edge
    x = max(min(box.center[0], within.x1 - half_width), within.x0 + half_width)
    y = max(min(y, within.y1 - half_height), within.y0 + half_height)
    return Rectangle.from_center(x, y, box.width, box.height)
