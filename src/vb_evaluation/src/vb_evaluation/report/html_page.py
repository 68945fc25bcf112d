"""Writes the report: one page without external resources, and each of its tables as CSV.

What compares the methods comes first, then what each method reached. Every figure comes with its limits. For simulated
people, effects have intervals but no p: as their number is arbitrary, any effect can be made significant. For real
people, the paper's tests are reported too.
"""

from __future__ import annotations

from pathlib import Path
from typing import List

import jinja2
from markdown_it import MarkdownIt

from vb_core.errors import CodedError
from vb_evaluation.report import cross_checks, map_figures, outcomes, questionnaire
from vb_evaluation.report.study_files import StudyResults, read_study
from vb_evaluation.report.table import Table

PAGE, TABLES = "report.html", "tables"
COMPARISONS = (
    outcomes.summary_table,
    outcomes.noninferiority_table,
    outcomes.summary_without_help_table,
    outcomes.tests_table,
    cross_checks.paper_table,
    cross_checks.worlds_table,
)
DESCRIPTIONS = (
    outcomes.error_table,
    outcomes.time_table,
    outcomes.accuracy_table,
    outcomes.completeness_table,
    outcomes.not_completed_table,
    questionnaire.demographics_table,
    questionnaire.questionnaire_table,
    questionnaire.warnings_table,
)


def report_tables(study: StudyResults) -> List[Table]:
    """Makes the report's tables in their order, without those that have no rows."""
    comparisons = COMPARISONS if len(study.methods) > 1 else ()
    tables = [make_table(study) for make_table in (*comparisons, *DESCRIPTIONS)]
    return [table for table in tables if table.rows]


def write_report(folder: Path) -> Path:
    """Writes report.html and tables/*.csv into a study's folder. The page omits what the folder lacks.

    Returns:
        The page.

    Raises:
        CodedError: "bad_study" naming the file, and the line or column; "cannot_write_into".
    """
    study = read_study(folder)
    tables = report_tables(study)
    markdown = MarkdownIt("js-default")
    # no note of an experimenter becomes a link, or an image from elsewhere
    markdown.validateLink = lambda url: url.startswith("data:image/png;base64,")
    loader = jinja2.FileSystemLoader(str(Path(__file__).parent))
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    environment.filters["markdown"] = markdown.render
    text = environment.get_template("report.html.j2").render(
        title=f"Drawing virtual borders: the study with {'people' if study.has_people else 'simulated people'}",
        notices=notices(study),
        tables=[*tables, map_figures.maps_table(study)],
    )
    try:
        (study.folder / PAGE).write_text(text, encoding="utf-8")
        (study.folder / TABLES).mkdir(exist_ok=True)
        for old in (study.folder / TABLES).glob("*.csv"):
            old.unlink()
        for table in tables:
            table.write_csv(study.folder / TABLES / f"{table.name}.csv")
    except OSError as error:
        raise CodedError("cannot_write_into", folder=str(study.folder), reason=error.strerror) from None
    return study.folder / PAGE


def notices(study: StudyResults) -> List[str]:
    """Returns what readers must know before any figure."""
    people = study.runs.participant.nunique()
    sentences = [f"{people} people, {len(study.runs)} runs."]
    if not study.has_people:
        sentences = [
            f"This is a simulation: {people} simulated people, {len(study.runs)} runs. No person took part. The figures follow "
            "from the assumptions in config/assumptions.yaml; they predict nothing about people, and user experience is not examined."
        ]
    names = ("revision", "command", "machine", "date")
    facts = [f"{name} {study.meta[name]}" for name in names if study.meta.get(name)]
    if facts:
        sentences.append("Made by: " + "; ".join(facts))
    deviating = study.meta["deviating"]
    if deviating:
        sentences.append(
            f"{deviating} runs were not done in the planned condition and are left out; runs.csv has them."
        )
    if study.missing:
        sentences.append(
            f"Missing runs ({len(study.missing)}): {'; '.join(study.missing[:12])}. Means take the runs that are there, "
            "differences the participants who have both."
        )
    return sentences
