"""Answers a study's questions by rules that are written down before it is run. The answers make up its published page.

They replace the text between two marks in a Markdown page, together with their tables and every run that was not
completed. No figure is copied by hand, and a test finds a page that does not match its rows.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, paper_results
from vb_evaluation.report.html_page import SECTIONS
from vb_evaluation.report.blocks import Table
from vb_evaluation.report.paper_results import METHODS
from vb_evaluation.report.study_files import StudyResults, read_study, select

BEGIN, END = "<!-- what follows is written by study_kit report --page -->", "<!-- end of what is written -->"
# titles of the report's tables that are written, in this order
TABLES = {
    "summary": "Network robot system against robot alone, by person",
    "not_worse": "Not worse by a margin",
    "error": "Boundary error",
    "accuracy": "Jaccard index",
    "completeness": "Completed",
    "not_completed": "Every run that was not completed",
    "beside_the_paper": "Beside the paper",
    "worlds": "Plausible worlds",
}
# scenario: the paper's difference of the median Jaccard indices, which it calls significant
EFFECTS = {"carpet": 0.077, "corner": -0.028}


def format_findings(study: StudyResults) -> List[str]:
    """Formats the answers as Markdown paragraphs and tables. Leaves out questions about what was not run.

    Raises:
        CodedError: "no_comparison" if only one method was run.
    """
    if len(study.methods) < 2:
        raise CodedError("no_comparison", "the answers compare two methods, and the study has runs of only one")
    tables = [block for _, _, section in SECTIONS for block in section(study) if isinstance(block, Table)]
    tables = {table.name: table for table in tables if table.rows}
    revisions = sorted(set(study.runs["revision"])) if "revision" in study.runs else [study.meta.get("revision", "?")]
    parts = [
        f"{study.runs.participant.nunique()} people, {len(study.runs)} runs, seed {study.meta.get('seed', '?')}, revision "
        f"{' and '.join(revisions)}.",
        "\n".join(f"{number}. {answer}." for number, answer in enumerate(_answer_questions(study, tables), 1)),
    ]
    for name, title in TABLES.items():
        if name in tables:
            parts += [". ".join(filter(None, (f"**{title}**", tables[name].explanation))), tables[name].markdown()]
    return parts


def _answer_questions(study: StudyResults, tables: Dict[str, Table]) -> List[str]:
    """Returns a sentence for each question, from the tables by name, which also hold the figures."""
    faster = [row["speedup"].low > 1.0 for row in tables["summary"].rows]
    *accuracy, completed = tables["not_worse"].rows
    exact = all(row["reading"] == "not worse" for row in accuracy)
    sentences = [
        f"**Faster?** {'Yes' if all(faster) else 'Not shown'}: in {sum(faster)} of {len(faster)} scenarios the speed-up's "
        "interval is above 1",
        f"**Not less exact?** {'Yes' if exact else 'Not shown'}: {_counts(accuracy)}",
        f"**Completed as often?** {completed['reading'].capitalize()}: a difference of {completed['gain']} points",
    ]
    if "beside_the_paper" in tables:
        readings = _counts(tables["beside_the_paper"].rows)
        sentences.append(f"**The paper's people?** {readings}; better is disagreement as well")
        effects = "; ".join(_effect(study, key) for key in EFFECTS if key in study.scenarios)
        sentences += [f"**The paper's effects on accuracy?** {effects}"] if effects else []
    if study.runs.pointed_right.notna().any():
        saved = select(study.runs, method=METHODS[0], outcome="saved", pointed_right=1)
        share = statistics.proportion(int((saved.seed_is_right == 0).sum()), len(saved)).scaled(100.0)
        sentences.append(
            f"**The side that people pointed at?** Of {len(saved)} borders that the network robot system saved for people who "
            f"pointed at the right side, {share.text(1)} % restrict the other one"
        )
    if "worlds" in tables:
        all_worlds = [row for row in tables["worlds"].rows if row["worlds"] == "all"]
        shares = (f"{row['conclusion']} in {row['holds'].text(0)} % of {row['n']}" for row in all_worlds)
        sentences.append(f"**In plausible worlds?** {'; '.join(shares)}")
    return sentences


def _counts(rows: List[Dict[str, Any]]) -> str:
    readings = [row["reading"] for row in rows]
    return f"{', '.join(f'{readings.count(word)} {word}' for word in sorted(set(readings)))}, of {len(readings)}"


def _effect(study: StudyResults, scenario: str) -> str:
    difference = effect_sizes.paired_shift(select(study.runs, scenario=scenario), "jaccard", METHODS, True)
    is_found = difference.low <= EFFECTS[scenario] <= difference.high and not difference.low <= 0.0 <= difference.high
    return (
        f"{paper_results.scenario_title(scenario)} {statistics.format_number(EFFECTS[scenario], 3)} there, {difference.text(3)} here: "
        f"{'found' if is_found else 'not found'} again"
    )


def write_page(folder: Path, page: Path) -> None:
    """Puts the answers of a study's folder between the marks of a page.

    Raises:
        CodedError: "bad_study"; "no_place" if the page lacks the marks.
    """
    text = page.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise CodedError("no_place", f"{page} needs these two lines, once each:\n{BEGIN}\n{END}")
    written = "\n\n".join(format_findings(read_study(folder)))
    head, tail = text.split(BEGIN)[0], text.split(END)[1]
    write_atomically(page, f"{head}{BEGIN}\n\n{written}\n\n{END}{tail}".encode("utf-8"))
