"""The projector's image on the floor: borders, the growing drawing, the area that saving would restrict. No ROS.

A projector adds light. Dark colours are invisible, so the palette is the brighter half of the display's. The cameras
see the light too, so nothing in the image looks like a laser spot: lines are long, the seed is a ring, and both are
less bright. Nothing changes near the spot: the drawing's newest piece is shown only after the spot has moved on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.grid_map import GridMap
from vb_core.vocabulary import DEFAULT
from vb_feedback.display import colors
from vb_feedback.display.colors import Color
from vb_feedback.projector.projector_calibration import ProjectorCalibration, markers
from vb_feedback.display.scene import DisplayedBorder, Drawing

# [m] edge of a canvas pixel; the canvas is then warped into the projector's image
_RESOLUTION = 0.005
_LINE, _SEED_RADIUS, _STRIPE = 0.03, 0.15, 0.10  # [m]
# [m] around the spot, where the drawing is left out, because light that grows beside the spot would disturb detectors
_DARK_RADIUS = 0.35
_BITS = 4


@dataclass(frozen=True)
class FloorContent:
    """The content to show.

    Attributes:
        state: name of the interaction's state; active ones get a frame in their colour.
        spot: (x, y) [m] position of the laser spot; None if no camera sees one.
        region: above 0 where saving would restrict the map; None if nowhere. Ignored when contents are compared.
    """

    state: str = DEFAULT.name
    borders: Tuple[DisplayedBorder, ...] = ()
    drawing: Drawing = Drawing()
    spot: Optional[Tuple[float, float]] = None
    region: Optional[GridMap] = field(default=None, compare=False)


class FloorImage:
    """Renders a projector's image.

    Args:
        calibration: calibration of the projector.
        brightness: 0 .. 1, share of the full light.
    """

    def __init__(self, calibration: ProjectorCalibration, brightness: float = 1.0) -> None:
        self.calibration = calibration
        self._brightness = brightness
        footprint = calibration.footprint()
        self._low = footprint.min(axis=0)
        columns, rows = np.maximum(2, np.ceil((footprint.max(axis=0) - self._low) / _RESOLUTION)).astype(int)
        # an image that spans a hall is drawn more coarsely, no finer than the projector can show it
        self._scale = 1.0 / _RESOLUTION * min(1.0, 4096.0 / max(columns, rows))
        self._thickness = max(1, int(round(_LINE * self._scale)))
        self._shape = (int(rows * self._scale * _RESOLUTION) + 1, int(columns * self._scale * _RESOLUTION) + 1)
        to_floor = np.array([[1 / self._scale, 0, self._low[0]], [0, 1 / self._scale, self._low[1]], [0, 0, 1.0]])
        self._to_image = calibration.matrix @ to_floor

    def render(self, content: FloorContent) -> np.ndarray:
        """Renders the image: (height, width, 3) uint8 rgb."""
        canvas = np.zeros((*self._shape, 3), np.uint8)
        if content.region is not None:
            self._draw_stripes(canvas, content.region, colors.ORANGE, 0.45)
        for border in content.borders:
            if border.enabled:
                self._draw_line(canvas, border.points, border.closed, colors.VERMILION, 0.45 + 0.35 * border.occupancy)
        cv2.max(canvas, self._render_drawing(content), dst=canvas)
        size = (self.calibration.width, self.calibration.height)
        image = cv2.warpPerspective(canvas, self._to_image, size, flags=cv2.INTER_LINEAR)
        if content.state != DEFAULT.name:
            tint, thickness = self._shade(colors.state_color(content.state), 0.6), max(2, int(0.012 * min(size)))
            cv2.rectangle(image, (0, 0), (size[0] - 1, size[1] - 1), tint, 2 * thickness - 2)
        return image

    # ------------------------------------------------------------- parts
    def _render_drawing(self, content: FloorContent) -> np.ndarray:
        """Draws chain and seed, which are left out around the spot, unlike borders."""
        canvas, drawn = np.zeros((*self._shape, 3), np.uint8), content.drawing
        if len(drawn.chain) > 1:
            self._draw_line(canvas, drawn.chain, drawn.closed, colors.ORANGE, 0.8)
        if drawn.seed is not None:
            tint = self._shade(colors.blend(colors.SKY_BLUE, colors.WHITE, 0.5), 0.8)
            self._draw_circle(canvas, drawn.seed, _SEED_RADIUS, tint, self._thickness, cv2.LINE_AA)
        if content.spot is not None:
            self._draw_circle(canvas, content.spot, _DARK_RADIUS, (0, 0, 0), -1, cv2.LINE_8)
        return canvas

    def _shade(self, color: Color, level: float) -> Tuple[int, int, int]:
        return tuple(int(round(255.0 * level * self._brightness * share)) for share in color)  # type: ignore[return-value]

    def _fixed_point(self, points: Sequence[Sequence[float]]) -> np.ndarray:
        """Converts map coordinates to canvas pixels in OpenCV's fixed-point format."""
        pixels = (np.asarray(points, dtype=float).reshape(-1, 2) - self._low) * self._scale
        return np.clip(np.rint(pixels * (1 << _BITS)), -(2**26), 2**26).astype(np.int32)

    def _draw_line(self, canvas: np.ndarray, points, closed: bool, color: Color, level: float) -> None:
        tint = self._shade(color, level)
        cv2.polylines(canvas, [self._fixed_point(points)], closed, tint, self._thickness, cv2.LINE_AA, _BITS)

    def _draw_circle(self, canvas: np.ndarray, center, radius: float, tint, thickness: int, line: int) -> None:
        pixel = tuple(map(int, self._fixed_point([center])[0]))
        cv2.circle(canvas, pixel, int(radius * self._scale * (1 << _BITS)), tint, thickness, line, _BITS)

    def _draw_stripes(self, canvas: np.ndarray, region: GridMap, color: Color, level: float) -> None:
        rows, columns = np.indices(canvas.shape[:2], sparse=True)
        is_stripe = ((rows - columns) // max(1, int(_STRIPE * self._scale))) % 2 == 0
        corners = region.world_to_grid(self._low + np.array([[0, 0], [1, 0], [0, 1]]) / self._scale)
        canvas_to_cells = np.column_stack([corners[1] - corners[0], corners[2] - corners[0], corners[0]])
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        cells = (region.data > 0).astype(np.uint8)
        inside = cv2.warpAffine(cells, canvas_to_cells, (canvas.shape[1], canvas.shape[0]), flags=flags) > 0
        canvas[inside & is_stripe] = self._shade(color, level)


def draw_calibration_image(width: int, height: int, number: int) -> np.ndarray:
    """Draws marker `number` (0 .. 3), to be clicked next, bright and the others dim: (height, width, 3) uint8 rgb."""
    image = np.zeros((height, width, 3), np.uint8)
    arm, thickness = int(0.06 * height), max(2, int(0.006 * height))
    for index, (x, y) in enumerate(np.rint(markers(width, height)).astype(int).tolist()):
        level = 255 if index == number else 50
        cv2.line(image, (x - arm, y), (x + arm, y), (level, level, level), thickness)
        cv2.line(image, (x, y - arm), (x, y + arm), (level, level, level), thickness)
        if index == number:
            cv2.circle(image, (x, y), arm, (level, level, level), thickness)
    return image
