"""The report's figures as SVG text, drawn without a display."""
from __future__ import annotations

import base64
import io
import math
from typing import Any, Dict, Optional, Sequence, Tuple

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot as plt  # noqa: E402  (the backend must be chosen before)
from matplotlib.lines import Line2D  # noqa: E402

# colours that colour-blind people can distinguish (Okabe and Ito)
BLUE, ORANGE, GREEN, VERMILION, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#666666"
SKY, PURPLE = "#56B4E9", "#CC79A7"
STATE_COLORS = {"guide": ORANGE, "border": SKY, "seed": GREEN}
# as in the paper: blue and red contours distinguish the methods
METHOD_COLORS = {"nrs": BLUE, "robot_only": VERMILION}
SERIES = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, GREY)
MARKERS = ("o", "s", "^", "D", "v", "P")
WIDTH_IN, PANEL_IN = 7.2, 4.6

_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "axes.axisbelow": True,
    "svg.fonttype": "path",
    "svg.hashsalt": "study",
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
}


def color_of(method: str, index: int) -> str:
    """A method's colour everywhere in the report."""
    return METHOD_COLORS.get(method, SERIES[2 + index % (len(SERIES) - 2)])


def time_bars(
    bars: Sequence[Tuple[str, str, Dict[str, float], np.ndarray]], limit_s: float
) -> str:
    """The paper's bars of interaction time, one per method, stacked by state.

    Args:
        bars: (method, title, mean seconds by state, total seconds of each run).
        limit_s: end of the axis, the same for all scenarios.
    """
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(WIDTH_IN, 0.75 + 0.62 * len(bars)))
        for place, (method, _, states, totals) in enumerate(bars):
            left = 0.0
            for state, seconds in states.items():
                axis.barh(
                    place, seconds, left=left, height=0.44, color=STATE_COLORS[state], edgecolor="white", linewidth=0.5
                )
                if seconds > 0.05 * limit_s:
                    axis.text(left + seconds / 2, place, f"{seconds:.1f}", ha="center", va="center", fontsize=9)
                left += seconds
            axis.barh(place, left, height=0.44, fill=False, edgecolor=color_of(method, place), linewidth=2)
            axis.plot(
                totals, np.full(len(totals), place + 0.34), "|", ms=6, color=color_of(method, place), alpha=0.8, mew=1.2
            )
        axis.set_yticks(range(len(bars)))
        axis.set_yticklabels([title for _, title, _, _ in bars])
        axis.set_ylim(len(bars) - 0.5, -0.5)
        axis.set_xlim(0.0, limit_s)
        axis.grid(axis="y", visible=False)
        axis.set_xlabel("interaction time [s]; a stroke is one run")
        return _svg(figure)


def boxes(groups: Sequence[Tuple[str, str, np.ndarray, Optional[float]]], label: str) -> str:
    """Boxplots with every value beside the box and the paper's median as a diamond.

    Args:
        groups: (method, title, values, the paper's median or None).
    """
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(PANEL_IN, 3.3))
        for place, (method, _, values, published) in enumerate(groups):
            color = color_of(method, place)
            if len(values):
                drawn = axis.boxplot([values], positions=[place], widths=0.36, showfliers=False, patch_artist=True)
                for part in drawn["boxes"]:
                    part.set(facecolor=color, alpha=0.25, edgecolor=color)
                for part in drawn["medians"]:
                    part.set(color=color, linewidth=2.2)
                for part in drawn["whiskers"] + drawn["caps"]:
                    part.set(color=color)
                spread = np.linspace(-0.06, 0.06, len(values)) if len(values) > 1 else np.zeros(1)
                axis.plot(place + 0.31 + spread, values, "o", ms=3, color=color, alpha=0.7, mew=0)
            if published is not None:
                axis.plot(place - 0.3, published, "D", ms=7, color="white", mec="black", mew=1.3)
        axis.set_xticks(range(len(groups)))
        axis.set_xticklabels([title for _, title, _, _ in groups])
        axis.set_xlim(-0.6, len(groups) - 0.4)
        axis.grid(axis="x", visible=False)
        axis.margins(y=0.08)
        axis.set_ylabel(label)
        return _svg(figure)


