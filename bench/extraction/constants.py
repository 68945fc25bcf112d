#!/usr/bin/env python3
"""What the extraction's constants do: each is halved and doubled, and hard drawings are extracted again.

    python3 bench/extraction/constants.py --csv docs/results/extraction/constants.csv      takes about 20 minutes

Constants are all numbers that the extraction's modules name, and all decimal numbers within their expressions, but those
that only keep a division from failing. The drawings are for development (seeds below 1,000), harder than any that
accuracy is told of: twice as many strays, images and bursts missing, cameras that are 5 cm off, robots that are lost,
slow and quick hands, small rings, seeds that were held elsewhere before. A row says how many are bad, and with each
factor how many are bad and how many were good or bad only with it or only without it.
"""

from __future__ import annotations

import ast
import copy
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Iterator, List, Optional, Tuple

import numpy as np

from bench.extraction import model_hand as hand
from bench.extraction import samples
from bench.extraction.accuracy import measure
from bench.frame import TOP, Table, arguments, import_from, share

PACKAGE = TOP / "src" / "vb_fusion"
FILES = ("extraction.py", "stroke/*.py", "line/*.py")
FACTORS = (0.5, 2.0)
NO_DIVISOR = 1e-4  # and below it: keeps a division from failing
HARD = hand.Eyes(bias=0.06, tremor=0.02, dropped=0.5, bursts=1.5, strays=0.15)


@dataclass
class Drawing:
    """What was seen of one drawing, and whether a version gets it wrong."""

    row: str
    is_bad: Callable[[Any], bool]


def hard_drawings(times: float) -> Iterator[Drawing]:
    """Yields the drawings; the same for every version."""
    for number, (name, (make, _, _)) in enumerate(hand.ROWS.items()):
        for seed in range(int(30 * times)) if "clock" not in name else ():
            rng = np.random.default_rng([seed, 500 + number])
            scene = make(rng)
            points, stamps, cameras = hand.look(scene, HARD, rng)
            known = {"points": points, "stamps": stamps, "cameras": cameras}
            judged = _seed_is_bad if make is hand.held else _scene_is_bad
            yield Drawing(name, lambda modules, scene=scene, known=known, judged=judged: judged(modules, scene, known))
    people = [one for one in samples.people.drawings() if samples.people.half(one) == "develop"]
    lost = samples.people.Localization(0.05, 0.05, 3.0)
    for name, seen in (
        ("people, quick", samples.people.Seen(speed=(0.6, 1.2), outliers=0.2)),
        ("people, two images of three dropped", samples.people.Seen(dropped=0.67, outliers=0.2)),
        ("people, a lost robot", samples.people.Seen(robot=lost, dropped=0.5, outliers=0.1)),
    ):
        for number, drawing in enumerate(people[: int(len(people) * times) + 1]):
            stroke = samples.people.see(drawing, seen, np.random.default_rng([700, number]))
            yield Drawing(name, lambda modules, stroke=stroke: _stroke_is_bad(modules, stroke, True))
    rough = samples.SETTINGS["rough"].replace(outliers=0.3, dropped=0.6)
    for name in ("usual", "gap 0.4 m", "ends 0.4 m apart", "ends overlap 0.4 m", "drawn twice"):
        setting, count = samples.SETTINGS[name], max(1, int(6 * times))
        setting = rough.replace(**{key: getattr(setting, key) for key in ("gap", "end_gap", "overlap", "passes")})
        for shape in ("rectangle", "U", "narrow_U", "corner") if name in ("usual", "drawn twice") else ("L", "U"):
            for seed in range(count):
                stroke = samples.draw(shape, setting, np.random.default_rng([seed, 900]))
                yield Drawing(
                    f"generator, {name}", lambda modules, stroke=stroke: _stroke_is_bad(modules, stroke, False)
                )
    for cell, strokes in samples.disturbed(max(1, int(9 * times)), 0):
        for stroke in strokes if "held" in cell or "throughout" in cell or "interleaved" in cell else ():
            yield Drawing("disturbed", lambda modules, stroke=stroke: _stroke_is_bad(modules, stroke, False))


def _stroke_is_bad(modules: List[Any], stroke: samples.Stroke, of_people: bool) -> bool:
    extraction = modules[0]

    def extract(one: samples.Stroke) -> Any:
        mobile = {} if one.mobile is None else {"mobile": one.mobile}
        return extraction.extract_border(one.points, stamps=one.stamps, cameras=one.cameras, **mobile)

    found = measure(stroke, extract, of_people)
    return bool(found["bad"]) or not found["kind"]


