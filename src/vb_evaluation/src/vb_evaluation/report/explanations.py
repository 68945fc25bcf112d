"""What differs from the paper and why, in words that the numbers of the study decide."""
from __future__ import annotations

from typing import Any, List, Sequence

from vb_evaluation.report.contents import Contents
from vb_evaluation.report.data import STATES, Study
from vb_evaluation.report.paper import PAPER, method_title, scenario_title
from vb_evaluation.report.sweeps import Curve


def differences(study: Study, contents: Contents) -> List[List[Any]]:
    """Sentences about where study and paper differ, and what is known of the reasons."""
    return []


def curve_words(curves: Sequence[Curve]) -> List[Any]:
    """One sentence on a sweep: the speed-up at its ends."""
    words: List[Any] = []
    for curve in curves:
        known = [point for point in curve.points if point.speedup.known]
        if len(known) > 1:
            words += [scenario_title(curve.scenario), ": speed-up ", known[0].speedup, f" at {known[0].value}, ", known[-1].speedup,
                      f" at {known[-1].value}. "]
    return words
