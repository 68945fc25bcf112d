"""The published study's indices and tables are those of its own rows and areas; its pages' figures those of its tables."""

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

from vb_evaluation.report import charts
from vb_evaluation.report.page import write_report

STUDY = Path(__file__).resolve().parents[3] / "docs" / "results" / "study" / "judged"


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_every_index_is_that_of_the_published_areas():
    """With numpy alone, as somebody without this program would."""
    areas, rows = np.load(STUDY / "areas.npz"), rows_of(STUDY / "runs.csv")
    saved = [row for row in rows if row["map"]]
    assert len(saved) > 20
    for row in saved:
        drawn, asked = areas[Path(row["map"]).stem], areas[f"truth_{row['scenario']}"]
        assert (drawn & asked).sum() / (drawn | asked).sum() == pytest.approx(float(row["jaccard"]), abs=6e-5)
        inside = [one if row["scenario"] != "corner" else areas["floor"] & ~one for one in (drawn, asked)]
        index = (inside[0] & inside[1]).sum() / (inside[0] | inside[1]).sum()
        assert index == pytest.approx(float(row["jaccard_enclosed"]), abs=6e-5)


def test_every_table_is_that_of_the_published_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(charts, "_svg", lambda figure: charts.plt.close(figure) or "")
    folder = tmp_path / "study"
    folder.mkdir()
    for path in STUDY.glob("*.*"):
        shutil.copy(path, folder)
    write_report(folder)
    published = sorted((STUDY / "tables").glob("*.csv"))
    assert len(published) >= 4
    for path in published:
        assert rows_of(folder / "tables" / path.name) == rows_of(path), path.name
