"""Studies for tests of the report, made of the published study's first participants."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas

from vb_core.grid_map import GridMap
from vb_core.map_files import write_map
from vb_evaluation.report.study_files import read_sheet
from vb_evaluation.report.map_figures import write_truths

PUBLISHED = Path(__file__).resolve().parents[3] / "docs" / "results" / "study" / "judged"


def rows_of(path):
    return read_sheet(path, ()).to_dict("records")


def write(path, rows, columns=None):
    pandas.DataFrame(rows, columns=columns).to_csv(path, index=False)
    return path


def make_study(folder, participants, runs_only=False, people=False):
    folder.mkdir(parents=True)
    rows = [row for row in rows_of(PUBLISHED / "runs.csv") if int(row["participant"]) <= participants]
    write(folder / "runs.csv", rows)
    meta = json.loads((PUBLISHED / "study.json").read_text(encoding="utf-8"))
    (folder / "study.json").write_text(json.dumps({**meta, "people": people}))
    if not runs_only:
        for name in ("draws.csv", "worlds.csv"):
            shutil.copy(PUBLISHED / name, folder)
        write_maps(folder, [row["map"] for row in rows if row["map"]])
    return folder


def write_maps(folder, names):
    """Writes maps, reconstructed from the published areas."""
    areas = np.load(PUBLISHED / "areas.npz")
    prior = GridMap(np.where(areas["floor"], np.int8(0), np.int8(100)), 0.025)
    write_truths(folder, prior, {name[len("truth_") :]: areas[name] for name in areas if name.startswith("truth_")})
    for name in map(Path, names):
        occupancy = np.where(areas[name.stem], np.int8(100), prior.data)
        write_map(folder / name.with_suffix(""), prior.with_data(occupancy))
