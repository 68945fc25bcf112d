"""Answers a study's questions by rules that are written down before it is run; the answers make up its published page.

The text between two marks in a Markdown page is replaced by the answers, their tables, and every run that was not
completed. No figure is copied by hand, and a test finds a page that does not match its rows.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List

from vb_core.errors import CodedError
from vb_core.files import write_atomically
from vb_evaluation import statistics
from vb_evaluation.report import effect_sizes, paper_results
from vb_evaluation.report.page_blocks import Grid
from vb_evaluation.report.study_files import StudyResults, read_study, select
from vb_evaluation.report.html_page import SECTIONS
from vb_evaluation.report.paper_results import METHODS

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


def answers(study: StudyResults) -> List[str]:
    """Formats the answers as Markdown paragraphs and tables; leaves out questions about what was not run.

    Raises:
        CodedError: "no_comparison" if only one method was run.
    """
    if len(study.methods) < 2:
        raise CodedError("no_comparison", "the answers compare two methods, and the study has runs of only one")
    made = [block for _, _, section in SECTIONS for block in section(study) if isinstance(block, Grid)]
    grids = {grid.name: grid for grid in made if grid.rows}
    revisions = sorted(set(study.runs["revision"])) if "revision" in study.runs else [study.meta.get("revision", "?")]
    found = [
        f"{study.runs.participant.nunique()} people, {len(study.runs)} runs, seed {study.meta.get('seed', '?')}, revision "
        f"{' and '.join(revisions)}.",
        "\n".join(f"{number}. {words}." for number, words in enumerate(_answers(study, grids), 1)),
    ]
    for name, title in TABLES.items():
        if name in grids:
            found += [". ".join(filter(None, (f"**{title}**", grids[name].words))), grids[name].markdown()]
    return found


def _answers(study: StudyResults, grids: Dict[str, Grid]) -> List[str]:
    faster = [row["speedup"].low > 1.0 for row in grids["summary"].rows]
    *accuracy, completed = grids["not_worse"].rows
    exact = all(row["reading"] == "not worse" for row in accuracy)
    found = [
        f"**Faster?** {'Yes' if all(faster) else 'Not shown'}: in {sum(faster)} of {len(faster)} scenarios the speed-up's "
        "interval is above 1",
        f"**Not less exact?** {'Yes' if exact else 'Not shown'}: {_counts(accuracy)}",
        f"**Completed as often?** {completed['reading'].capitalize()}: a difference of {completed['gain']} points",
    ]
    if "beside_the_paper" in grids:
        found.append(
            f"**The paper's people?** {_counts(grids['beside_the_paper'].rows)}; better is disagreement as well"
        )
        effects = "; ".join(_effect(study, key) for key in EFFECTS if key in study.scenarios)
        found += [f"**The paper's effects on accuracy?** {effects}"] if effects else []
    if study.runs.pointed_right.notna().any():
        there = select(study.runs, method=METHODS[0], outcome="saved", pointed_right=1)
        share = statistics.proportion(int((there.seed_is_right == 0).sum()), len(there)).scaled(100.0)
        found.append(
            f"**The side that people pointed at?** Of {len(there)} borders that the network robot system saved for people who "
            f"pointed at the right side, {share.text(1)} % restrict the other one"
        )
    if "worlds" in grids:
        whole = [row for row in grids["worlds"].rows if row["worlds"] == "all"]
        shares = (f"{row['conclusion']} in {row['holds'].text(0)} % of {row['n']}" for row in whole)
        found.append(f"**In plausible worlds?** {'; '.join(shares)}")
    return found


def _counts(rows: List[Dict[str, Any]]) -> str:
    readings = [row["reading"] for row in rows]
    return f"{', '.join(f'{readings.count(word)} {word}' for word in sorted(set(readings)))}, of {len(readings)}"


def _effect(study: StudyResults, scenario: str) -> str:
    here = effect_sizes.shift(select(study.runs, scenario=scenario), "jaccard", METHODS, True)
    again = here.low <= EFFECTS[scenario] <= here.high and not here.low <= 0.0 <= here.high
    return (
        f"{paper_results.scenario_title(scenario)} {statistics.format_number(EFFECTS[scenario], 3)} there, {here.text(3)} here: "
        f"{'found' if again else 'not found'} again"
    )


def write_page(folder: Path, page: Path) -> None:
    """Puts the answers of a study's folder between the marks of a page.

    Raises:
        CodedError: "bad_study"; "no_place" if the page lacks the marks.
    """
    text = page.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise CodedError("no_place", f"{page} needs these two lines, once each:\n{BEGIN}\n{END}")
    written = "\n\n".join(answers(read_study(folder)))
    head, tail = text.split(BEGIN)[0], text.split(END)[1]
    write_atomically(page, f"{head}{BEGIN}\n\n{written}\n\n{END}{tail}".encode("utf-8"))
