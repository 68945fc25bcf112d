"""Writes the report, section by section; every figure comes with what limits it.

The order is by importance: how far the border is from where it was wanted, then time, then the paper's Jaccard
index. For simulated people, effects have intervals and no p: their number is free, so that any effect can be
made significant. For real people, the paper's tests are reported too.
"""
from __future__ import annotations

from typing import List

from vb_evaluation.report import background, beside, outcomes, sensitivity
from vb_evaluation.report.blocks import Section
from vb_evaluation.report.data import Study

_SIZES = {
    "quick": ["A quick run, to see that all works: two people, so that there are no intervals, no worlds and no curves."],
    "usual": ["The usual size: few plausible worlds, which say how often a conclusion holds to within some ten percentage points but "
              "not which assumption decides, and no curves. `make study SIZE=full` has both and takes some hours."],
}


def title(study: Study) -> str:
    """The page's heading."""
    kind = "people" if study.people else "simulated people"
    return f"Drawing virtual borders: the study with {kind}"


def notices(study: Study) -> List[str]:
    """What readers must know before any figure."""
    count = len(study.runs.distinct("participant"))
    found = [f"{count} people, {len(study.runs.rows)} runs." if study.people else (
        f"This is a simulation: {count} simulated people, {len(study.runs.rows)} runs. No person took part. The figures follow "
        "from the assumptions that are listed below; they predict nothing about people, and user experience is not examined.")]
    made = [f"{name} {study.meta[name]}" for name in ("revision", "command", "machine", "date") if study.meta.get(name)]
    if made:
        found.append("Made by: " + "; ".join(made))
    if study.meta.get("deviating"):
        found.append(f"{study.meta['deviating']} runs were not done in the planned condition and are left out; runs.csv has them.")
    found += _SIZES.get(study.meta.get("size"), [])
    if study.missing:
        found.append(f"Missing runs ({len(study.missing)}): {'; '.join(study.missing[:12])}. Means take the runs that are there, "
                     "differences the participants who have both.")
    return found


def all_sections(study: Study) -> List[Section]:
    """Every section for which the study has something."""
    found = [
        outcomes.summary(study), outcomes.error(study), outcomes.time(study), outcomes.accuracy(study), outcomes.completeness(study),
        beside.beside(study), sensitivity.plausible(study), sensitivity.curves(study), sensitivity.ungated(study),
        background.order(study), background.experience(study), background.assumptions(study), background.runs(study)]
    return [section for section in found if section.blocks]
