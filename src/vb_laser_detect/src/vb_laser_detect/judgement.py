"""How much speaks against a candidate being a spot of light.

No single measure parts spots from everything else: a spot on the edge of a table has a weak outline, one that is drawn
fast is long. But a spot is odd in one respect, and the ghost of a moved object in several. So each measure has a usual
range, in which nine of ten spots lie, and a limit, beyond which nothing is a spot. From one to the other a doubt grows
from 0 to 1, doubts add up, and a candidate with more than 1 is refused.
"""
from __future__ import annotations

from typing import Callable, Dict, List, Optional, Sequence

import numpy as np

from vb_laser_detect.appearance import Candidate, Region
from vb_laser_detect.detector_params import ALWAYS, BAYER, DetectorParams
from vb_laser_detect.floor_scale import ToFloor, metres_per_pixel

_SMEAR_PX = 3.0
_ONE_MOSAIC = 0.75  # a small spot's colour in one mosaic depends on the places it falls on; see SpotTracker
_AROUND = ("no_end", "object_came", "painted", "scene_busy", "change_nearby")  # what speaks of the surroundings
SATURATED = 0.97  # of the camera's white: from here on the sensor shows no more


def doubts(c: Candidate, p: DetectorParams, white: float = 255.0) -> Dict[str, float]:
    """Each reason to refuse a candidate and its strength: 0 is none, 1 is enough on its own.

    Args:
        white: [grey levels] the most that the camera shows. Not 255 everywhere: video often ends at 235.
    """
    # the longer an outline, the less do noise and the edge of a table under the spot weigh in it
    size = np.interp(c.diameter, (24.0, 48.0), (0.0, 1.0))
    usual_edge, least_edge = 0.58 + 0.14 * size, p.min_edge + (p.min_edge_large - p.min_edge) * size
    saturated = c.level >= SATURATED * white
    faint = _below(c.peak, 38.0, p.min_peak) if saturated else _below(c.rise, 90.0, p.min_rise_unsaturated)
    return {
        "too_faint": faint,
        "too_dark": _below(c.level, 0.96 * white, p.min_level * white / 255.0),
        "too_long": _above(c.elongation, 1.8, p.max_elongation),
        "not_round": _below(c.compactness, 0.92, p.min_compactness),
        "too_flat": 0.0 if saturated else _above(c.flatness, 0.4, p.max_flatness),
        "no_end": _above(c.surround, 0.14, p.max_surround),
        "no_contrast": _below(c.contrast, 0.5, p.min_contrast),
        "object_left": _below(c.edge, float(usual_edge), float(least_edge)),
        "unlike_surroundings": _below(c.likeness, 0.25, p.min_likeness),
        "object_came": _above(c.darker, 0.04, p.max_darker) + _above(c.contrast, 1.2, p.max_contrast),
        "cut_off": 0.45 * c.cut_off,
        "painted": _above(c.fall, 6.0, 20.0),
        "scene_busy": _above(c.busy, 0.1, p.max_busy),
        "change_nearby": _above(c.neighbours, 30.0, p.max_neighbours),
    }


class Judge:
    """Judges the candidates of one camera's images.

    Attributes:
        to_floor: pixels (N, 2) to the floor [m], for sizes in millimetres. None: they are judged in pixels.
        place_check: a pixel (u, v) to the reason why no spot can be there, or ""; asked last.
        diagonal: [px] of the image.
        white: [grey levels] the most that the camera shows.
        mosaic: whether the images are a Bayer camera's.
    """

    def __init__(self, params: DetectorParams) -> None:
        self.params = params
        self.to_floor: Optional[ToFloor] = None
        self.place_check: Optional[Callable[[float, float], str]] = None
        self.diagonal, self.white, self.mosaic = 0.0, 255.0, False

    def least_chroma(self) -> Optional[float]:
        """How coloured a spot must be in one image; None if this camera's images are not asked for it."""
        asked = self.params.ask_colour
        if asked != ALWAYS and not (asked == BAYER and self.mosaic):
            return None
        return self.params.min_chroma * (_ONE_MOSAIC if self.mosaic else 1.0)

    def metres_in(self, seeds: Sequence[Region]) -> List[Optional[float]]:
        """[m/px] on the floor in the middle of regions; None where the floor, or the camera's pose, is not known."""
        if self.to_floor is None:
            return [None] * len(seeds)
        middles = [((left + right) / 2.0, (top + bottom) / 2.0) for left, top, right, bottom in seeds]
        return metres_per_pixel(self.to_floor, middles)

    def largest(self, metre: Optional[float]) -> float:
        """[px] the largest extent of a spot where a pixel is so long; what is larger, as clothes, is not looked at."""
        p = self.params
        diameter = p.max_diameter_mm / 1e3 / metre + _SMEAR_PX if metre else p.max_diameter_share * self.diagonal
        # one that is drawn quickly is longer
        return diameter * (p.max_elongation if p.max_elongation < 3 else 2.0)

    def refusal_of(self, c: Candidate, metre: Optional[float], expected: bool = False) -> str:
        """Why a measured candidate is no spot, or ""; sets its doubt and confidence.

        Args:
            metre: [m/px] on the floor there.
            expected: a spot was seen until now and must be there: what else changed around it says nothing against it.
        """
        p = self.params
        if c.diameter < p.min_diameter_px:
            return "too_small"
        against = doubts(c, p, self.white)
        if self.to_floor is not None:
            # a person's region may have its middle above the horizon, and the spot on the floor
            metre = metre or metres_per_pixel(self.to_floor, [(c.u, c.v)])[0]
            if metre is None:
                return "off_floor"
            # optics and pixels smear every spot by some pixels, whatever its size
            if (c.diameter - _SMEAR_PX) * metre > p.max_diameter_mm / 1e3:
                return "too_large"
            if c.diameter * metre < p.min_diameter_mm / 1e3:
                return "too_small"
        else:
            against["too_large"] = max(0.0, (c.diameter / (p.max_diameter_share * self.diagonal) - 0.55) / 0.45)
        if expected:
            against = {reason: doubt for reason, doubt in against.items() if reason not in _AROUND}
        doubt = c.doubt = sum(against.values())
        if doubt > 1.0:
            return max(against, key=lambda reason: against[reason])
        # of two without doubts the brighter one is more likely what somebody points at
        c.confidence = (1.0 - 0.7 * doubt) * (0.7 + 0.3 * min(1.0, c.peak / 160.0))
        return self.place_check(c.u, c.v) if self.place_check is not None else ""


def _above(value: float, usual: float, limit: float) -> float:
    usual = min(usual, 0.5 * limit) if limit <= usual else usual
    return max(0.0, (value - usual) / max(limit - usual, 1e-6))


def _below(value: float, usual: float, limit: float) -> float:
    usual = 1.1 * limit + 1e-6 if limit >= usual else usual
    return max(0.0, (usual - value) / max(usual - limit, 1e-6))
