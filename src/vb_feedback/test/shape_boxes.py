"""Which part of the display words and their plates take, and words for it."""

from __future__ import annotations

from vb_feedback.display.layout import Box, text_box
from vb_feedback.display.scene import PLATE, TEXT

COMMANDS = ("save", "define_border", "define_seed", "guide_robot", "cancel")
LONG = "The map integrator refuses this border because it would part the kitchen from the rest of the home, " * 2


def text_boxes(shapes):
    """Returns the boxes of all texts and plates."""
    boxes = []
    for shape in shapes:
        x, y = shape.points[0] if shape.points else (0.0, 0.0)
        if shape.kind == TEXT:
            boxes.append(text_box(shape.text, x, y, shape.size[0]))
        elif shape.kind == PLATE:
            boxes.append(Box.centered(x, y, *shape.size))
    return boxes


def contains(outer, inner, tolerance=1e-9):
    """Returns whether one box is within another."""
    return min(inner.x0 - outer.x0, inner.y0 - outer.y0, outer.x1 - inner.x1, outer.y1 - inner.y1) >= -tolerance
