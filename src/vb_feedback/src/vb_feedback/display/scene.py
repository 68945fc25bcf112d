"""Builds the smart display's content as plain shapes. No ROS.

Each `..._shapes` function builds one part of the display from plain values. `find_changes` compares all shapes with the
previous ones, so that only changed shapes are sent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from vb_core.geometry import chain_length, resample_chain
from vb_feedback.display import colors
from vb_feedback.display.colors import Color
from vb_feedback.display.layout import Layout, fit_texts, place_labels, place_words, transliterate, text_box

LINES = "lines"
POINTS = "points"
DISC = "disc"
PLATE = "plate"
TEXT = "text"
Key = Tuple[str, int]  # a shape's namespace and number

# [m] heights above the map, from the lowest to the highest; higher shapes hide lower ones
_LEVELS = tuple(0.06 * step for step in range(1, 11))
Z_LABEL, Z_BORDER, Z_NAME, Z_POINTS, Z_CHAIN, Z_SEED, Z_ROBOT, Z_SPOT, Z_PLATE, Z_TEXT = _LEVELS


@dataclass(frozen=True)
class Shape:
    """One marker. Shapes with the same namespace and number replace each other.

    Attributes:
        kind: LINES between each two points, POINTS at all points, or a DISC, PLATE or TEXT at the first point.
        points: (x, y) [m] each.
        size: [m] width of lines, diameter of points or of a disc, (width, height) of a plate, or height of letters.
        colors: one colour for all points, or one per point.
        frame: the frame with which the shape moves, "" for the map frame.
        lifetime: [s] after which the shape expires, 0 for never.
    """

    namespace: str
    number: int
    kind: str
    points: Tuple[Tuple[float, float], ...]
    z: float
    size: Tuple[float, ...]
    colors: Tuple[Color, ...]
    alpha: float = 1.0
    text: str = ""
    frame: str = ""
    lifetime: float = 0.0

    @property
    def key(self) -> Key:
        """The identity of the shape."""
        return self.namespace, self.number


def find_changes(shown: Dict[Key, Shape], shapes: Sequence[Shape]) -> Tuple[List[Shape], List[Key]]:
    """Compares shapes with the shown ones. Returns the new and changed shapes, and the keys of those to be removed.

    A shape with a lifetime always counts as new, because it expires if it is not sent again.
    """
    keys = {shape.key for shape in shapes}
    changed = [shape for shape in shapes if shape.lifetime or shown.get(shape.key) != shape]
    return changed, [key for key in shown if key not in keys]


def as_pairs(points: np.ndarray) -> Tuple[Tuple[float, float], ...]:
    """Converts points (N, 2) to a tuple of (x, y), which can be compared and hashed."""
    return tuple(map(tuple, points.reshape(-1, 2).tolist()))


def line_segments(points: Sequence[Sequence[float]], closed: bool, width: float) -> Tuple[Tuple[float, float], ...]:
    """Splits a chain into segments, each extended by half a line's width so that corners are filled.

    RViz's own line strips taper at sharp corners.

    >>> line_segments([(0, 0), (2, 0)], closed=False, width=0.5)
    ((-0.25, 0.0), (2.25, 0.0))
    """
    chain = np.asarray(points, dtype=float).reshape(-1, 2)
    if closed and len(chain) > 2:
        chain = np.vstack([chain, chain[:1]])
    directions = np.diff(chain, axis=0)
    lengths = np.hypot(*directions.T)[:, None]
    extensions = directions / np.maximum(lengths, 1e-6) * width / 2.0
    starts = chain[:-1] - extensions
    ends = chain[1:] + extensions
    return as_pairs(np.hstack([starts, ends])[lengths[:, 0] > 1e-6])


def dash_outline(outline: Sequence[Sequence[float]], width: float) -> Tuple[Tuple[float, float], ...]:
    """Splits a closed outline into dashes, each a pair of points. Dashes and gaps are about four line widths long."""
    length = chain_length(outline, closed=True)
    if length == 0.0:
        return ()
    dash_count = max(2, int(length / (8.0 * width)))
    return as_pairs(resample_chain(outline, length / (2 * dash_count), closed=True))


def text_shapes(
    namespace: str, text: str, x: float, y: float, size: float, tints: Sequence[Color], z: float = Z_TEXT
) -> List[Shape]:
    """Builds a text centred at (x, y), one shape per word. `tints` has one colour for all words, or one for each."""
    shapes = []
    for number, (word, word_x, word_y) in enumerate(place_words(text, x, y, size)):
        tint = tints[number % len(tints)]
        shapes.append(Shape(namespace, number, TEXT, ((word_x, word_y),), z, (size,), (tint,), text=word))
    return shapes


# ----------------------------------------------------------------- borders
@dataclass(frozen=True)
class DisplayedBorder:
    """A stored border. While it is unconfirmed, `before` outlines the floor that it restricted, `after` what it will."""

    name: str
    points: Tuple[Tuple[float, float], ...]
    closed: bool
    seed: Tuple[float, float]
    occupancy: float = 1.0
    enabled: bool = True
    area_m2: float = 0.0
    before: Tuple[Tuple[float, float], ...] = ()
    after: Tuple[Tuple[float, float], ...] = ()


def border_shapes(layout: Layout, borders: Sequence[DisplayedBorder], disabled_word: str = "off") -> List[Shape]:
    """Draws each border's outline and a label with name and area, or with `disabled_word` if it is disabled."""
    size = 0.055 * layout.unit
    texts = [_label(border, layout, size, disabled_word) for border in borders]
    boxes = [text_box(text, *border.seed, size) for border, text in zip(borders, texts)]
    desired_plates = [box.extend(0.5 * size, 0.3 * size) for box in boxes]
    plates = place_labels(desired_plates, layout.map)
    shapes: List[Shape] = []
    for number, (border, text, plate) in enumerate(zip(borders, texts, plates)):
        shapes += _outline_shapes(border, number, 0.009 * layout.unit)
        plate_size = (plate.width, plate.height)
        shapes.append(Shape("borders/plate", number, PLATE, (plate.center,), Z_LABEL, plate_size, (colors.WHITE,), 0.9))
        tint = colors.BLACK if border.enabled else colors.blend(colors.GRAY, colors.BLACK, 0.3)
        shapes += text_shapes(f"borders/label/{number}", text, *plate.center, size, (tint,), Z_NAME)
    return shapes


