"""Draws the map of a demonstration with the paths before and after the border."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping, Optional

import matplotlib
import numpy as np

from vb_core.geometry import chain_length
from vb_core.grid_map import OCCUPIED_THRESHOLD, GridMap
from vb_evaluation.report.colors import BLUE, GRAY, GREEN, ORANGE, VERMILION

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402  (the backend must be chosen before)

SHADES = {"unknown": (209, 209, 209), "free": (255, 255, 255), "occupied": (38, 38, 38), "restricted": (236, 174, 140)}


def draw_before_after(
    path: Path,
    title: str,
    prior: GridMap,
    region: np.ndarray,
    truth: Optional[np.ndarray],
    lines: Mapping[str, np.ndarray],
) -> None:
    """Draws the map with the planned path before and after the border.

    Args:
        path: the PNG to write.
        prior: the physical map.
        region: (H, W) bool, what the border restricts.
        truth: (H, W) bool, the requested region; None if unknown.
        lines: (N, 2) [m] each: "before" and "after", the planned paths, empty if there is none; "driven", what the robot
            drove with the border in force, empty if it did not; "border", its chain, closed by its first point.
    """
    figure, axes = plt.subplots(1, 2, figsize=(15, 6.2), sharey=True)
    (left, low), (right, high) = prior.corners()[[0, 2]]
    place = {"origin": "lower", "extent": (left, right, low, high)}
    colors = np.full((*prior.shape, 3), SHADES["unknown"], np.uint8)
    colors[(prior.data >= 0) & (prior.data < 50)] = SHADES["free"]
    for axis, name in zip(axes, ("before", "after")):
        if name == "after":
            colors[region] = SHADES["restricted"]
            _draw_border(axis, lines["border"], lines["driven"])
        colors[prior.data >= OCCUPIED_THRESHOLD] = SHADES["occupied"]
        axis.imshow(colors, interpolation="nearest", **place)
        if truth is not None:
            axis.contour(
                truth.astype(float), levels=[0.5], colors=[GREEN], linewidths=1.5, linestyles="dashed", **place
            )
            axis.plot([], [], color=GREEN, ls="--", lw=1.5, label="area that was asked for")
        _draw_plan(axis, lines[name])
        axis.set_title(name.capitalize(), fontsize=14)
        axis.set_xlabel("x [m]")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.11), ncol=3, frameon=False, fontsize=11)
    axes[0].set_ylabel("y [m]")
    figure.subplots_adjust(left=0.04, right=0.99, top=0.88, bottom=0.2, wspace=0.04)
    figure.suptitle(title, fontsize=16)
    figure.savefig(str(path), dpi=100)
    plt.close(figure)


def _draw_border(axis: Any, chain: np.ndarray, driven: np.ndarray) -> None:
    axis.plot([], [], color=np.array(SHADES["restricted"]) / 255, lw=8, label="restricted")
    axis.plot(*chain.T, color=VERMILION, lw=2, label="border as drawn")
    if len(driven):
        label = f"driven, {chain_length(driven):.2f} m"
        axis.plot(*driven.T, color="black", lw=1.5, ls="--", zorder=7, label=label)


def _draw_plan(axis: Any, way: np.ndarray) -> None:
    if len(way):
        axis.plot(*way.T, color=BLUE, lw=3, label=f"planned way, {chain_length(way):.2f} m", zorder=5)
        axis.plot(*way[0], marker="o", ms=11, color=BLUE, mec="white", ls="none", label="start", zorder=6)
        axis.plot(*way[-1], marker="*", ms=18, color=ORANGE, mec="black", ls="none", label="goal", zorder=6)
        return
    box = {"facecolor": "white", "alpha": 0.85, "edgecolor": GRAY}
    words, middle = "no way leads there any more", {"ha": "center", "va": "center", "transform": axis.transAxes}
    axis.text(0.5, 0.5, words, fontsize=15, color="black", bbox=box, **middle)
