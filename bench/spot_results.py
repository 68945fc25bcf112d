#!/usr/bin/env python3
"""Writes docs/results/detection.md from the tables beside it that the spot benches write.

    bench/spot_clips.py DIR --left-out EXAMPLES --csv docs/results/detection_clips.csv
    bench/spot_detection.py --no-times --scenes --share .4 --other SRC --csv docs/results/detection_scenes.csv
    bench/spot_table.py --other SRC --csv docs/results/detection_table.csv
    bench/spot_time.py --other SRC --csv docs/results/detection_time.csv
    bench/spot_results.py

Of long tables only the rows that are not perfect are shown; all are in the CSV files.
"""
from __future__ import annotations

import csv
from pathlib import Path
from typing import Dict, List, Sequence

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "results"
ROLES = {"stationary": "ceiling camera", "mobile": "robot's camera, standing", "window": "window that pans, tilts, rolls"}
Row = Dict[str, str]


def rows_of(name: str) -> List[Row]:
    """A table's rows; none if it was not measured."""
    path = FOLDER / f"detection_{name}.csv"
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> List[str]:
    """A Markdown table."""
    return ["| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows]] + [""]


def revisions(rows: Sequence[Row]) -> str:
    """At which revisions rows were measured."""
    return ", ".join(sorted({row["revision"] for row in rows}))


def clips() -> List[str]:
    """Labelled clips: in all, and one by one."""
    rows = [row for row in rows_of("clips") if row["pictures"] == "plain"]

    def line(row: Row, first: Sequence[str]) -> List[str]:
        return [*first, f"{row['found']} of {row['labels']}", f"{row['recall_low']} to {row['recall_high']}",
                f"{row['shots_found']} of {row['shots']}", row["false"], row["false_on_unlabelled"],
                f"{row['false_per_1000']} ({row['false_low']} to {row['false_high']})", row["median_error_px"], row["revision"]]

    head = ["labelled frames", "recall, 95 %", "shots", "false", "of them unlabelled pulses", "false per 1000 frames, 95 %",
            "error [px]", "revision"]
    every = [line(row, (ROLES[row["role"]], row["version"])) for row in rows if row["clip"] == "all"]
    each = [line(row, (row["clip"].split(".")[0], ROLES[row["role"]])) for row in rows
            if row["clip"] != "all" and row["version"] == "left out"]
    return ["## Real clips", "", "Sixteen webcam clips, 5536 frames. *Left out*: judged by a classifier that was fitted without "
            "the clip and three others. *Confirmed*: with the confirmation that the nodes use; most pulses are shorter than it "
            "takes, so only its false spots say something. Frames of a clip resemble each other, so the intervals are too "
            "narrow.", "", *table(["role", "classifier", *head], every), "Each clip, left out:", "",
            *table(["clip", "role", *head], each)]


def scenes() -> List[str]:
    """Rendered scenes that are not perfect, with all versions."""
    rows = rows_of("scenes")
    names = list(dict.fromkeys(row["scene"] for row in rows))
    odd = [name for name in names if any(float(row["recall"]) < 1.0 or row["false_spots"] != "0" for row in rows if row["scene"] == name)]
    shown = [[row["scene"], row["version"], row["recall"], f"{row['false_spots']} in {row['frames']}", row["error_median_mm"],
              row["missed_because"]] for row in rows if row["scene"] in odd]
    return ["## Rendered scenes", "", f"{len(names)} scenes of a ceiling's and a robot's camera, beside revision 3655b17 (*other*) "
            f"on the same pictures; measured at {revisions(rows)}. In {len(names) - len(odd)} both have every spot and no false one; "
            "the others:", "", *table(["scene", "version", "recall", "false spots", "error [mm]", "missed because"], shown)]


def cameras() -> List[str]:
    """Kinds of cameras and images."""
    rows = rows_of("table")
    ours = [row for row in rows if row["version"] == "this"]
    odd = [row for row in rows if row["version"] == "this" and (float(row["recall"]) < 1.0 or row["false"] != "0")]
    before = [row for row in rows if row["version"] == "other" and (float(row["recall"]) < 0.98 or row["false"] != "0")]

    def shown(some: Sequence[Row]) -> List[str]:
        return table(["camera", "role", "recall", "false", "median error"], [
            [row["camera"], row["role"], row["recall"], row["false"], f"{row['median_error']} {row['unit']}"] for row in some])

    return ["## Kinds of cameras", "", "Encodings, lasers, white levels, rates, sizes, compression, lenses; measured at "
            f"{revisions(rows)}. {len(ours) - len(odd)} of {len(ours)} rows have every spot and no false one; the others:", "",
            *shown(odd), "Rows in which revision 3655b17 missed more than 2 % or had false spots:", "", *shown(before)]


def times() -> List[str]:
    """Times of a search."""
    rows = rows_of("time")
    return ["## Time of a search", "", f"One thread, paired rounds with revision 3655b17, measured at {revisions(rows)} on two busy "
            "cores: the ratios count.", "", *table(["case", "this [ms]", "3655b17 [ms]", "ratio"], [
                [row["case"], row["this_ms"], row["other_ms"], row["this_over_other"]] for row in rows])]


def main() -> None:
    lines = ["# Seeing the spot: results", "", "Written by `bench/spot_results.py` from the `detection_*.csv` beside it; its docstring "
             "names the commands. What the figures mean for a lab: [How a spot is detected](../explanation/detection.md).", ""]
    for part in (clips, scenes, cameras, times):
        lines += part()
    (FOLDER / "detection.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
