"""The report's figures as SVG text, drawn without a display."""
from __future__ import annotations

import base64
import contextlib
import io
from typing import Any, Dict, Iterator, List, Optional, Sequence, Tuple

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
SERIES, MARKERS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, GREY), ("o", "s", "^", "D", "v", "P")
WIDTH_IN, PANEL_IN = 7.2, 4.6
PUBLISHED = {"marker": "D", "ms": 7, "color": "white", "mec": "black", "mew": 1.3, "ls": "none"}
_STYLE = {
    "font.family": "DejaVu Sans", "font.size": 10, "axes.spines.top": False, "axes.spines.right": False,
    "axes.edgecolor": "#555555", "axes.grid": True, "grid.color": "#e4e4e4", "axes.axisbelow": True,
    "svg.fonttype": "path", "svg.hashsalt": "study", "legend.frameon": False, "figure.constrained_layout.use": True,
}


@contextlib.contextmanager
def _drawing(width: float, height: float, into: List[str]) -> Iterator[Tuple[Any, Any]]:
    """A figure with one axis, appended as a data URI once it is drawn."""
    with plt.rc_context(_STYLE):
        figure, axis = plt.subplots(figsize=(width, height))
        yield figure, axis
        into.append(_svg(figure))


def _svg(figure: Any) -> str:
    stream = io.BytesIO()
    # no date: the same study gives the same page
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    plt.close(figure)
    return data_uri(stream.getvalue(), "image/svg+xml")


def data_uri(content: bytes, kind: str) -> str:
    """An image inside the page."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def color_of(method: str, index: int) -> str:
    """A method's colour everywhere in the report."""
    return METHOD_COLORS.get(method, SERIES[2 + index % (len(SERIES) - 2)])


def _rows(axis: Any, titles: Sequence[str], label: str, **font: float) -> None:
    """Names rows from top to bottom."""
    axis.set_yticks(range(len(titles)))
    axis.set_yticklabels(titles, **font)
    axis.set_ylim(len(titles) - 0.5, -0.5)
    axis.set_xlabel(label)


def _columns(axis: Any, titles: Sequence[str], label: str) -> None:
    axis.set_xticks(range(len(titles)))
    axis.set_xticklabels(titles)
    axis.grid(axis="x", visible=False)
    axis.set_ylabel(label)


def time_bars(bars: Sequence[Tuple[str, str, Dict[str, float], np.ndarray]], limit_s: float) -> str:
    """The paper's bars of interaction time, one per method, stacked by state.

    Args:
        bars: (method, title, mean seconds by state, total seconds of each run).
        limit_s: end of the axis, the same for all scenarios.
    """
    found: List[str] = []
    with _drawing(WIDTH_IN, 0.75 + 0.62 * len(bars), found) as (_, axis):
        for place, (method, _, states, totals) in enumerate(bars):
            left, color = 0.0, color_of(method, place)
            for state, seconds in states.items():
                axis.barh(place, seconds, left=left, height=0.44, color=STATE_COLORS[state], edgecolor="white", linewidth=0.5)
                if seconds > 0.05 * limit_s:
                    axis.text(left + seconds / 2, place, f"{seconds:.1f}", ha="center", va="center", fontsize=9)
                left += seconds
            axis.barh(place, left, height=0.44, fill=False, edgecolor=color, linewidth=2)
            axis.plot(totals, np.full(len(totals), place + 0.34), "|", ms=6, color=color, alpha=0.8, mew=1.2)
        _rows(axis, [title for _, title, _, _ in bars], "interaction time [s]; a stroke is one run")
        axis.set_xlim(0.0, limit_s)
        axis.grid(axis="y", visible=False)
    return found[0]


