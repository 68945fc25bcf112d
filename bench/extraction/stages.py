#!/usr/bin/env python3
"""Draws the stages of an extraction: of one stroke that has everything: a held spot, a false place, strays, two cameras.

python3 bench/extraction/stages.py docs/images            extraction_stages.png
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np

from bench.extraction.samples import USUAL, beside, held, timed, with_fixed_place
from vb_fusion import extraction

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402


def main() -> int:
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print(__doc__)
        return 2
    stroke = held(timed("L", 4, USUAL.replace(outliers=0.1, bias=0.04)), 0.4, 250, 2, 4)
    stroke = with_fixed_place(stroke, beside(stroke, 0.5, 0.3), 300, "throughout", 1, 4)
    chain = extraction.extract_border(stroke.points, stamps=stroke.stamps, cameras=stroke.cameras)
    ring = np.vstack([chain.points, chain.points[:1]]) if chain.closed else chain.points
    figure, axes = pyplot.subplots(1, 4, figsize=(17, 4.6), sharex=True, sharey=True, constrained_layout=True)
    axes[0].scatter(*stroke.points.T, c=stroke.stamps, s=4, cmap="viridis")
    axes[1].plot(*stroke.points.T, ".", color="0.8", markersize=3)
    axes[1].plot(*chain.stages["cluster"].T, ".", color="tab:green", markersize=3)
    for axis in axes[2:]:
        axis.plot(*chain.stages["placed"].T, ".", color="0.8", markersize=3)
    axes[2].plot(*chain.stages["thinned"].T, ".-", color="tab:red", markersize=5, linewidth=0.8)
    axes[3].plot(*ring.T, "o-", color="tab:blue", markersize=5, linewidth=1.5)
    line = f"stages 3 to 6: {len(chain.points)} vertices, {chain.code}"
    titles = ("all spots, by time", "stage 1: the pointer's", "stage 2: where it was", line)
    (x, y), reach = stroke.truth.mean(axis=0), 1.7
    for axis, title in zip(axes, titles):
        axis.set(
            title=title, aspect="equal", xlim=(x - reach, x + reach), ylim=(y - reach, y + reach), xticks=[], yticks=[]
        )
    file = Path(sys.argv[1]) / "extraction_stages.png"
    figure.savefig(str(file), dpi=90)
    print(file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