def _label(border: DisplayedBorder, layout: Layout, size: float, disabled_word: str) -> str:
    name = transliterate(border.name) or "?"
    # a name wider than 0.45 of the map is wrapped onto two lines, and cut at the end of the second
    (text,), _ = fit_texts([name], (size,), 0.45 * layout.map.width, 2.4 * size)
    if not border.enabled:
        return f"{text}\n{disabled_word}"
    return f"{text}\n{border.area_m2:.2f} m\u00b2" if border.area_m2 > 0 else text


def _outline_shapes(border: DisplayedBorder, number: int, width: float) -> List[Shape]:
    """Draws a border. If it is unconfirmed, also outlines the floor that it restricted (dashed) and will restrict."""
    tint = border_color(border)
    outlines = (
        ("outline", line_segments(border.points, border.closed, width), Z_BORDER, tint),
        ("before", dash_outline(border.before, width), Z_BORDER - 0.02, colors.GRAY),
        ("after", line_segments(border.after, True, width), Z_BORDER - 0.01, tint),
    )
    return [
        Shape(f"borders/{name}", number, LINES, points, z, (width,), (color,))
        for name, points, z, color in outlines
        if points
    ]


def border_color(border: DisplayedBorder) -> Color:
    """Returns the colour of a border: dark red, lighter for a lower occupancy, or grey if it is disabled."""
    if not border.enabled:
        return colors.GRAY
    return colors.blend(colors.CRIMSON, colors.WHITE, 0.55 * (1.0 - border.occupancy))


# ----------------------------------------------------------------- drawing in progress
@dataclass(frozen=True)
class Drawing:
    """The drawing of the current interaction."""

    points: Tuple[Tuple[float, float], ...] = ()
    point_cameras: Tuple[str, ...] = ()
    chain: Tuple[Tuple[float, float], ...] = ()
    closed: bool = False
    seed: Optional[Tuple[float, float]] = None


