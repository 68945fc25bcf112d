"""Answers a study's questions by rules that are written down before it is run."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping

from vb_evaluation import statistics
from vb_evaluation.report.comparisons import COMPLETED, GAIN, MEASURE, READING, speed_up
from vb_evaluation.report.cross_checks import CONCLUSION, HOLDS, NUMBER, WORLDS
from vb_evaluation.report.paper_results import METHODS
from vb_evaluation.report.study_files import StudyResults, select
from vb_evaluation.statistics import format_number

# scenario: the paper's difference of the median Jaccard indices, which it calls significant
EFFECTS = {"carpet": 0.077, "corner": -0.028}


def answer_questions(study: StudyResults, rows: Mapping[str, List[Dict[str, Any]]]) -> List[str]:
    """Returns a sentence for each question, from the study and its tables' rows by name; [] if one method was run."""
    if "margins" not in rows:
        return []
    faster = [speed_up(study, scenario).low > 1.0 for scenario in study.scenarios]
    accuracy = [row for row in rows["margins"] if row[MEASURE] != COMPLETED.title]
    completed = next(row for row in rows["margins"] if row[MEASURE] == COMPLETED.title)
    is_exact = all(row[READING] == "not worse" for row in accuracy)
    sentences = [
        f"**Faster?** {'Yes' if all(faster) else 'Not shown'}: in {sum(faster)} of {len(faster)} scenarios the speed-up's "
        "interval is above 1",
        f"**Not less exact?** {'Yes' if is_exact else 'Not shown'}: {_counts(accuracy)}",
        f"**Completed as often?** {completed[READING].capitalize()}: a difference of {completed[GAIN]} points",
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
        everywhere = [row for row in rows["worlds"] if row[WORLDS] == "all"]
        shares = [f"{row[CONCLUSION]} in {row[HOLDS]} % of {row[NUMBER]}" for row in everywhere]
        sentences.append(f"**In plausible worlds?** {'; '.join(shares)}")
    return sentences


def _counts(rows: List[Dict[str, Any]]) -> str:
    readings = [row[READING] for row in rows]
    return f"{', '.join(f'{readings.count(word)} {word}' for word in sorted(set(readings)))}, of {len(readings)}"


def _effect(study: StudyResults, scenario: str) -> str:
    """Tells whether the paper's effect on accuracy was found again: our interval has it, and not 0."""
    effect = EFFECTS[scenario]
    here = statistics.hodges_lehmann(study.differences("jaccard", scenario))
    has_effect = here.low <= effect <= here.high
    has_zero = here.low <= 0.0 <= here.high
    found = "found" if has_effect and not has_zero else "not found"
    return f"{study.scenarios[scenario]} {format_number(effect, 3)} there, {here.text(3)} here: {found} again"
