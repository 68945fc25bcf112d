#!/usr/bin/env python3
"""What a person's movement alone costs, and how much more people would have to err to be as inexact as the paper's.

    python3 bench/extraction/hand.py --people 15

The people of the simulated study draw each scenario's border; extraction and integration make the map of it, in the
paper's literal mode and in the default one. Hands: "even" draws straight on the map's line (stroke_scale 0, no marks
beside the map), "people" as in the study, "times 2" and "times 4" with everything by which people and marks are
beside the line that many times as large (marks, margin, aim, tremor, unevenness). The truth, which the paper's
authors drew by hand into their map, is drawn to the walls, or ends one cell (2.5 cm) before them. No camera, robot or
interaction takes part, so that these are the best figures that such hands can get. The first 15 people are those of
`make study`; --first 101 takes other ones.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any, Dict, List, Tuple

import cv2
import numpy as np

from bench.frame import Table, arguments
from vb_core.errors import CodedError
from vb_core.grid_map import FREE
from vb_evaluation import metrics, statistics
from vb_evaluation.study import assumptions, config
from vb_evaluation.study.config import Study
from vb_evaluation.study.runner import personal_scenario
from vb_fusion.extraction import ExtractionParams, extract_border
from vb_map_integration.border import VirtualBorder
from vb_map_integration.integration import integrate
from vb_sim.person.hand import Stroke, Tremor, load_styles
from vb_sim.room import floor_plan
from vb_sim.room.world import Scenario

RATE, NOISE = 25.0, 0.003  # [1/s] of a camera, [m] of its spots
# what people and marks err by, in the study's configuration
ERRORS = (
    "marks/offset",
    "marks/turn",
    "participants/margin",
    "participants/traits/aim_sigma",
    "participants/traits/tremor",
    "participants/traits/stroke_scale",
)
HANDS = {"even": 0.0, "people": 1.0, "times 2": 2.0, "times 4": 4.0}
MODES = {"paper": ExtractionParams.paper(), "robust": ExtractionParams()}


def draw(study: Study, key: str, number: int, real: bool) -> Tuple[np.ndarray, np.ndarray, Scenario]:
    """Points (N, 2) [m] and stamps (N,) [s] of one person's stroke, and the scenario."""
    asked, traits = study.world.scenario(key), study.traits(number)
    grid = floor_plan.physical_map(study.world)
    meant = personal_scenario(study.world, asked, traits, grid, study.marks(number, key)) if real else asked
    model = traits.model if real else replace(traits.model, stroke_scale=0.0)
    rng = np.random.default_rng([study.run_seed(number), *key.encode()])
    style = load_styles()[int(np.random.default_rng([study.run_seed(number), 2]).integers(len(load_styles())))]
    stroke = Stroke(meant.border, asked.closed, model, rng, lambda points: grid.values_at(points) == 0, style)
    tremor, speed = Tremor(model.tremor, model.tremor_band, rng), float(np.mean(model.drawing_speed))
    arc, now, points, stamps = stroke.start, 0.0, [], []
    while arc < stroke.length and now < 200.0:
        points.append(stroke.at(arc) + tremor.at(now) + rng.normal(0.0, NOISE, 2))
        stamps.append(now)
        for _ in range(4):
            arc += speed * stroke.pace(arc) / (4.0 * RATE)
        now += 1.0 / RATE
    return np.array(points), np.array(stamps), asked


def measure(
    study: Study, key: str, points: np.ndarray, stamps: np.ndarray, asked: Scenario, mode: str
) -> Dict[str, float]:
    """Measures what the map has of a stroke; nothing where extraction or integration refused.

    Returns:
        Jaccard index of the restricted floor; *enclosed*: of the area drawn round; *rim*: that against a truth that ends
        before the walls; the mean boundary error [cm].
    """
    prior = floor_plan.physical_map(study.world)
    truth = floor_plan.ground_truth(study.world, asked)
    try:
        chain = extract_border(points, MODES[mode], stamps=None if mode == "paper" else stamps)
        posterior = integrate(prior, VirtualBorder(chain.points, asked.seed, 1.0, chain.closed)).posterior
    except CodedError:
        return {}
    restricted = metrics.restricted_cells(prior, posterior)
    error = metrics.boundary_error(prior, truth, restricted)
    floor = prior.data == FREE
    wanted, drawn_round = (metrics.enclosed(floor, cells & floor, truth) for cells in (truth, restricted))
    # the part of the floor without the cells that touch something else
    inner = cv2.erode(floor.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    return {
        "jaccard": metrics.jaccard(truth, restricted),
        "enclosed": metrics.jaccard(wanted, drawn_round),
        "error_cm": np.nan if error is None else 100.0 * error.mean,
        "rim": metrics.jaccard(wanted & inner, drawn_round),
    }


def summary(found: List[Dict[str, float]]) -> Dict[str, Any]:
    """Computes medians with bootstrap intervals over those that were not refused."""
    drawn = [one for one in found if one]
    row: Dict[str, Any] = {"refused": f"{len(found) - len(drawn)} of {len(found)}"}
    for name, digits in (("jaccard", 3), ("enclosed", 3), ("error_cm", 1), ("rim", 3)):
        values = np.array([one[name] for one in drawn if np.isfinite(one[name])])
        row[name] = statistics.median(values).text(digits) if len(values) else ""
    return row


def main() -> int:
    parser = arguments(__doc__)
    parser.add_argument("--people", type=int, default=15)
    parser.add_argument("--first", type=int, default=1, help="number of the first person")
    parser.add_argument("--scenarios", nargs="+", metavar="KEY", help="only these")
    given = parser.parse_args()
    study, table = config.load(), Table(given.csv)
    for key in given.scenarios or study.design.scenarios:
        for hand, times in HANDS.items():
            erring = study.changed(assumptions.changes(study, dict.fromkeys(ERRORS, times))) if times > 1.0 else study
            numbers = range(given.first, given.first + given.people)
            drawn = [draw(erring, key, number, times > 0.0) for number in numbers]
            for mode in MODES:
                found = [measure(study, key, *one, mode) for one in drawn]
                table.add(scenario=study.world.scenario(key).title, hand=hand, extraction=mode, **summary(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())
