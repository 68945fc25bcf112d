"""Writes a study's maps, and draws representative ones as in the paper's accuracy figure (Sect. 5.8.4)."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Dict, List, Mapping, Optional

import cv2
import numpy as np
import pandas

from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_core.map_files import read_map, write_map
from vb_evaluation.metrics import restricted_cells
from vb_evaluation.report.study_files import StudyResults, select

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


def plot_map(prior: GridMap, truth: np.ndarray, drawn: Optional[np.ndarray] = None) -> bytes:
    """Draws a ground truth, or what a person restricted against it, as a PNG.

    Args:
        prior: the physical map.
        truth: (H, W) bool.
        drawn: (H, W) bool, the restricted cells; None draws the ground truth in yellow.
    """
    colors = np.full((*prior.shape, 3), UNKNOWN, np.uint8)
    colors[(prior.data >= 0) & (prior.data < 50)] = FREE
    if drawn is None:
        colors[truth] = TRUTH
    else:
        colors[truth & drawn] = AGREEMENT
        colors[drawn & ~truth] = EXCESS
    colors[prior.data >= OCCUPIED_THRESHOLD] = OCCUPIED
    scale = max(1, -(-MIN_WIDTH_PX // prior.shape[1]))
    image = np.kron(colors, np.ones((scale, scale, 1), np.uint8))
    if drawn is not None:
        closed = cv2.morphologyEx((truth | drawn).astype(np.uint8), cv2.MORPH_CLOSE, HOLE)
        union = np.kron(closed, np.ones((scale, scale), np.uint8))
        # outside the union: a wrongly restricted part is often one cell wide and must not be hidden
        outline = (cv2.dilate(union, np.ones((5, 5), np.uint8)) > 0) & (union == 0)
        image[outline] = UNION
    bgr_from_top = image[::-1, :, ::-1]
    return cv2.imencode(".png", bgr_from_top, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()


def draw_maps(study: StudyResults) -> List[Dict[str, str]]:
    """Draws a row of images for each scenario, if there are maps: ground truth, and by method the run nearest to the median."""
    maps = study.folder / "maps"
    if not (maps / "physical.yaml").is_file():
        return []
    prior = read_map(maps / "physical.yaml")
    rows = []
    for scenario, title in study.scenarios.items():
        truth = restricted_cells(prior, read_map(maps / f"truth_{scenario}.yaml"))
        row = {"Scenario": title, "Ground truth": _image(plot_map(prior, truth), "as asked for")}
        for method, heading in study.methods.items():
            run = nearest_to_median(study, scenario, method)
            if run is None:
                row[heading] = "No run was completed."
            else:
                drawn = restricted_cells(prior, read_map(study.folder / run["map"]))
                row[heading] = _image(
                    plot_map(prior, truth, drawn), f"Jaccard {run.jaccard:.3f}, line {run.name} of runs.csv"
                )
        rows.append(row)
    return rows


def _image(png: bytes, caption: str) -> str:
    """Writes an image with its caption in Markdown."""
    return f"![{caption}](data:image/png;base64,{base64.b64encode(png).decode('ascii')}) {caption}"


def nearest_to_median(study: StudyResults, scenario: str, method: str) -> Optional[pandas.Series]:
    """Finds the row of the completed run nearest to the median Jaccard index, or None."""
    runs = select(study.runs, scenario=scenario, method=method, completed=1).dropna(subset=["jaccard"])
    return runs.loc[(runs.jaccard - runs.jaccard.median()).abs().idxmin()] if len(runs) else None
