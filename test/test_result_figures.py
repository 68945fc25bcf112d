"""Figures in README and docs agree with the files in docs/results.

A figure taken from a file is followed by a comment that names file, row and column (counted from 1):

    .868<!-- docs/results/study/hand.md "Carpet exclusion | people | robust" 6 -->

The row is the first line that begins with these cells; the figure is the cell's first number, rounded as on the page.
Tables are written by scripts/reference or the report of a study. So a rate, a share or a decimal number on a results page that has
no mark has no source, except in a section that says how something was measured, or what the history has.
"""

import csv
import re

import pytest

from vb_testing import TOP

MARK = re.compile(
    r"(?P<figure>[-−]?[\d,]*\.?\d+)(?P<percent> ?%)?<!-- (?P<file>\S+) \"(?P<row>[^\"]+)\" (?P<column>\d+) -->"
)
# <!-- table a.csv: b --> ... <!-- end -->
WRITTEN = re.compile(r"<!-- (?:table|what follows is written).*?<!-- end.*?-->", re.S)
NO_FIGURE = re.compile(r"^ {4}.*$|`[^`]*`|\]\([^)]*\)", re.M)  # a command, `--worlds 0.2`, where [a link](0.2.md) leads
TOLD = re.compile(r"^#+ (How it was measured|How the study came about|Before)\n.*?(?=^#|\Z)", re.M | re.S)
# 3 of 4, 1,034 of its 5,956, 75 %, 0.997, .868; no 3 and no 1,034 alone
FIGURE = re.compile(r"\b\d[\d,]* of (?:its )?[\d,]*\d|[\d.,]*\d ?%|\d*\.\d+")
# pages without results of measurements: what was run, a plan, formulas; and one that a program wrote as a whole
OTHERS = "systems/README.md", "judged/plan.md", "study/statistics.md", "study/hand.md"
PAGES = [TOP / "README.md", *sorted((TOP / "docs").glob("**/*.md"))]
RESULT_PAGES = [page for page in sorted((TOP / "docs" / "results").glob("**/*.md")) if not str(page).endswith(OTHERS)]


def cells_of(line):
    """Splits a line of a Markdown table or a CSV file into cells."""
    cells = line.strip().strip("|").split("|") if line.startswith("|") else next(csv.reader([line]), [])
    return [cell.strip() for cell in cells]


def figure_of(path, row, column):
    """Returns the first number in a cell, as text."""
    row_cells = [cell.strip() for cell in row.split("|" if "|" in row else ",")]
    for line in path.read_text(encoding="utf-8").splitlines():
        cells = cells_of(line)
        if cells[: len(row_cells)] == row_cells:
            return re.search(r"[-−]?\d*\.?\d+", cells[column - 1]).group()
    raise AssertionError(f"{path} has no row that begins with {row_cells}")


def differences(text, top):
    """Lists the figures in which a page differs from the file."""
    lines = []
    for mark in MARK.finditer(text):
        quoted = mark["figure"].replace("−", "-").replace(",", "")
        source = figure_of(top / mark["file"], mark["row"], int(mark["column"])).replace("−", "-")
        digits = len(quoted.partition(".")[2])
        if abs(float(quoted) - float(source)) > 0.5 * 10.0**-digits + 1e-9:
            lines.append(f"{mark['row']}: {quoted} here, {source} in {mark['file']}")
    return lines


def unmarked(text):
    """Lists the figures on a results page that have no source."""
    for left_out in (WRITTEN, TOLD, MARK, NO_FIGURE):
        text = left_out.sub("", text)
    return FIGURE.findall(text)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_figures_are_those_of_the_files(page):
    text = page.read_text(encoding="utf-8")
    assert text.count("<!-- docs/results/") == len(MARK.findall(text)), "a mark that cannot be read"
    assert differences(text, TOP) == []


@pytest.mark.parametrize("page", RESULT_PAGES, ids=lambda page: str(page.relative_to(TOP)))
def test_each_figure_of_a_results_page_has_a_source(page):
    assert unmarked(page.read_text(encoding="utf-8")) == []


def test_a_stale_figure_and_one_without_a_source_are_found(tmp_path):
    (tmp_path / "a.md").write_text("| room | people | 0.997 [0.996, 0.998] |\n")
    (tmp_path / "b.csv").write_text("what,value\nroom,12.31\nmany,5956\n")
    fresh = 'It is .997<!-- a.md "room | people" 3 -->, 12.3<!-- b.csv "room" 2 --> cm, 5,956<!-- b.csv "many" 2 -->.'
    assert differences(fresh, tmp_path) == []
    stale = fresh.replace(".997", ".999").replace("12.3<", "12.4<").replace("5,956", "6,956")
    assert len(differences(stale, tmp_path)) == 3
    with pytest.raises(AssertionError, match="no row"):
        differences(fresh.replace('"room" 2', '"corner" 2'), tmp_path)
    fresh += "`0.2`\n## How it was measured\nwith 0.3 m\n## Next\n<!-- table a.csv: b -->\n0.4\n<!-- end -->\n"
    assert unmarked(fresh) == []
    assert unmarked(fresh + "In 3 of 4, 75 %, 0.75 m.") == ["3 of 4", "75 %", "0.75"]
