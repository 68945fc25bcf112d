"""Writes the report: one page without external resources, and each of its tables as CSV.

Sections come in order of importance: how far the border is from the intended one, then time, then the paper's
Jaccard index. Every figure comes with its limits. For simulated people, effects have intervals but no p: as
their number is arbitrary, any effect can be made significant. For real people, the paper's tests are reported too.
"""

from __future__ import annotations

from pathlib import Path
from typing import Callable, List, Tuple

import jinja2
from markupsafe import Markup

from vb_core.errors import CodedError
from vb_evaluation.report import cross_checks, outcomes, questionnaire
from vb_evaluation.report.blocks import Block, Table
from vb_evaluation.report.study_files import StudyResults, read_study, write_table

PAGE, TABLES = "report.html", "tables"
# (id, title, function that makes the blocks); a section without blocks is left out
SECTIONS: Tuple[Tuple[str, str, Callable[[StudyResults], List[Block]]], ...] = (
    ("summary", "Findings", outcomes.summary_section),
    ("error", "Boundary error", outcomes.error_section),
    ("time", "Interaction time", outcomes.time_section),
    ("accuracy", "Jaccard index", outcomes.accuracy_section),
    ("completeness", "Completeness", outcomes.completeness_section),
    ("paper", "Beside the paper", cross_checks.paper_comparison_section),
    ("worlds", "Plausible worlds", cross_checks.plausible_worlds_section),
    ("experience", "People and their experience", questionnaire.participants_section),
    ("runs", "The runs", questionnaire.runs_section),
)


def write_report(folder: Path) -> Path:
    """Writes report.html and tables/*.csv into a study's folder. The page omits what the folder lacks.

    Returns:
        The page.

    Raises:
        CodedError: "bad_study" naming the file, and the line or column; "cannot_write_into".
    """
    study = read_study(folder)
    template_folder = Path(__file__).parent
    sections = [(name, title, make(study)) for name, title, make in SECTIONS]
    sections = [section for section in sections if section[2]]
    loader = jinja2.FileSystemLoader(str(template_folder))
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    text = environment.get_template("report.html.j2").render(
        title=f"Drawing virtual borders: the study with {'people' if study.has_people else 'simulated people'}",
        notices=notices(study),
        sections=sections,
        css=Markup((template_folder / "report.css").read_text(encoding="utf-8")),
    )
    try:
        (study.folder / PAGE).write_text(text, encoding="utf-8")
        (study.folder / TABLES).mkdir(exist_ok=True)
        for old in (study.folder / TABLES).glob("*.csv"):
            old.unlink()
        for table in (block for _, _, blocks in sections for block in blocks if isinstance(block, Table)):
            rows = [table.csv_row(row) for row in table.rows]
            if rows:
                longest = max((list(row) for row in rows), key=len)
                write_table(study.folder / TABLES / f"{table.name}.csv", longest, rows)
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
    count = study.meta.get("deviating")
    if count:
        sentences.append(f"{count} runs were not done in the planned condition and are left out; runs.csv has them.")
    if study.missing:
        sentences.append(
            f"Missing runs ({len(study.missing)}): {'; '.join(study.missing[:12])}. Means take the runs that are there, "
            "differences the participants who have both."
        )
    return sentences