def boxes(groups: Sequence[Tuple[str, str, np.ndarray, Optional[float]]], label: str) -> str:
    """Boxplots with every value beside the box and the paper's median as a diamond.

    Args:
        groups: (method, title, values, the paper's median or None).
    """
    found: List[str] = []
    with _drawing(PANEL_IN, 3.3, found) as (_, axis):
        for place, (method, _, values, published) in enumerate(groups):
            color = color_of(method, place)
            if len(values):
                line = {"color": color}
                axis.boxplot(
                    [values], positions=[place], widths=0.36, showfliers=False, patch_artist=True, whiskerprops=line, capprops=line,
                    boxprops={"facecolor": matplotlib.colors.to_rgba(color, 0.25), "edgecolor": color},
                    medianprops={"color": color, "linewidth": 2.2})
                spread = np.linspace(-0.06, 0.06, len(values)) if len(values) > 1 else np.zeros(1)
                axis.plot(place + 0.31 + spread, values, "o", ms=3, color=color, alpha=0.7, mew=0)
            if published is not None:
                axis.plot(place - 0.3, published, **PUBLISHED)
        _columns(axis, [title for _, title, _, _ in groups], label)
        axis.set_xlim(-0.6, len(groups) - 0.4)
        axis.margins(y=0.08)
    return found[0]


def rates(groups: Sequence[Tuple[str, Sequence[Tuple[str, str, float, float, float, Optional[float]]]]]) -> str:
    """Success rates as bars with intervals.

    Args:
        groups: (scenario's title, bars of (method, title, share, low, high, the paper's share or None)).
    """
    found: List[str] = []
    with _drawing(WIDTH_IN, 3.0, found) as (figure, axis):
        handles: Dict[str, Any] = {}
        width = 0.8 / max(1, max((len(bars) for _, bars in groups), default=1))
        for place, (_, bars) in enumerate(groups):
            for index, (method, title, share, low, high, published) in enumerate(bars):
                x = place + (index - (len(bars) - 1) / 2) * width
                handles[title] = axis.bar(x, 100 * share, width * 0.86, color=color_of(method, index), alpha=0.75)
                axis.plot([x, x], [100 * low, 100 * high], color="#222222", lw=1.2)
                if published is not None:
                    handles["the paper"], = axis.plot(x, 100 * published, **PUBLISHED)
        _columns(axis, [title for title, _ in groups], "completed [%]")
        axis.set_ylim(0, 104)
        words = sorted(handles, key=lambda title: title == "the paper")
        figure.legend([handles[title] for title in words], words, loc="outside upper center", ncol=3, fontsize=9)
    return found[0]


Band = Optional[Sequence[float]]


def lines(series: Sequence[Tuple[str, Sequence[float], Sequence[float], Band, Band, Dict[str, Any]]], x_label: str, y_label: str) -> str:
    """Curves with bands.

    Args:
        series: (name, x, y, low, high, style with color, marker, linestyle); values that are not finite are omitted.
            A name "group, kind" appears in the legend as a colour for its group and a line style for its kind.
    """
    found: List[str] = []
    with _drawing(PANEL_IN, 3.3, found) as (figure, axis):
        handles: Dict[str, Any] = {}
        for name, x, y, low, high, style in series:
            axis.plot(x, y, ms=5, lw=1.8, **style)
            if low is not None and high is not None:
                axis.fill_between(x, np.asarray(low, float), np.asarray(high, float), color=style["color"], alpha=0.13, lw=0)
            group, _, kind = name.partition(", ")
            handles.setdefault(group, Line2D([], [], color=style["color"], marker=style["marker"], ms=5, lw=1.8))
            if kind:
                handles.setdefault(kind, Line2D([], [], color="#222222", ls=style["linestyle"], lw=1.5))
        axis.set_xlabel(x_label)
        axis.set_ylabel(y_label)
        figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncol=min(3, len(handles) or 1), fontsize=8.5)
    return found[0]


def rank_bars(rows: Sequence[Tuple[str, float, float, float]], label: str, noise: float) -> str:
    """Correlations with their intervals, drawn from top to bottom.

    Args:
        rows: (name, correlation, low, high).
        noise: band about 0 that the largest of as many correlations of pure chance stays in.
    """
    found: List[str] = []
    with _drawing(WIDTH_IN, 1.0 + 0.3 * len(rows), found) as (_, axis):
        axis.axvspan(-noise, noise, color="#dddddd", alpha=0.6, lw=0)
        for place, (_, value, low, high) in enumerate(rows):
            axis.barh(place, value, height=0.55, color=ORANGE if value > 0 else SKY)
            axis.plot([low, high], [place, place], color="#222222", lw=1.2)
        axis.axvline(0.0, color="#222222", lw=1)
        _rows(axis, [name for name, *_ in rows], label, fontsize=8.5)
    return found[0]
