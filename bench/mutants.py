#!/usr/bin/env python3
"""Mutation testing: small faults are put into pure modules, and the modules' unit tests must notice them.

    python3 bench/mutants.py                                         8 mutants of each module in MODULES
    python3 bench/mutants.py --modules vb_robot.driving.gate --each 100
    python3 bench/mutants.py --seed 2 --csv survivors.csv            other mutants: those of another seed were kept back

A mutant swaps a comparison or `and` with `or`, changes a number, negates a condition, returns nothing, or leaves a
statement out. A mutant that no test fails on is printed with its line; whether it means the same as the original must be
looked at. A test that runs longer than a minute has noticed. Each mutant runs in a fork that finds its source instead of
the file's; the files stay as they are.
"""

import ast
import copy
import importlib.machinery
import importlib.util
import os
import signal
import sys
from pathlib import Path
from typing import Any, Callable, Iterator, List, Tuple

import numpy as np
import pytest
import scipy.ndimage  # noqa: F401  (imported once, not by every fork)
import scipy.optimize  # noqa: F401
import scipy.spatial  # noqa: F401
import scipy.stats  # noqa: F401
import shapely  # noqa: F401

from bench.frame import TOP, Table, arguments, share

TIME_LIMIT_S = 60
# a module, and the test files of its package that are about it
MODULES = {
    "vb_core.geometry": "geometry transforms",
    "vb_core.grid_map": "grid_map",
    "vb_core.camera_model": "camera_model",
    "vb_fusion.line.closure": "extraction",
    "vb_fusion.stroke.seed": "seed",
    "vb_fusion.stroke.track": "extraction collector",
    "vb_map_integration.integration": "integration verdicts",
    "vb_map_integration.grid.raster": "integration",
    "vb_map_integration.borders.schedule": "schedule",
    "vb_robot.driving.gate": "safety arbiter escape",
    "vb_robot.driving.safety": "safety arbiter",
    "vb_robot.driving.arbiter": "arbiter",
    "vb_robot.driving.spot_follower": "arbiter drawing",
    "vb_robot.driving.escape": "escape",
    "vb_evaluation.statistics": "statistics report",
    "vb_evaluation.report.data": "report study_kit",
    "vb_evaluation.report.sensitivity": "report",
    "vb_evaluation.study_kit.measure": "study_kit",
}
SWAPS = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
SWAPS.update({ast.Is: ast.IsNot, ast.IsNot: ast.Is})
SWAPS.update(
    {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And}
)
REVERSED = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE}


def mutations(node: ast.AST) -> Iterator[Tuple[str, Callable[[Any], None]]]:
    """Yields what can be done to a node: words, and a function that does it to the node or its copy."""
    if isinstance(node, ast.Compare):
        for table in (SWAPS, REVERSED):
            if type(node.ops[0]) in table:
                new = table[type(node.ops[0])]
                yield new.__name__, lambda one, new=new: one.ops.__setitem__(0, new())
    elif isinstance(node, (ast.BinOp, ast.BoolOp)) and type(node.op) in SWAPS:
        new = SWAPS[type(node.op)]
        yield new.__name__, lambda one: setattr(one, "op", new())
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
        for value in (node.value * 2 if node.value else 1, -node.value if node.value else -1):
            yield f"{node.value} is {value}", lambda one, value=value: setattr(one, "value", value)
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        yield "not", lambda one: setattr(one, "test", ast.UnaryOp(ast.Not(), one.test))
    elif isinstance(node, ast.Return) and node.value is not None:
        yield "returns None", lambda one: setattr(one, "value", ast.Constant(None))
    if isinstance(node, (ast.Assign, ast.AugAssign)) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield "left out", lambda one: one.__dict__.update(value=ast.Constant(None)) or setattr(one, "gone", True)


def mutants(path: Path) -> List[Tuple[int, str, ast.Module]]:
    """Lists all mutants of a file: line, words, and the tree of its functions and classes with one fault in it."""
    tree, found = ast.parse(path.read_text(encoding="utf-8")), []
    for index, node in enumerate(ast.walk(tree)):
        for place, (words, _) in enumerate(mutations(node)):
            mutant = copy.deepcopy(tree)
            chosen = next(one for number, one in enumerate(ast.walk(mutant)) if number == index)
            list(mutations(chosen))[place][1](chosen)
            found.append((getattr(node, "lineno", 0), words, ast.fix_missing_locations(_Remove().visit(mutant))))
    return found


class _Remove(ast.NodeTransformer):
    """Replaces statements that are marked as gone by nothing."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        return ast.copy_location(ast.Pass(), node) if getattr(node, "gone", False) else super().generic_visit(node)


class _Finder:
    """Finds a mutant's code where its module is imported."""

    def __init__(self, name: str, path: Path, tree: ast.Module) -> None:
        self._name, self._path, self._tree = name, path, tree

    def find_spec(self, name: str, _path: Any = None, _target: Any = None) -> Any:
        if name != self._name:
            return None
        loader = importlib.machinery.SourceFileLoader(name, str(self._path))
        loader.get_code = lambda _name: compile(self._tree, str(self._path), "exec")  # type: ignore[method-assign]
        return importlib.util.spec_from_file_location(name, self._path, loader=loader)


def survives(name: str, path: Path, tree: ast.Module, tests: List[str]) -> bool:
    """Runs the tests on a mutant in a fork; returns whether none failed."""
    child = os.fork()
    if child == 0:
        signal.alarm(TIME_LIMIT_S)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1), os.dup2(null, 2)
        for loaded in [one for one in sys.modules if one.startswith("vb_")]:
            del sys.modules[loaded]
        sys.meta_path.insert(0, _Finder(name, path, tree))
        code = pytest.main(["-x", "-q", "--import-mode=importlib", "-p", "no:cacheprovider", "-n", "0", *tests])
        os._exit(0 if code == 0 else 1)
    return os.waitpid(child, 0)[1] == 0


def main() -> int:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("--modules", nargs="+", default=list(MODULES), choices=list(MODULES), metavar="MODULE")
    parser.add_argument("--each", type=int, default=8, help="mutants of each module")
    given = parser.parse_args()
    table, total = Table(given.csv), 0
    for name in given.modules:
        package = TOP / "src" / name.partition(".")[0]
        path = package / "src" / Path(*name.split(".")).with_suffix(".py")
        tests = [str(package / "test" / f"test_{word}.py") for word in MODULES[name].split()]
        random = np.random.default_rng([given.seed, *name.encode()])
        every = mutants(path)
        chosen = [every[index] for index in sorted(random.permutation(len(every))[: given.each])]
        for line, words, tree in chosen:
            if survives(name, path, tree, tests):
                source = path.read_text(encoding="utf-8").splitlines()[line - 1].strip()
                table.add(module=name, line=line, change=words, source=source)
        total += len(chosen)
        print(f"{name}: {len(chosen)} of {len(every)}", flush=True)
    print(f"survivors: {share(len(table.rows), total)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
