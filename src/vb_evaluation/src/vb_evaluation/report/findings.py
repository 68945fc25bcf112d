"""Answers a study's questions by rules that are written down before it is run. The answers make up its published page.

They replace the text between two marks in a Markdown page, together with the report's tables. No figure is copied by
hand, and a test finds a page that does not match its rows.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, Mapping

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_evaluation import statistics
from vb_evaluation.report import paper_results
from vb_evaluation.report.html_page import report_tables
from vb_evaluation.report.paper_results import METHODS
from vb_evaluation.report.study_files import StudyResults, read_study, select

BEGIN, END = "<!-- what follows is written by study_kit report --page -->", "<!-- end of what is written -->"
# scenario: the paper's difference of the median Jaccard indices, which it calls significant
EFFECTS = {"carpet": 0.077, "corner": -0.028}


def format_findings(study: StudyResults) -> List[str]:
    """Formats the answers and the report's tables as Markdown. Leaves out questions about what was not run.

    Raises:
        CodedError: "no_comparison" if only one method was run.
    """
    if len(study.methods) < 2:
        raise CodedError("no_comparison", "the answers compare two methods, and the study has runs of only one")
    tables = report_tables(study)
    answers = answer_questions(study, {table.name: table.rows for table in tables})
    revisions = sorted(set(study.runs["revision"])) if "revision" in study.runs else [study.meta.get("revision", "?")]
    return [
        f"{study.runs.participant.nunique()} people, {len(study.runs)} runs, seed {study.meta.get('seed', '?')}, revision "
        f"{' and '.join(revisions)}.",
        "\n".join(f"{number}. {answer}." for number, answer in enumerate(answers, 1)),
        *(f"### {table.title}\n\n{table.markdown()}" for table in tables),
    ]


def answer_questions(study: StudyResults, rows: Mapping[str, List[Dict[str, Any]]]) -> List[str]:
    """Returns a sentence for each question, from the tables' rows by name, which also hold the figures."""
    faster = [row["Speed-up"].low > 1.0 for row in rows["summary"]]
    *accuracy, completed = rows["not_worse"]
    is_exact = all(row["Reading"] == "not worse" for row in accuracy)
    sentences = [
        f"**Faster?** {'Yes' if all(faster) else 'Not shown'}: in {sum(faster)} of {len(faster)} scenarios the speed-up's "
        "interval is above 1",
        f"**Not less exact?** {'Yes' if is_exact else 'Not shown'}: {_counts(accuracy)}",
        f"**Completed as often?** {completed['Reading'].capitalize()}: a difference of {completed['Gain [90 %]']} points",
    ]
    if "beside_the_paper" in rows:
        sentences.append(f"**The paper's people?** {_counts(rows['beside_the_paper'])}; better is disagreement as well")
        effects = "; ".join(_effect(study, key) for key in EFFECTS if key in study.scenarios)
        sentences += [f"**The paper's effects on accuracy?** {effects}"] if effects else []
    if "outcome" in study.runs and study.runs.pointed_right.notna().any():
        saved = select(study.runs, method=METHODS[0], outcome="saved", pointed_right=1)
        share = statistics.percentage(saved.seed_is_right == 0)
        sentences.append(
            f"**The side that people pointed at?** Of {len(saved)} borders that the network robot system saved for people who "
            f"pointed at the right side, {share.text(1)} % restrict the other one"
        )
    if "worlds" in rows:
        shares = [
            f"{row['Conclusion']} in {row['holds in [%] of worlds'].text(0)} % of {row['Number']}"
            for row in rows["worlds"]
            if row["Worlds"] == "all"
        ]
        sentences.append(f"**In plausible worlds?** {'; '.join(shares)}")
    return sentences


def _counts(rows: List[Dict[str, Any]]) -> str:
    readings = [row["Reading"] for row in rows]
    return f"{', '.join(f'{readings.count(word)} {word}' for word in sorted(set(readings)))}, of {len(readings)}"


def _effect(study: StudyResults, scenario: str) -> str:
    """Tells whether the paper's effect on accuracy was found again: our interval has it, and not 0."""
    effect = EFFECTS[scenario]
    here = statistics.hodges_lehmann(study.differences(study.runs, "jaccard")[scenario])
    has_effect = here.low <= effect <= here.high
    has_zero = here.low <= 0.0 <= here.high
    found = "found" if has_effect and not has_zero else "not found"
    there = statistics.format_number(effect, 3)
    return f"{paper_results.scenario_title(scenario)} {there} there, {here.text(3)} here: {found} again"


def write_page(folder: Path, page: Path) -> None:
    """Puts the answers of a study's folder between the marks of a page.

    Raises:
        CodedError: "bad_study"; "no_place" if the page lacks the marks.
    """
    text = page.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise CodedError("no_place", f"{page} needs these two lines, once each:\n{BEGIN}\n{END}")
    before, _, _ = text.partition(BEGIN)
    _, _, after = text.partition(END)
    blocks = [before + BEGIN, *format_findings(read_study(folder)), END + after]
    write_atomically(page, "\n\n".join(blocks).encode("utf-8"))
