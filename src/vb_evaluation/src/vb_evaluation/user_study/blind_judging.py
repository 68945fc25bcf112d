"""Blind judging: somebody who knows neither participant nor method says which runs were completed.

<study>/judging/NNN.png, judgements.csv    for the judge: what was drawn, in random order, under random numbers
<study>/judging_key.csv                    which number is which run; the judge does not get it
"""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Dict

from vb_core.errors import CodedError
from vb_core.map_files import read_map
from vb_evaluation.metrics import restricted_cells
from vb_evaluation.report.map_figures import plot_map
from vb_evaluation.report.study_files import RUNS, read_flags, read_sheet, refuse_cells, write_table

FOLDER, SHEET, KEY = "judging", "judgements.csv", "judging_key.csv"


def write_judging_sheet(study: Path, results: Path) -> Path:
    """Writes the pictures of all measured runs with a saved border, and an empty sheet. Returns their folder.

    Raises:
        CodedError: "cannot_write_into", also if they exist: judgements must not be lost.
    """
    rows = read_sheet(results / RUNS, ("recording", "scenario", "map"))
    rows = rows[rows["map"] != ""]
    # from 100: a spreadsheet strips leading zeros
    codes = [str(code) for code in secrets.SystemRandom().sample(range(100, 1000 + 9 * len(rows)), len(rows))]
    key = [{"code": code, "recording": recording} for code, recording in zip(codes, rows["recording"])]
    physical = read_map(results / "maps" / "physical.yaml")
    pictures = []
    for row in rows.to_dict("records"):
        map_files = (f"maps/truth_{row['scenario']}.yaml", row["map"])
        areas = [restricted_cells(physical, read_map(results / name)) for name in map_files]
        pictures.append(plot_map(physical, *areas))
    try:
        (study / FOLDER).mkdir()
        for code, picture in zip(codes, pictures):
            (study / FOLDER / f"{code}.png").write_bytes(picture)
        write_table(study / FOLDER / SHEET, ["code", "completed"], [{"code": code} for code in sorted(codes)])
        write_table(study / KEY, ["code", "recording"], key)
    except OSError as error:
        raise CodedError("cannot_write_into", folder=str(study / FOLDER), reason=error.strerror) from None
    return study / FOLDER


def read_judgements(study: Path) -> Dict[str, bool]:
    """Reads the judgements by recording, none if nobody has judged.

    Raises:
        CodedError: "bad_judgement" naming the line.
    """
    path = study / FOLDER / SHEET
    if not path.is_file():
        return {}
    recordings = read_sheet(study / KEY, ("code", "recording"), "bad_judgement").set_index("code").recording
    sheet = read_sheet(path, ("code", "completed"), "bad_judgement")
    refuse_cells(sheet.code, ~sheet.code.isin(recordings.index), path, "a picture's number", "bad_judgement")
    judgements = {}
    for code, answer in zip(sheet.code, read_flags(sheet.completed, path, "bad_judgement")):
        if answer is not None:
            judgements[recordings[code]] = answer
    return judgements
