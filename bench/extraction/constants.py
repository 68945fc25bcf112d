#!/usr/bin/env python3
"""What the extraction's constants do: each is halved and doubled, and hard drawings are extracted again.

    python3 bench/extraction/constants.py --csv docs/results/extraction/constants.csv      takes about 20 minutes

Constants as varied.py has them. The drawings are for development (seeds below 1,000), harder than any that
accuracy is told of: twice as many strays, images and bursts missing, cameras that are 5 cm off, robots that are lost,
slow and quick hands, small rings, seeds that were held elsewhere before. A row says how many are bad, and with each
factor how many are bad and how many were good or bad only with it or only without it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable, Iterator, List, Optional

import numpy as np

from bench import varied
from bench.extraction import hand, model_hand, samples
from bench.extraction.accuracy import extracting, measure
from bench.frame import Table, arguments, import_from, share

IsBad = Callable[[List[Any]], bool]  # whether a version, of which these are modules, gets a drawing wrong
HARD = hand.Eyes(bias=0.06, tremor=0.02, dropped=0.5, bursts=1.5, strays=0.15)


def hard_drawings(times: float) -> Iterator[IsBad]:
    """Yields the drawings; the same for every version."""
    for number, (name, (make, _, _)) in enumerate(model_hand.ROWS.items()):
        for seed in range(int(30 * times)) if "clock" not in name else ():
            judged = model_hand.judge_seed if make is hand.held else model_hand.judge

            def is_bad(
                modules: List[Any], judged: Any = judged, make: Any = make, seeds: Any = (seed, 500 + number)
            ) -> bool:
                return bool(judged(make, HARD, modules, np.random.default_rng(seeds))[0])

            yield is_bad
    people = [one for one in samples.people.drawings() if samples.people.half(one) == "develop"]
    lost = samples.people.Localization(0.05, 0.05, 3.0)
    for seen in (
        samples.people.Seen(speed=(0.6, 1.2), outliers=0.2),
        samples.people.Seen(dropped=0.67, outliers=0.2),
        samples.people.Seen(robot=lost, dropped=0.5, outliers=0.1),
    ):
        for number, drawing in enumerate(people[: int(len(people) * times) + 1]):
            stroke = samples.people.see(drawing, seen, np.random.default_rng([700, number]))
            yield lambda modules, stroke=stroke: _stroke_is_bad(modules, stroke, True)
    rough = samples.SETTINGS["rough"].replace(outliers=0.3, dropped=0.6)
    for name in ("usual", "gap 0.4 m", "ends 0.4 m apart", "ends overlap 0.4 m", "drawn twice"):
        setting, count = samples.SETTINGS[name], max(1, int(6 * times))
        setting = rough.replace(**{key: getattr(setting, key) for key in ("gap", "end_gap", "overlap", "passes")})
        for shape in ("rectangle", "U", "narrow_U", "corner") if name in ("usual", "drawn twice") else ("L", "U"):
            for seed in range(count):
                stroke = samples.draw(shape, setting, np.random.default_rng([seed, 900]))
                yield lambda modules, stroke=stroke: _stroke_is_bad(modules, stroke, False)
    for cell, strokes in samples.disturbed(max(1, int(9 * times)), 0):
        for stroke in strokes if "held" in cell or "throughout" in cell or "interleaved" in cell else ():
            yield lambda modules, stroke=stroke: _stroke_is_bad(modules, stroke, False)


def _stroke_is_bad(modules: List[Any], stroke: samples.Stroke, of_people: bool) -> bool:
    found = measure(stroke, extracting(modules[0]), of_people)
    return bool(found["bad"]) or not found["kind"]


def judge(source: Optional[Path], drawings: List[IsBad]) -> np.ndarray:
    """Returns which of the drawings a version gets wrong, (N,) bool."""
    modules = import_from(source, *model_hand.MODULES)
    return np.array([is_bad(modules) for is_bad in drawings])


def main() -> None:
    """Writes a row for each constant."""
    parser = arguments(__doc__)
    parser.add_argument("--times", type=float, default=1.0, help="of the number of drawings")
    parser.add_argument("--only", nargs="*", default=[""], help="constants with one of these in their names or lines")
    given = parser.parse_args()
    drawings, table = list(hard_drawings(given.times)), Table(given.csv)
    usual = judge(None, drawings)
    print(f"as it is: {share(int(usual.sum()), len(usual))} bad", flush=True)

    def compare(source: Path) -> str:
        bad = judge(source, drawings)
        new, gone = int((bad & ~usual).sum()), int((usual & ~bad).sum())
        return f"{share(int(bad.sum()), len(bad))}, {new} new, {gone} gone"

    for row in varied.rows("vb_fusion", ("extraction.py", "stroke/*.py", "line/*.py"), given.only, compare):
        table.add(**row)


if __name__ == "__main__":
    main()
