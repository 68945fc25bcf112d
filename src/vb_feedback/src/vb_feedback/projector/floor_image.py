"""The projector's image on the floor: borders, the growing drawing, the area that saving would restrict. No ROS.

A projector adds light and cannot show dark colours, so only the brighter colours of the display are used. The cameras
see the light too, so nothing in the image may look like a laser spot: lines are long, the seed is a ring, and both are
less bright. Nothing changes near the spot: the newest piece of the drawing is shown only after the spot has moved on.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core.grid_map import GridMap
from vb_core.interaction_tables import DEFAULT
from vb_feedback.display import colors
from vb_feedback.display.colors import Color
from vb_feedback.projector.projector_calibration import ProjectorCalibration, markers
from vb_feedback.display.scene import DisplayedBorder, Drawing

_RESOLUTION = 0.005  # [m] edge of a pixel of the canvas, which is then warped into the projector's image
_LINE_WIDTH, _SEED_RADIUS, _STRIPE_WIDTH = 0.03, 0.15, 0.10  # [m]
# [m] the drawing is left out within this distance of the spot, because new light beside the spot would disturb detectors
_DARK_RADIUS = 0.35
_BITS = 4  # fractional bits of OpenCV's fixed-point coordinates


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
        brightness: 0 .. 1, share of the full light.
    """

    def __init__(self, calibration: ProjectorCalibration, brightness: float = 1.0) -> None:
        self.calibration = calibration
        self._brightness = brightness
        footprint = calibration.footprint()
        self._low = footprint.min(axis=0)
        size = footprint.max(axis=0) - self._low
        columns, rows = np.maximum(2, np.ceil(size / _RESOLUTION)).astype(int)
        # an image that spans a hall is drawn more coarsely, because a projector cannot show so many pixels
        self._scale = 1.0 / _RESOLUTION * min(1.0, 4096.0 / max(columns, rows))  # [px/m] of the canvas
        self._thickness = max(1, int(round(_LINE_WIDTH * self._scale)))
        height, width = [int(count * self._scale * _RESOLUTION) + 1 for count in (rows, columns)]
        self._shape = (height, width, 3)
        pixel = 1.0 / self._scale  # [m]
        x, y = self._low
        canvas_to_floor = np.array([[pixel, 0, x], [0, pixel, y], [0, 0, 1.0]])
        self._canvas_to_image = calibration.matrix @ canvas_to_floor

    def render(self, content: FloorContent) -> np.ndarray:
        """Renders the image: (height, width, 3) uint8 rgb."""
        canvas = np.zeros(self._shape, np.uint8)
        if content.region is not None:
            self._draw_stripes(canvas, content.region)
        for border in content.borders:
            if border.enabled:
                self._draw_line(canvas, border.points, border.closed, colors.VERMILION, 0.45 + 0.35 * border.occupancy)
        cv2.max(canvas, self._render_drawing(content), dst=canvas)
        size = (self.calibration.width, self.calibration.height)
        image = cv2.warpPerspective(canvas, self._canvas_to_image, size, flags=cv2.INTER_LINEAR)
        if content.state != DEFAULT.name:
            tint = self._shade(colors.state_color(content.state), 0.6)
            thickness = max(2, int(0.012 * min(size)))
            cv2.rectangle(image, (0, 0), (size[0] - 1, size[1] - 1), tint, 2 * thickness - 2)
        return image

    # ------------------------------------------------------------- parts
    def _render_drawing(self, content: FloorContent) -> np.ndarray:
        """Draws chain and seed, and then blackens the surroundings of the spot. Borders are not left out there."""
        canvas = np.zeros(self._shape, np.uint8)
        drawn = content.drawing
        if len(drawn.chain) > 1:
            self._draw_line(canvas, drawn.chain, drawn.closed, colors.ORANGE, 0.8)
        if drawn.seed is not None:
            tint = self._shade(colors.blend(colors.SKY_BLUE, colors.WHITE, 0.5), 0.8)
            self._draw_circle(canvas, drawn.seed, _SEED_RADIUS, tint, self._thickness, cv2.LINE_AA)
        if content.spot is not None:
            self._draw_circle(canvas, content.spot, _DARK_RADIUS, (0, 0, 0), -1, cv2.LINE_8)
        return canvas

    def _shade(self, color: Color, level: float) -> Tuple[int, int, int]:
        full = 255.0 * level * self._brightness
        return tuple(int(round(full * share)) for share in color)  # type: ignore[return-value]

    def _to_fixed_point(self, points: Sequence[Sequence[float]]) -> np.ndarray:
        """Converts map coordinates to canvas pixels in OpenCV's fixed-point format."""
        pixels = (np.asarray(points, dtype=float).reshape(-1, 2) - self._low) * self._scale
        return np.clip(np.rint(pixels * (1 << _BITS)), -(2**26), 2**26).astype(np.int32)

    def _draw_line(self, canvas: np.ndarray, points, closed: bool, color: Color, level: float) -> None:
        tint = self._shade(color, level)
        pixels = self._to_fixed_point(points)
        cv2.polylines(canvas, [pixels], closed, tint, self._thickness, cv2.LINE_AA, _BITS)

    def _draw_circle(self, canvas: np.ndarray, center, radius: float, tint, thickness: int, line: int) -> None:
        pixel = tuple(map(int, self._to_fixed_point([center])[0]))
        pixel_radius = int(radius * self._scale * (1 << _BITS))
        cv2.circle(canvas, pixel, pixel_radius, tint, thickness, line, _BITS)

    def _draw_stripes(self, canvas: np.ndarray, region: GridMap) -> None:
        height, width = canvas.shape[:2]
        rows, columns = np.indices((height, width), sparse=True)
        stripe_width = max(1, int(_STRIPE_WIDTH * self._scale))
        is_stripe = (rows - columns) // stripe_width % 2 == 0
        # the affine map from canvas to cells is given by the cells of three neighbouring pixels
        pixels = np.array([[0, 0], [1, 0], [0, 1]])
        first, right, below = region.world_to_grid(self._low + pixels / self._scale)
        canvas_to_cells = np.column_stack([right - first, below - first, first])
        cells = (region.data > 0).astype(np.uint8)
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        is_inside = cv2.warpAffine(cells, canvas_to_cells, (width, height), flags=flags) > 0
        canvas[is_inside & is_stripe] = self._shade(colors.ORANGE, 0.45)


def draw_calibration_image(width: int, height: int, number: int) -> np.ndarray:
    """Draws the markers, (height, width, 3) uint8 rgb. The one to be clicked next, `number` (0 .. 3), is bright."""
    image = np.zeros((height, width, 3), np.uint8)
    arm = int(0.06 * height)
    thickness = max(2, int(0.006 * height))
    centers = np.rint(markers(width, height)).astype(int).tolist()
    for index, (x, y) in enumerate(centers):
        is_next = index == number
        tint = (255, 255, 255) if is_next else (50, 50, 50)
        cv2.line(image, (x - arm, y), (x + arm, y), tint, thickness)
        cv2.line(image, (x, y - arm), (x, y + arm), tint, thickness)
        if is_next:
            cv2.circle(image, (x, y), arm, tint, thickness)
    return image
