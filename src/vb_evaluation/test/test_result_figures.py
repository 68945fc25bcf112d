"""Figures in README and docs agree with the files in docs/results.

A figure taken from a file is followed by a comment that names file, row and column (counted from 1):

    .868<!-- docs/results/study/hand.md "Carpet exclusion | people | robust" 6 -->

The row is the first line that begins with these cells; the figure is the cell's first number, rounded as on the page.
"""

import csv
import re
from pathlib import Path

import pytest

TOP = Path(__file__).resolve().parents[3]
MARK = re.compile(
    r"(?P<figure>[-−]?[\d,]*\.?\d+)(?P<percent> ?%)?<!-- (?P<file>\S+) \"(?P<row>[^\"]+)\" (?P<column>\d+) -->"
)
PAGES = [TOP / "README.md", *sorted((TOP / "docs").glob("**/*.md"))]


def cells_of(line):
    """Splits a line of a Markdown table or a CSV file into cells."""
    return [
        cell.strip()
        for cell in (line.strip().strip("|").split("|") if line.startswith("|") else next(csv.reader([line]), []))
    ]


def figure_of(path, row, column):
    """Returns the first number in a cell, as text."""
    wanted = [cell.strip() for cell in row.split("|" if "|" in row else ",")]
    for line in path.read_text(encoding="utf-8").splitlines():
        cells = cells_of(line)
        if cells[: len(wanted)] == wanted:
            return re.search(r"[-−]?\d*\.?\d+", cells[column - 1]).group()
    raise AssertionError(f"{path} has no row that begins with {wanted}")


def differences(text, top):
    """Lists the figures in which a page differs from the file."""
    found = []
    for mark in MARK.finditer(text):
        said = mark["figure"].replace("−", "-").replace(",", "")
        has = figure_of(top / mark["file"], mark["row"], int(mark["column"])).replace("−", "-")
        digits = len(said.partition(".")[2])
        if abs(float(said) - float(has)) > 0.5 * 10.0**-digits + 1e-9:
            found.append(f"{mark['row']}: {said} here, {has} in {mark['file']}")
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_figures_are_those_of_the_files(page):
    text = page.read_text(encoding="utf-8")
    assert text.count("<!-- docs/results/") == len(MARK.findall(text)), "a mark that cannot be read"
    assert differences(text, TOP) == []


def test_the_study_s_figures_are_marked():
    marked = {page.name for page in PAGES if "<!-- docs/results/" in page.read_text(encoding="utf-8")}
    assert "findings.md" in marked


def test_a_stale_figure_is_found(tmp_path):
    (tmp_path / "a.md").write_text(
        "| what | which | value |\n|---|---|---|\n| room | people | 0.997 [0.996, 0.998] |\n"
    )
    (tmp_path / "b.csv").write_text("what,value\nroom,12.31\nmany,5956\n")
    fresh = 'It is .997<!-- a.md "room | people" 3 -->, 12.3<!-- b.csv "room" 2 --> cm, 5,956<!-- b.csv "many" 2 -->.'
    assert differences(fresh, tmp_path) == []
    stale = fresh.replace(".997", ".999").replace("12.3<", "12.4<").replace("5,956", "6,956")
    assert len(differences(stale, tmp_path)) == 3
    with pytest.raises(AssertionError, match="no row"):
        differences(fresh.replace('"room" 2', '"corner" 2'), tmp_path)
