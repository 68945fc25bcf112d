#!/usr/bin/env python3
"""Writes docs/results/detection/tables.md from the tables beside it that the spot benches write.

    bench/detection/clips.py DIR --left-out out/spot_examples --csv docs/results/detection/clips.csv
    bench/detection/training.py --clips DIR --csv docs/results/detection/left_out.csv
    bench/detection/frames.py --no-times --scenes --other SRC --csv docs/results/detection/scenes.csv
    bench/detection/camera_table.py --other SRC --csv docs/results/detection/table.csv
    bench/detection/frame_time.py --other SRC --csv docs/results/detection/time.csv
    bench/detection/robots_in_view.py --places 3000 --rounds 20 --csv docs/results/detection/robots.csv
    bench/detection/results.py

Of long tables only the rows that are not perfect are shown; all are in the CSV files.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Dict, List, Sequence

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "results" / "detection"
ROLES = {
    "stationary": "ceiling camera",
    "mobile": "robot's camera, standing",
    "window": "window that pans, tilts, rolls",
}
Row = Dict[str, str]


def rows_of(name: str) -> List[Row]:
    """Reads a table's rows; none if it was not measured."""
    path = FOLDER / f"{name}.csv"
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> List[str]:
    """Writes a Markdown table."""
    return ["| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows]] + [""]


def revisions(rows: Sequence[Row]) -> str:
    """Says at which revisions rows were measured."""
    return ", ".join(sorted({row["revision"] for row in rows}))


def clips() -> List[str]:
    """Reports labelled clips: in all, and one by one."""
    rows = [row for row in rows_of("clips") if row["pictures"] == "plain"]

    def line(row: Row, first: Sequence[str]) -> List[str]:
        return [
            *first,
            f"{row['found']} of {row['labels']}",
            f"{row['recall_low']} to {row['recall_high']}",
            f"{row['shots_found']} of {row['shots']}",
            row["false"],
            row["false_on_unlabelled"],
            f"{row['false_per_1000']} ({row['false_low']} to {row['false_high']})",
            row["median_error_px"],
            row["revision"],
        ]

    head = [
        "labelled frames",
        "recall, 95 %",
        "shots",
        "false",
        "of them unlabelled pulses",
        "false per 1000 frames, 95 %",
        "error [px]",
        "revision",
    ]
    every = [line(row, (ROLES[row["role"]], row["version"])) for row in rows if row["clip"] == "all"]
    # of each clip the last measurement
    each = {
        (row["clip"], row["role"]): line(row, (row["clip"].split(".")[0], f"{ROLES[row['role']]}, {row['version']}"))
        for row in rows
        if row["clip"] != "all" and row["version"].startswith("left out")
    }
    return [
        "## Real clips",
        "",
        "Sixteen webcam clips, 5536 frames. *Left out*: judged by a classifier that was fitted without "
        "the clip. *Confirmed*: with the confirmation that the nodes use; most pulses are shorter than it "
        "takes, so only its false spots say something. Frames of a clip resemble each other, so the intervals are too "
        "narrow.",
        "",
        *table(["role", "classifier", *head], every),
        "Clip by clip, the last measurement of each:",
        "",
        *table(["clip", "role, classifier", *head], list(each.values())),
    ]


def _paint(row: Row) -> bool:
    return "dots on a" in row["left_out"]


def left_out() -> List[str]:
    """Reports the classifier alone, on clips and scenes that it was not fitted on."""
    rows = rows_of("left_out")
    kinds = {
        "clips": [row for row in rows if ":" not in row["left_out"]],
        "ceiling scenes": [row for row in rows if row["left_out"].startswith("ceiling") and not _paint(row)],
        "robot scenes": [row for row in rows if row["left_out"].startswith("robot") and not _paint(row)],
        "paint, which only training shows": [row for row in rows if _paint(row)],
    }
    sums = [
        [name, *(str(sum(int(row[key]) for row in some)) for key in ("found", "spots", "taken_for_spots", "others"))]
        for name, some in kinds.items()
    ]
    odd = [
        [row["left_out"], row["found"], row["spots"], row["taken_for_spots"], row["others"]]
        for row in rows
        if row["found"] != row["spots"] or row["taken_for_spots"] != "0"
    ]
    head = ["found", "of spots", "taken for spots", "of other things"]
    return [
        "## The classifier on what it was not fitted on",
        "",
        "A fifth of all clips and scenes is left out at a time, each "
        f"as a whole; each thing that the detector examined counts once. Measured at {revisions(rows)}.",
        "",
        *table(["left out", *head], sums),
        "Not perfect:",
        "",
        *table(["left out", *head], odd),
    ]


def scenes() -> List[str]:
    """Reports rendered scenes that are not perfect."""
    measured: List[Dict[str, Row]] = []
    for row in rows_of("scenes"):
        if row["version"] != "other":
            measured.append({"this": row})
        measured[-1][row["version"]] = row
    odd = [one for one in measured if float(one["this"]["recall"]) < 1.0 or one["this"]["false_spots"] != "0"]
    shown = [
        [
            one["this"]["scene"] + (", left out" if "left out" in one else ""),
            one["this"]["share"],
            one["this"]["recall"],
            one["this"]["false_spots"],
            one["this"]["missed_because"],
            one.get("other", {}).get("recall", ""),
            one.get("other", {}).get("false_spots", ""),
            one["this"]["revision"],
        ]
        for one in odd
    ]
    revision_of = [one["this"]["revision"] for one in measured]
    by_revision = ", ".join(f"{revision_of.count(name)} at {name}" for name in dict.fromkeys(revision_of))
    return [
        "## Rendered scenes",
        "",
        f"{len({one['this']['scene'] for one in measured})} scenes of a ceiling's and a robot's camera, "
        f"{len(measured)} measurements ({by_revision}), beside revision 3655b17 on the same pictures. {len(measured) - len(odd)} "
        "have every spot and no false one; the others:",
        "",
        *table(
            [
                "scene",
                "share of its time",
                "recall",
                "false spots",
                "missed because",
                "recall of 3655b17",
                "its false spots",
                "revision",
            ],
            shown,
        ),
    ]


def cameras() -> List[str]:
    """Kinds of cameras and images."""
    rows = rows_of("table")
    ours = [row for row in rows if row["version"] == "this"]
    odd = [row for row in rows if row["version"] == "this" and (float(row["recall"]) < 1.0 or row["false"] != "0")]
    before = [row for row in rows if row["version"] == "other" and (float(row["recall"]) < 0.98 or row["false"] != "0")]

    def shown(some: Sequence[Row]) -> List[str]:
        if not some:
            return []
        return table(
            ["camera", "role", "recall", "false", "median error"],
            [
                [row["camera"], row["role"], row["recall"], row["false"], f"{row['median_error']} {row['unit']}"]
                for row in some
            ],
        )

    return [
        "## Kinds of cameras",
        "",
        "Encodings, lasers, white levels, rates, sizes, compression, lenses; measured at "
        f"{revisions(rows)}. {len(ours) - len(odd)} of {len(ours)} rows have every spot and no false one"
        + ("; the others:" if odd else "."),
        "",
        *shown(odd),
        "Rows in which revision 3655b17 missed more than 2 % or had false spots:",
        "",
        *shown(before),
    ]


def times() -> List[str]:
    """Times of a search."""
    rows = rows_of("time")
    return [
        "## Time of a search",
        "",
        f"One thread, paired rounds with revision 3655b17, measured at {revisions(rows)} on two busy "
        "cores: the ratios count.",
        "",
        *table(
            ["case", "this [ms]", "3655b17 [ms]", "ratio"],
            [[row["case"], row["this_ms"], row["other_ms"], row["this_over_other"]] for row in rows],
        ),
    ]


def robots() -> List[str]:
    """Reports what is rejected because a robot's body is in the way."""
    rows, shares = rows_of("robots"), {}
    for row in rows:
        line = shares.setdefault((row["what"], row["localisation_error_cm"], row["n"], row["hidden_anyway"]), {})
        line[row["margin_cm"]] = "{:.1f} % ({:.1f} to {:.1f})".format(
            *(100 * float(row[key]) for key in ("share", "low", "high"))
        )
    return [
        "## Robots",
        "",
        "Robots at 3000 random places of the simulated lab, below its three ceiling cameras. *Laser beside*: spots on "
        "the floor that the drawn robot does not hide; those that it hides are counted apart. "
        "*Light on it*: points of its side or top that face the "
        "camera. Refused, with 95 %, by the margin round the robot; the detectors have 5 cm. Measured at "
        f"{revisions(rows)}.",
        "",
        *table(
            ["what", "localisation off by [cm]", "n", "hidden anyway", "no margin", "5 cm", "10 cm"],
            [[*key, line["0"], line["5"], line["10"]] for key, line in shares.items()],
        ),
    ]


def main() -> None:
    lines = [
        "# Seeing the spot: results",
        "",
        "Written by `bench/detection/results.py` from the `*.csv` beside it; its docstring "
        "names the commands. What the figures mean for a lab: [How a spot is detected](../../explanation/detection.md).",
        "",
    ]
    for part in (clips, left_out, scenes, cameras, robots, times):
        lines += part()
    (FOLDER / "tables.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
