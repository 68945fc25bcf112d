"""Writes the report: its texts, in report.md.j2, with the tables between them. It is one HTML page, or part of a Markdown page.

First come the answers to the study's questions, then what compares the methods, then what each method reached. Every figure
comes with its limits. For simulated people, effects have intervals but no p: as their number is arbitrary, any effect can be
made significant. For real people, the paper's tests are reported too.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence

import jinja2
from markdown_it import MarkdownIt

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_evaluation.report import comparisons, cross_checks, descriptions, map_figures, questionnaire
from vb_evaluation.report.findings import answer_questions
from vb_evaluation.report.study_files import StudyResults, read_study
from vb_evaluation.statistics import format_number

BEGIN, END = "<!-- what follows is written by study_kit report --page -->", "<!-- end of what is written -->"


def compute_tables(study: StudyResults) -> Dict[str, List[Dict[str, Any]]]:
    """Computes the report's tables by name: rows of cells by heading. Leaves out those that the study has no rows for."""
    tables = {
        "error": descriptions.describe(study, descriptions.ERROR_COLUMNS, completed=1),
        "time": descriptions.describe(study, descriptions.TIME_COLUMNS),
        "accuracy": descriptions.describe(study, descriptions.ACCURACY_COLUMNS, completed=1),
        "completeness": descriptions.describe_completeness(study),
        "failures": descriptions.list_failures(study),
        "demographics": questionnaire.summarize_demographics(study),
        "ratings": questionnaire.compare_ratings(study),
    }
    if len(study.methods) > 1:
        tables["effects"] = comparisons.compute_effects(study)
        tables["margins"] = comparisons.compare_with_margins(study)
        tables["tests"] = comparisons.compute_tests(study)
        tables["beside_the_paper"] = cross_checks.compare_with_paper(study)
        tables["worlds"] = cross_checks.count_worlds(study)
    return {name: rows for name, rows in tables.items() if rows}


def format_document(study: StudyResults) -> str:
    """Formats the report in Markdown: the answers, then sections with headings of the third level."""
    tables = compute_tables(study)
    answers = answer_questions(study, tables)
    return _templates().get_template("report.md.j2").render(tables, study=study, answers=answers).strip()


def write_report(folder: Path) -> Path:
    """Writes report.html, one page without external resources, into a study's folder. Returns its path.

    Raises:
        CodedError: "bad_study" naming the file, and the line or column; "cannot_write".
    """
    study = read_study(folder)
    answers, *sections = re.split("^### (.*)$", format_document(study), flags=re.M)
    titled = dict(zip(sections[::2], sections[1::2]))
    template = _templates().get_template("report.html.j2")
    text = template.render(study=study, answers=answers, sections=titled, maps=map_figures.draw_maps(study))
    page = folder / "report.html"
    write_atomically(page, text.encode("utf-8"))
    return page


def write_page(folder: Path, page: Path) -> None:
    """Puts the report of a study's folder between the marks of a page in Markdown: no figure is copied by hand.

    Raises:
        CodedError: "bad_study"; "no_place" if the page lacks the marks.
    """
    before, begin, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not end:
        raise CodedError("no_place", f"{page} needs these two lines, in this order:\n{BEGIN}\n{END}")
    blocks = [before + begin, format_document(read_study(folder)), end + after]
    write_atomically(page, "\n\n".join(blocks).encode("utf-8"))


def _templates() -> jinja2.Environment:
    loader = jinja2.FileSystemLoader(str(Path(__file__).parent))
    environment = jinja2.Environment(loader=loader, autoescape=lambda name: ".html" in name, trim_blocks=True)
    markdown = MarkdownIt("js-default")
    # no note of an experimenter becomes a link, or an image from elsewhere
    markdown.validateLink = lambda url: url.startswith("data:image/png;base64,")
    environment.filters.update(markdown=markdown.render, table=_format_table)
    return environment


def _format_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Writes rows as a table in Markdown, numbers at the right and words at the left."""
    headings = list(dict.fromkeys(heading for row in rows for heading in row))
    cells = [[_format_cell(row.get(heading, "")) for heading in headings] for row in rows]
    rules = ["---:" if re.match(r"[–−+<.\d]", cell) else "---" for cell in cells[0]]
    return "\n".join(f"| {' | '.join(line)} |" for line in (headings, rules, *cells))


def _format_cell(value: Any) -> str:
    text = format_number(value, 0) if isinstance(value, float) else str(value)
    return text.replace("|", r"\|").replace("\n", " ")
