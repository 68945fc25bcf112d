"""Colours that people with any kind of colour vision can tell apart (Okabe and Ito, 2008)."""

from __future__ import annotations

from typing import Dict, Sequence, Tuple

from vb_core.interaction_tables import STATES

Color = Tuple[float, float, float]


def rgb(red: int, green: int, blue: int) -> Color:
    """Converts components 0 .. 255 to 0 .. 1."""
    return red / 255.0, green / 255.0, blue / 255.0


ORANGE = rgb(230, 159, 0)
SKY_BLUE = rgb(86, 180, 233)
GREEN = rgb(0, 158, 115)
YELLOW = rgb(240, 228, 66)
BLUE = rgb(0, 114, 178)
VERMILION = rgb(213, 94, 0)
PURPLE = rgb(204, 121, 167)
BLACK = rgb(20, 20, 24)
WHITE = rgb(255, 255, 255)
GRAY = rgb(150, 150, 150)
PALE = rgb(200, 205, 212)
CRIMSON = rgb(150, 10, 20)
STOPPED = rgb(255, 0, 0)  # for the LED only; it means the same everywhere

# the lab's cameras are named after colours: each gets the colour of the set that is closest to its name
_NAMED: Dict[str, Color] = {"red": VERMILION, "green": GREEN, "blue": BLUE, "robot": PURPLE}
_OTHERS: Sequence[Color] = (ORANGE, SKY_BLUE, YELLOW, PURPLE, BLUE, GREEN, VERMILION)


def state_color(name: str) -> Color:
    """Returns the colour of a state by its name, or grey for an unknown state."""
    return rgb(*bytes.fromhex(STATES[name].color[1:])) if name in STATES else GRAY


def camera_color(name: str) -> Color:
    """Returns a camera's colour, always the same for the same name."""
    return _NAMED.get(name, _OTHERS[sum(name.encode("utf-8")) % len(_OTHERS)])


def blend(color: Color, towards: Color, share: float) -> Color:
    """Mixes two colours. Share 0 gives the first, 1 the second."""
    share = min(1.0, max(0.0, share))
    return tuple((1.0 - share) * a + share * b for a, b in zip(color, towards))  # type: ignore[return-value]
