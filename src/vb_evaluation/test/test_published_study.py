"""The published study's indices are those of its areas, and what its page answers is that of its rows."""

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

from refusals import refused
from vb_evaluation.report.answers import answers, write_page
from vb_evaluation.report.data import read_study

import study_rows

STUDY = Path(__file__).resolve().parents[3] / "docs" / "results" / "study"


def test_every_index_is_that_of_the_published_areas():
    """With numpy alone, as somebody without this program would."""
    areas = np.load(STUDY / "judged" / "areas.npz")
    with open(STUDY / "judged" / "runs.csv", newline="", encoding="utf-8") as stream:
        saved = [row for row in csv.DictReader(stream) if row["map"]]
    assert len(saved) > 20
    for row in saved:
        drawn, asked = areas[Path(row["map"]).stem], areas[f"truth_{row['scenario']}"]
        assert (drawn & asked).sum() / (drawn | asked).sum() == pytest.approx(float(row["jaccard"]), abs=6e-5)
        inside = [one if row["scenario"] != "corner" else areas["floor"] & ~one for one in (drawn, asked)]
        index = (inside[0] & inside[1]).sum() / (inside[0] | inside[1]).sum()
        assert index == pytest.approx(float(row["jaccard_enclosed"]), abs=6e-5)


def test_the_page_answers_what_the_rows_say(tmp_path):
    page = shutil.copy(STUDY / "README.md", tmp_path)
    write_page(STUDY / "judged", Path(page))
    assert Path(page).read_text(encoding="utf-8") == (STUDY / "README.md").read_text(encoding="utf-8")
    shutil.copytree(STUDY / "judged", tmp_path / "judged")
    rows = (tmp_path / "judged" / "runs.csv").read_text(encoding="utf-8").splitlines(True)
    (tmp_path / "judged" / "runs.csv").write_text("".join(rows[:-1]), encoding="utf-8")
    write_page(tmp_path / "judged", Path(page))
    assert Path(page).read_text(encoding="utf-8") != (STUDY / "README.md").read_text(encoding="utf-8")
    Path(page).write_text("# A page without a place for them\n")
    with refused("no_place"):
        write_page(STUDY / "judged", Path(page))


@pytest.mark.parametrize("scenario, beside", [("room", ["The paper's people"]), ("door", [])])
def test_a_lab_asks_its_own_scenarios(scenario, beside, tmp_path):
    folder = study_rows.make_study(tmp_path / "study", 6, sweeps=False, maps=False)
    with open(folder / "runs.csv", newline="", encoding="utf-8") as stream:
        rows = [dict(row, scenario=scenario) for row in csv.DictReader(stream) if row["scenario"] == "room"]
    study_rows.write(folder / "runs.csv", list(rows[0]), rows)
    found = answers(read_study(folder))
    questions = [line.split("**")[1].rstrip("?") for line in found[1].splitlines()]
    assert questions == ["Faster", "Not less exact", "Completed as often", *beside]
    assert ("**Beside the paper**" in found) is bool(beside)
    study_rows.write(folder / "runs.csv", list(rows[0]), [row for row in rows if row["method"] == "nrs"])
    with refused("no_comparison"):
        answers(read_study(folder))