def _scene_is_bad(modules: List[Any], scene: hand.Scene, known: dict) -> bool:
    try:
        chain = modules[0].extract_border(**known)
    except Exception as error:  # the class is another version's
        if type(error).__name__ not in ("ExtractionError", "CodedError"):
            raise
        return True
    truth = scene.truth[np.append(True, np.hypot(*np.diff(scene.truth, axis=0).T) > 1e-9)]
    return chain.closed != scene.closed or samples.hausdorff(chain.points, truth, scene.closed) > hand.BAD_M


def _seed_is_bad(modules: List[Any], scene: hand.Scene, known: dict) -> bool:
    return float(np.hypot(*(scene.truth[0] - modules[0].extract_seed(**known)))) > 0.15


def constants(path: Path) -> Iterator[Tuple[str, int, float, Callable[[float], ast.Module]]]:
    """Yields a file's constants: what it is called, its line and value, and a function that makes the file with another."""
    tree = ast.parse(path.read_text(encoding="utf-8"))

    def changed(index: int, factor: float) -> ast.Module:
        new = copy.deepcopy(tree)
        node = list(ast.walk(new))[index]
        if isinstance(node, ast.Assign):
            number = ast.parse(f"type(_)(max(1, round(_ * {factor}))) if type(_) is int else _ * {factor}", mode="eval")
            node.value = ast.parse(f"(lambda _: {ast.unparse(number)})({ast.unparse(node.value)})", mode="eval").body
        else:
            node.value *= factor  # type: ignore[attr-defined]
        return ast.fix_missing_locations(new)

    named = {}
    for statement in tree.body:
        if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
            name = statement.targets[0].id
            if name.isupper():
                named[statement] = name
    inside = {
        one
        for statement in tree.body
        if isinstance(statement, (ast.Assign, ast.ClassDef))
        for one in ast.walk(statement)
    }
    values = import_from(None, _module(path))[0]
    for index, node in enumerate(ast.walk(tree)):
        if node in named and isinstance(getattr(values, named[node]), (int, float)):
            yield named[node], node.lineno, float(getattr(values, named[node])), lambda f, i=index: changed(i, f)
        elif isinstance(node, ast.Constant) and type(node.value) is float and node not in inside:
            if NO_DIVISOR < abs(node.value) and node.value not in (1.0,):
                yield "", node.lineno, node.value, lambda f, i=index: changed(i, f)


def _module(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE / "src").with_suffix("").parts)


def judge(source: Optional[Path], drawings: List[Drawing]) -> np.ndarray:
    """Returns which of the drawings a version gets wrong, (N,) bool."""
    modules = import_from(source, "vb_fusion.extraction")
    return np.array([one.is_bad(modules) for one in drawings])


def main() -> None:
    """Writes a row for each constant."""
    parser = arguments(__doc__)
    parser.add_argument("--times", type=float, default=1.0, help="of the number of drawings")
    parser.add_argument("--only", nargs="*", default=[""], help="constants with one of these in their names or lines")
    given = parser.parse_args()
    drawings, table = list(hard_drawings(given.times)), Table(given.csv)
    usual = judge(None, drawings)
    if "" in given.only:
        table.add(
            constant="none",
            value="",
            line="",
            **{f"times {factor:g}": share(int(usual.sum()), len(usual)) for factor in FACTORS},
        )
    for path in sorted(path for pattern in FILES for path in (PACKAGE / "src" / "vb_fusion").glob(pattern)):
        lines = path.read_text(encoding="utf-8").splitlines()
        for name, line, value, make in constants(path):
            text = f"{path.stem}: " + lines[line - 1].split("  #")[0].strip()
            if not any(part in text for part in given.only):
                continue
            row = {"constant": name or "within", "value": value, "line": text}
            for factor in FACTORS:
                with tempfile.TemporaryDirectory() as folder:
                    copied = Path(folder) / "vb_fusion"
                    shutil.copytree(PACKAGE / "src", copied / "src", ignore=shutil.ignore_patterns("__pycache__"))
                    shutil.copy(PACKAGE / "package.xml", copied)
                    (copied / "src" / path.relative_to(PACKAGE / "src")).write_text(ast.unparse(make(factor)))
                    try:
                        bad = judge(Path(folder), drawings)
                    except Exception as error:  # the rest of the code takes no such number
                        row[f"times {factor:g}"] = f"fails: {type(error).__name__}"
                        continue
                new, gone = int((bad & ~usual).sum()), int((usual & ~bad).sum())
                row[f"times {factor:g}"] = f"{share(int(bad.sum()), len(bad))}, {new} new, {gone} gone"
            table.add(**row)


if __name__ == "__main__":
    main()
