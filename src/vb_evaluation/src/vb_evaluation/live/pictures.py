"""Draws the map of a demonstration with the paths before and after the border."""
from __future__ import annotations

from pathlib import Path
from typing import Optional, Tuple

import matplotlib
import numpy as np

from vb_core.grid_map import OCCUPIED_FROM, GridMap
from vb_evaluation.report.charts import BLUE, GREEN, GREY, ORANGE, VERMILION, plt


def before_after(
    path: Path,
    prior: GridMap,
    region: np.ndarray,
    truth: Optional[np.ndarray],
    path_before: np.ndarray,
    path_after: np.ndarray,
    chain: np.ndarray,
    driven: np.ndarray,
    title: str,
) -> None:
    """Draws the map with the planned path before and after the border.

    Args:
        path: the PNG to write.
        prior: the physical map.
        region: (H, W) bool, what the border restricts.
        truth: (H, W) bool, the requested region; None if unknown.
        path_before, path_after: (N, 2) [m]; an empty one means that there is no path.
        driven: (K, 2) [m] what the robot drove with the border in force; empty if it did not.
        chain: (M, 2) [m] the border's chain, with its first point repeated at the end if it is closed.
    """
    figure, axes = plt.subplots(1, 2, figsize=(15, 6.2), sharey=True)
    for axis, way, heading, after in ((axes[0], path_before, "Before", False), (axes[1], path_after, "After", True)):
        _draw_map(axis, prior)
        if after:
            _shade(axis, prior, region, VERMILION, 0.45)
            axis.plot([], [], color=VERMILION, lw=8, alpha=0.45, label="restricted")
            if len(chain):
                axis.plot(chain[:, 0], chain[:, 1], color=VERMILION, lw=2, label="border as drawn")
        if truth is not None:
            axis.contour(*_centres(prior), truth.astype(float), levels=[0.5], colors=[GREEN], linewidths=1.5, linestyles="dashed")
            axis.plot([], [], color=GREEN, ls="--", lw=1.5, label="area that was asked for")
        if after and len(driven):
            axis.plot(driven[:, 0], driven[:, 1], color="black", lw=1.5, ls="--", zorder=7,
                      label=f"driven, {_length(driven):.2f} m")
        if len(way):
            axis.plot(way[:, 0], way[:, 1], color=BLUE, lw=3, label=f"planned way, {_length(way):.2f} m", zorder=5)
            axis.plot(*way[0], marker="o", ms=11, color=BLUE, mec="white", ls="none", label="start", zorder=6)
            axis.plot(*way[-1], marker="*", ms=18, color=ORANGE, mec="black", ls="none", label="goal", zorder=6)
        else:
            axis.text(0.5, 0.5, "no way leads there any more", transform=axis.transAxes, ha="center", va="center",
                      fontsize=15, color="black", bbox=dict(facecolor="white", alpha=0.85, edgecolor=GREY))
        axis.set_title(heading, fontsize=14)
        axis.set_xlabel("x [m]")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.11), ncol=3, frameon=False, fontsize=11)
    axes[0].set_ylabel("y [m]")
    figure.subplots_adjust(left=0.04, right=0.99, top=0.88, bottom=0.2, wspace=0.04)
    figure.suptitle(title, fontsize=16)
    figure.savefig(str(path), dpi=100)
    plt.close(figure)


def _length(way: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def _extent(grid: GridMap) -> Tuple[float, float, float, float]:
    rows, columns = grid.shape
    x, y, _ = grid.origin
    return x, x + columns * grid.resolution, y, y + rows * grid.resolution


def _centres(grid: GridMap) -> Tuple[np.ndarray, np.ndarray]:
    rows, columns = grid.shape
    x, y, _ = grid.origin
    return x + (np.arange(columns) + 0.5) * grid.resolution, y + (np.arange(rows) + 0.5) * grid.resolution


def _draw_map(axis, grid: GridMap) -> None:
    shades = np.full(grid.shape, 0.82)
    shades[(grid.data >= 0) & (grid.data < 50)] = 1.0
    shades[grid.data >= OCCUPIED_FROM] = 0.15
    axis.imshow(shades, cmap="gray", vmin=0, vmax=1, origin="lower", extent=_extent(grid), interpolation="nearest")
    axis.set_aspect("equal")


def _shade(axis, grid: GridMap, mask: np.ndarray, color: str, alpha: float) -> None:
    layer = np.zeros(grid.shape + (4,))
    layer[..., :3] = matplotlib.colors.to_rgb(color)
    layer[..., 3] = mask * alpha
    axis.imshow(layer, origin="lower", extent=_extent(grid), interpolation="nearest")
