"""How much speaks against a candidate being a spot of light.

No single measure parts spots from everything else: a spot on the edge of a table has a weak outline, one that is drawn
fast is long. But a spot is odd in one respect, and the ghost of a moved object in several. So each measure has a usual
range, in which nine of ten spots lie, and a limit, beyond which nothing is a spot. From one to the other a doubt grows
from 0 to 1, doubts add up, and a candidate with more than 1 is refused.
"""
from __future__ import annotations

from typing import TYPE_CHECKING, Dict

import numpy as np

from vb_laser_detect.appearance import Candidate

if TYPE_CHECKING:
    from vb_laser_detect.detector import DetectorParams

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


def _above(value: float, usual: float, limit: float) -> float:
    usual = min(usual, 0.5 * limit) if limit <= usual else usual
    return max(0.0, (value - usual) / max(limit - usual, 1e-6))


def _below(value: float, usual: float, limit: float) -> float:
    usual = 1.1 * limit + 1e-6 if limit >= usual else usual
    return max(0.0, (usual - value) / max(usual - limit, 1e-6))
