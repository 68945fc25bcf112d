"""Draws representative maps, coloured as in the paper's figure of the accuracy (Sect. 5.8.4)."""
from __future__ import annotations

from typing import List, Optional, Tuple

import cv2
import numpy as np

from vb_core.errors import CodedError
from vb_core.grid_map import OCCUPIED_FROM, GridMap
from vb_core.map_files import read_map
from vb_evaluation import metrics
from vb_evaluation.report.data import RUNS, Row, Study, number
from vb_evaluation.report.paper import method_title

# RGB, the paper's colours
TRUTH, AGREEMENT, EXCESS, UNION = (247, 214, 70), (64, 176, 88), (222, 60, 50), (25, 60, 220)
FREE, OCCUPIED, UNKNOWN = (255, 255, 255), (0, 0, 0), (176, 176, 176)
LEAST_WIDTH_PX = 640
PINHOLE_CELLS = 40


def picture(prior: GridMap, truth: np.ndarray, drawn: Optional[np.ndarray] = None,
            start: Optional[Tuple[float, float, float]] = None) -> bytes:
    """A PNG of a ground truth, or of what a person restricted against it.

    Args:
        prior: the physical map.
        truth: (H, W) bool.
        drawn: (H, W) bool, what was restricted; None draws the ground truth in yellow.
        start: the robot's start pose [m, m, rad], a red arrow.
    """
    colors = np.full((*prior.shape, 3), UNKNOWN, np.uint8)
    colors[(prior.data >= 0) & (prior.data < 50)] = FREE
    if drawn is None:
        colors[truth] = TRUTH
    else:
        colors[truth & drawn] = AGREEMENT
        colors[drawn & ~truth] = EXCESS
    colors[prior.data >= OCCUPIED_FROM] = OCCUPIED
    scale = max(1, -(-LEAST_WIDTH_PX // prior.shape[1]))
    image = cv2.resize(colors, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    if drawn is not None:
        union = cv2.resize(_without_pinholes(truth | drawn), None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
        # outside of the union: what was drawn wrongly is often one cell wide and must not be hidden
        image[(cv2.dilate(union, np.ones((5, 5), np.uint8)) > 0) & (union == 0)] = UNION
    if start is not None:
        _arrow(image, prior, start, scale)
    _, content = cv2.imencode(".png", image[::-1, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return content.tobytes()


def _without_pinholes(area: np.ndarray) -> np.ndarray:
    """(H, W) uint8: an area with its small holes filled, the feet of furniture."""
    filled = area.astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(1 - filled, connectivity=4)
    small = np.flatnonzero(stats[:, cv2.CC_STAT_AREA] < PINHOLE_CELLS)
    filled[np.isin(labels, small[small > 0])] = 1
    return filled


def _arrow(image: np.ndarray, prior: GridMap, start: Tuple[float, float, float], scale: int) -> None:
    x, y, yaw = start
    ends = prior.world_to_grid(np.array([[x, y], [x + 0.55 * np.cos(yaw), y + 0.55 * np.sin(yaw)]]))
    (x0, y0), (x1, y1) = np.round((ends + 0.5) * scale).astype(int)
    cv2.arrowedLine(image, (int(x0), int(y0)), (int(x1), int(y1)), EXCESS, 2 * scale, cv2.LINE_AA, tipLength=0.4)


def representatives(study: Study) -> Tuple[List[Tuple[bytes, str]], List[str]]:
    """(pictures, notes): per scenario the ground truth and, by method, the completed run nearest to the median.

    A picture is a PNG and its caption. Notes say why a map is missing or does not agree with runs.csv.
    """
    pictures: List[Tuple[bytes, str]] = []
    notes: List[str] = []
    try:
        prior = read_map(study.folder / "maps" / "physical.yaml")
    except CodedError as error:
        return [], [f"There are no maps: {error.message}."]
    start = study.meta.get("robot_start")
    for scenario in study.scenarios:
        title = study.scenario_title(scenario)
        try:
            truth = metrics.restricted_cells(prior, read_map(study.folder / "maps" / f"truth_{scenario}.yaml"))
            pictures.append((picture(prior, truth, start=tuple(start) if start else None), f"{title}: ground truth"))
            for method in study.methods:
                chosen = nearest_to_median(study, scenario, method)
                if chosen is None:
                    notes.append(f"{scenario}, {method}: no completed run has a map.")
                    continue
                line, row = chosen
                drawn = metrics.restricted_cells(prior, read_map(study.folder / row["map"]))
                score, said = metrics.jaccard(truth, drawn), number(row, "jaccard")
                if abs(score - said) > 0.0006:
                    notes.append(f"{RUNS}, line {line}: the map {row['map']} gives a Jaccard index of {score:.3f}, the line says {said:.3f}.")
                pictures.append((picture(prior, truth, drawn), f"{title}: {method_title(method).lower()}, Jaccard {score:.3f}, line {line}"))
        except CodedError as error:
            notes.append(f"{scenario}: {error.message}.")
    return pictures, notes


def nearest_to_median(study: Study, scenario: str, method: str) -> Optional[Tuple[int, Row]]:
    """(line, row) of the completed run with a map whose Jaccard index is nearest to the median, or None."""
    table = study.runs.select(scenario=scenario, method=method, completed=1)
    values = [number(row, "jaccard") for row in table.rows]
    known = [value for value in values if np.isfinite(value)]
    candidates = [
        (abs(value - float(np.median(known))), line, row)
        for value, line, row in zip(values, table.lines, table.rows)
        if np.isfinite(value) and row.get("map") and (study.folder / row["map"]).is_file()
    ]
    if not candidates:
        return None
    _, line, row = min(candidates, key=lambda entry: entry[:2])
    return line, row
