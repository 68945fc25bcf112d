"""Writes a study's maps, and draws representative ones as in the paper's accuracy figure (Sect. 5.8.4)."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Dict, Mapping, Optional, Sequence

import cv2
import numpy as np
import pandas

from vb_core.errors import CodedError
from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_core.map_files import read_map, write_map
from vb_evaluation import metrics
from vb_evaluation.report.paper_results import method_title
from vb_evaluation.report.study_files import StudyResults, select
from vb_evaluation.report.table import Table

# RGB, the paper's colours
TRUTH, AGREEMENT, EXCESS, UNION = (247, 214, 70), (64, 176, 88), (222, 60, 50), (25, 60, 220)
FREE, OCCUPIED, UNKNOWN = (255, 255, 255), (0, 0, 0), (176, 176, 176)
MIN_WIDTH_PX = 640
HOLE = np.ones((7, 7), np.uint8)  # [cells] closes holes: the union's outline does not go round the feet of furniture


def write_truths(folder: Path, physical: GridMap, truths: Mapping[str, np.ndarray]) -> None:
    """Writes the physical map, and ground truths (H, W) bool by scenario, into a study's folder, for map_server."""
    maps = folder / "maps"
    maps.mkdir(parents=True, exist_ok=True)
    write_map(maps / "physical", physical)
    for scenario, truth in truths.items():
        write_map(maps / f"truth_{scenario}", physical.with_data(np.where(truth, np.int8(100), physical.data)))


def plot_map(
    prior: GridMap, truth: np.ndarray, drawn: Optional[np.ndarray] = None, start: Optional[Sequence[float]] = None
) -> bytes:
    """Draws a ground truth, or what a person restricted against it, as a PNG.

    Args:
        prior: the physical map.
        truth: (H, W) bool.
        drawn: (H, W) bool, the restricted cells; None draws the ground truth in yellow.
        start: the robot's start pose [m, m, rad], a red arrow.
    """
    colors = np.full((*prior.shape, 3), UNKNOWN, np.uint8)
    colors[(prior.data >= 0) & (prior.data < 50)] = FREE
    if drawn is None:
        colors[truth] = TRUTH
    else:
        colors[truth & drawn] = AGREEMENT
        colors[drawn & ~truth] = EXCESS
    colors[prior.data >= OCCUPIED_THRESHOLD] = OCCUPIED
    height, width = prior.shape
    scale = max(1, -(-MIN_WIDTH_PX // width))
    size = (width * scale, height * scale)
    image = cv2.resize(colors, size, interpolation=cv2.INTER_NEAREST)
    if drawn is not None:
        closed = cv2.morphologyEx((truth | drawn).astype(np.uint8), cv2.MORPH_CLOSE, HOLE)
        union = cv2.resize(closed, size, interpolation=cv2.INTER_NEAREST)
        # outside the union: a wrongly restricted part is often one cell wide and must not be hidden
        outline = (cv2.dilate(union, np.ones((5, 5), np.uint8)) > 0) & (union == 0)
        image[outline] = UNION
    if start is not None:
        x, y, theta = start
        arrow = np.array([(x, y), (x + 0.55 * np.cos(theta), y + 0.55 * np.sin(theta))])
        ends = np.round((prior.world_to_grid(arrow) + 0.5) * scale).astype(int)
        cv2.arrowedLine(image, *ends.tolist(), EXCESS, 2 * scale, cv2.LINE_AA, tipLength=0.4)
    bgr_from_top = image[::-1, :, ::-1]
    return cv2.imencode(".png", bgr_from_top, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


def maps_table(study: StudyResults) -> Table:
    """Draws representative maps: per scenario the ground truth and, by method, the completed run nearest to the median."""
    text = (
        "Representative maps: the ground truth (yellow), and by method the run nearest to the median: agreement "
        "(green), restricted beyond the ground truth (red), union (blue outline)."
    )
    try:
        prior = read_map(study.folder / "maps" / "physical.yaml")
        rows = [_representatives(study, scenario, prior) for scenario in study.scenarios]
    except CodedError as error:
        rows = [{"": f"There are no maps: {error.message}"}]
    return Table("maps", "Maps", text, rows)


def _representatives(study: StudyResults, scenario: str, prior: GridMap) -> Dict[str, str]:
    """Makes a scenario's row of images in Markdown. A cell says why a map is missing."""
    row = {"Scenario": study.scenario_title(scenario)}
    try:
        truth = metrics.restricted_cells(prior, read_map(study.folder / "maps" / f"truth_{scenario}.yaml"))
        row["Ground truth"] = _image(plot_map(prior, truth, start=study.meta.get("robot_start")), "as asked for")
        for method in study.methods:
            run = nearest_to_median(study, scenario, method)
            if run is None:
                row[method_title(method)] = "No completed run has a map."
                continue
            drawn = metrics.restricted_cells(prior, read_map(study.folder / run["map"]))
            caption = f"Jaccard {metrics.jaccard(truth, drawn):.3f}, line {run.name}"
            row[method_title(method)] = _image(plot_map(prior, truth, drawn), caption)
    except CodedError as error:
        row["Missing"] = error.message
    return row


def _image(png: bytes, caption: str) -> str:
    data = base64.b64encode(png).decode("ascii")
    return f"![{caption}](data:image/png;base64,{data}) {caption}"


def nearest_to_median(study: StudyResults, scenario: str, method: str) -> Optional[pandas.Series]:
    """Finds the row of the completed run, with a map, nearest to the median Jaccard index, or None."""
    runs = select(study.runs, scenario=scenario, method=method, completed=1).dropna(subset=["jaccard"])
    names = runs.get("map", pandas.Series("", runs.index))
    with_map = runs[[bool(name) and (study.folder / name).is_file() for name in names]]
    return with_map.loc[(with_map.jaccard - runs.jaccard.median()).abs().idxmin()] if len(with_map) else None
