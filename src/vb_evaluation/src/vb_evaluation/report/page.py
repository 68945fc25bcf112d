"""Renders a study's sections as one page without external resources, and each of its tables as CSV."""
from __future__ import annotations

from pathlib import Path
from typing import List

import jinja2
from markupsafe import Markup

from vb_core.errors import CodedError
from vb_evaluation.report import sections
from vb_evaluation.report.blocks import Grid
from vb_evaluation.report.data import read_study, write_table

PAGE, TABLES = "report.html", "tables"


def write_report(folder: Path) -> Path:
    """Writes report.html and tables/*.csv into a study's folder; the page omits what the folder lacks.

    Returns:
        The page.

    Raises:
        CodedError: "bad_study" naming the file, and the line or column; "cannot_write".
    """
    study = read_study(folder)
    found = sections.all_sections(study)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(str(Path(__file__).parent)), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True)
    css = Markup((Path(__file__).parent / "page.css").read_text(encoding="utf-8"))
    page = study.folder / PAGE
    try:
        page.write_text(environment.get_template("page.html.j2").render(
            title=sections.title(study), notices=sections.notices(study), sections=found, css=css), encoding="utf-8")
        _write_tables(study.folder / TABLES, [block for part in found for block in part.blocks if isinstance(block, Grid)])
    except OSError as error:
        raise CodedError("cannot_write", f"cannot write the report into {study.folder}: {error.strerror}") from None
    return page


def _write_tables(folder: Path, grids: List[Grid]) -> None:
    folder.mkdir(exist_ok=True)
    for grid in grids:
        rows = [grid.plain(row) for row in grid.rows]
        if rows:
            columns = max((list(row) for row in rows), key=len)
            write_table(folder / f"{grid.name}.csv", columns, rows)