def drawing_shapes(layout: Layout, drawing: Drawing) -> List[Shape]:
    """Draws the points in their cameras' colours, the chain as it grows, and the seed."""
    unit = layout.unit
    shapes: List[Shape] = []
    if drawing.points:
        tints = tuple(colors.blend(colors.camera_color(name), colors.WHITE, 0.25) for name in drawing.point_cameras)
        size = (0.009 * unit,)
        shapes.append(Shape("drawing/points", 0, POINTS, drawing.points, Z_POINTS, size, tints or (colors.GRAY,)))
    if len(drawing.chain) > 1:
        # because of its dark rim, the line is visible on white floor, on stripes and on walls
        strokes = (("rim", 0.0, 0.014, colors.BLACK), ("chain", 0.02, 0.009, colors.ORANGE))
        for name, height, share, tint in strokes:
            width = share * unit
            line = line_segments(drawing.chain, drawing.closed, width)
            shapes.append(Shape(f"drawing/{name}", 0, LINES, line, Z_CHAIN + height, (width,), (tint,)))
    if drawing.seed is not None:
        rings = ((0.052, colors.BLACK), (0.044, colors.SKY_BLUE), (0.020, colors.BLACK))
        for number, (share, tint) in enumerate(rings):
            z = Z_SEED + 0.015 * number
            size = (share * unit,)
            shapes.append(Shape("drawing/seed", number, DISC, (drawing.seed,), z, size, (tint,)))
    return shapes


# ----------------------------------------------------------------- live spots
@dataclass(frozen=True)
class TrailPoint:
    """A spot that a camera saw at time `stamp` [s]."""

    camera: str
    x: float
    y: float
    stamp: float


FADE_TIME = 1.5  # [s] for which a spot stays visible, so that the eye can follow it
_LIFETIME = 2.0 * FADE_TIME  # [s] after which RViz removes a spot if this node has ended


def spot_shapes(layout: Layout, spots: Sequence[TrailPoint], now: float) -> List[Shape]:
    """Draws each camera's newest spot as a disc, and its earlier spots as a trail that fades to white.

    Args:
        spots: in the order of their times. Spots more than FADE_TIME in the past or the future are left out.
        now: [s].
    """
    trails: Dict[str, List[TrailPoint]] = {}
    for spot in spots:
        if abs(now - spot.stamp) <= FADE_TIME:
            trails.setdefault(spot.camera, []).append(spot)
    shapes = []
    for camera, trail in trails.items():
        tint = colors.camera_color(camera)
        points = tuple((spot.x, spot.y) for spot in trail)
        fading = [0.85 * max(0.0, now - spot.stamp) / FADE_TIME for spot in trail]
        faded_tints = tuple(colors.blend(tint, colors.WHITE, share) for share in fading)
        parts = (
            (f"spots/{camera}/trail", 0, POINTS, points, 0.014, faded_tints),
            (f"spots/{camera}", 0, DISC, points[-1:], 0.036, (colors.BLACK,)),
            (f"spots/{camera}", 1, DISC, points[-1:], 0.028, (tint,)),
        )
        for level, (name, number, kind, positions, share, tints) in enumerate(parts):
            z = Z_SPOT + 0.015 * level
            size = (share * layout.unit,)
            shapes.append(Shape(name, number, kind, positions, z, size, tints, lifetime=_LIFETIME))
    return shapes


def robot_shapes(base_frame: str, number: int, radius: float) -> List[Shape]:
    """Draws a robot's footprint of radius [m] and its heading. They are in the robot's frame, so that tf moves them."""
    arrow_points = np.array([[0.7, 0.0], [-0.4, 0.5], [-0.15, 0.0], [-0.4, -0.5]]) * radius
    width = 0.14 * radius
    arrow = line_segments(arrow_points, True, width)
    center = ((0.0, 0.0),)
    parts = (
        ("rim", DISC, center, 0.0, 2.0 * radius, colors.BLACK),
        ("body", DISC, center, 0.015, 1.7 * radius, colors.YELLOW),
        ("nose", LINES, arrow, 0.03, width, colors.BLACK),
    )
    return [
        Shape(f"robot/{name}", number, kind, points, Z_ROBOT + height, (size,), (tint,), frame=base_frame)
        for name, kind, points, height, size, tint in parts
    ]