def rates(groups: Sequence[Tuple[str, Sequence[Tuple[str, str, float, float, float, Optional[float]]]]]) -> str:
    """Success rates as bars with intervals.

    Args:
        groups: (scenario's title, bars of (method, title, share, low, high, the paper's share or None)).
    """
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(WIDTH_IN, 3.0))
        named = set()
        width = 0.8 / max(1, max((len(bars) for _, bars in groups), default=1))
        for place, (_, bars) in enumerate(groups):
            for index, (method, title, share, low, high, published) in enumerate(bars):
                x = place + (index - (len(bars) - 1) / 2) * width
                color = color_of(method, index)
                axis.bar(
                    x, 100 * share, width * 0.86, color=color, alpha=0.75, label=title if title not in named else None
                )
                if math.isfinite(low) and math.isfinite(high):
                    axis.plot([x, x], [100 * low, 100 * high], color="#222222", lw=1.2)
                if published is not None:
                    axis.plot(
                        x,
                        100 * published,
                        "D",
                        ms=7,
                        color="white",
                        mec="black",
                        mew=1.3,
                        label="the paper" if "the paper" not in named else None,
                    )
                    named.add("the paper")
                named.add(title)
        axis.set_xticks(range(len(groups)))
        axis.set_xticklabels([title for title, _ in groups])
        axis.set_ylim(0, 104)
        axis.set_ylabel("completed [%]")
        axis.grid(axis="x", visible=False)
        figure.legend(loc="outside upper center", ncol=3, fontsize=9)
        return _svg(figure)


def lines(
    series: Sequence[
        Tuple[
            str, Sequence[float], Sequence[float], Optional[Sequence[float]], Optional[Sequence[float]], Dict[str, Any]
        ]
    ],
    x_label: str,
    y_label: str,
    level: Optional[float] = None,
) -> str:
    """Curves with bands.

    Args:
        series: (name, x, y, low, high, style with color, marker, linestyle); values that are not finite are omitted.
            A name "group, kind" appears in the legend as a colour for its group and a line style for its kind.
        level: a horizontal line to be compared with.
    """
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(PANEL_IN, 3.3))
        if level is not None:
            axis.axhline(level, color="#444444", lw=1, ls=":")
        ticks = sorted({float(value) for _, x, _, _, _, _ in series for value in x})
        for _, x, y, low, high, style in series:
            x, y = np.asarray(x, float), np.asarray(y, float)
            axis.plot(x, y, ms=5, lw=1.8, **style)
            if low is not None and high is not None:
                axis.fill_between(
                    x, np.asarray(low, float), np.asarray(high, float), color=style.get("color"), alpha=0.13, lw=0
                )
        if ticks and len(ticks) <= 8:
            axis.set_xticks(ticks)
            # a number that would touch the previous one is omitted
            room, last, labels = 0.07 * (ticks[-1] - ticks[0]), -math.inf, []
            for tick in ticks:
                labels.append(f"{tick:.3g}" if tick - last > room else "")
                last = tick if labels[-1] else last
            axis.set_xticklabels(labels)
        axis.set_xlabel(x_label)
        axis.set_ylabel(y_label)
        handles = {}
        for name, _, _, _, _, style in series:
            group, _, kind = name.partition(", ")
            handles.setdefault(group, Line2D([], [], color=style["color"], marker=style["marker"], ms=5, lw=1.8))
            if kind:
                handles.setdefault(kind, Line2D([], [], color="#222222", ls=style["linestyle"], lw=1.5))
        figure.legend(
            list(handles.values()),
            list(handles),
            loc="outside upper center",
            ncol=min(3, max(1, len(handles))),
            fontsize=8.5,
        )
        return _svg(figure)


def rank_bars(rows: Sequence[Tuple[str, float, float, float]], label: str, noise: float) -> str:
    """Correlations with their intervals, drawn from top to bottom.

    Args:
        rows: (name, correlation, low, high).
        noise: band about 0 that the largest of as many correlations of pure chance stays in.
    """
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(WIDTH_IN, 1.0 + 0.3 * len(rows)))
        axis.axvspan(-noise, noise, color="#dddddd", alpha=0.6, lw=0)
        for place, (_, value, low, high) in enumerate(rows):
            axis.barh(place, value, height=0.55, color=ORANGE if value > 0 else SKY)
            axis.plot([low, high], [place, place], color="#222222", lw=1.2)
        axis.axvline(0.0, color="#222222", lw=1)
        axis.set_yticks(range(len(rows)))
        axis.set_yticklabels([name for name, *_ in rows], fontsize=8.5)
        axis.set_ylim(len(rows) - 0.5, -0.5)
        axis.set_xlabel(label)
        return _svg(figure)


def data_uri(content: bytes, kind: str) -> str:
    """An image inside the page."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _svg(figure: Any) -> str:
    stream = io.BytesIO()
    # no date: the same study gives the same page
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
    return data_uri(stream.getvalue(), "image/svg+xml")
