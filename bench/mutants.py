#!/usr/bin/env python3
"""Mutation testing: small faults are put into pure modules, and the modules' unit tests must notice them.

    python3 bench/mutants.py                                         8 mutants of each module in MODULES
    python3 bench/mutants.py --modules vb_robot.driving.gate --each 100
    python3 bench/mutants.py --seed 2 --csv survivors.csv            other mutants: those of another seed were kept back

A mutant swaps a comparison or `and` with `or`, changes a number, negates a condition, returns nothing, or leaves a
statement out. What nobody can see is no mutant: words for people (a raised error, a formatted string, a log or a warning),
numbers below a millionth, which guard against rounding, and `<` for `<=` where neither side is a whole number: a
measured length never meets a bound exactly. A mutant that no test fails on is printed with its line; whether it means the
same as the original must be looked at. The tests are the unit tests of its package that import the module or another test
that does; ones that take five times as long as on the original have noticed. Each mutant runs in a fork that finds its
source instead of the file's; the files stay as they are.
"""

import ast
import copy
import importlib
import importlib.machinery
import importlib.util
import os
import signal
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any, Callable, Iterator, List, Tuple

import numpy as np
import pytest

from bench.frame import TOP, Table, arguments, share

# what tests need is imported once, not by every fork
NEEDED = "hypothesis.strategies matplotlib.pyplot pandas scipy.ndimage scipy.optimize scipy.spatial scipy.stats shapely"
ROUNDING = 1e-6
PATIENCE = 5  # times as long as the tests of the original
MODULES = (
    "vb_core.geometry",
    "vb_core.grid_map",
    "vb_core.camera_model",
    "vb_fusion.line.closure",
    "vb_fusion.stroke.seed",
    "vb_fusion.stroke.track",
    "vb_map_integration.integration",
    "vb_map_integration.grid.raster",
    "vb_robot.driving.gate",
    "vb_robot.driving.safety",
    "vb_robot.driving.arbiter",
    "vb_robot.driving.spot_follower",
    "vb_robot.driving.escape",
    "vb_evaluation.statistics",
    "vb_evaluation.report.data",
    "vb_evaluation.report.sensitivity",
    "vb_evaluation.study_kit.measure",
)
SWAPS = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
SWAPS.update({ast.Is: ast.IsNot, ast.IsNot: ast.Is})
SWAPS.update(
    {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And}
)
BOUNDS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
REVERSED = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE}


def mutations(node: ast.AST) -> Iterator[Tuple[str, Callable[[Any], None]]]:
    """Yields what can be done to a node: words, and a function that does it to the node or its copy."""
    if isinstance(node, ast.Compare):
        for table in (SWAPS, REVERSED):
            new = table.get(type(node.ops[0]))
            if new and (
                new not in BOUNDS or table is REVERSED or _is_whole(node.left) or _is_whole(node.comparators[0])
            ):
                yield new.__name__, lambda one, new=new: one.ops.__setitem__(0, new())
    elif isinstance(node, (ast.BinOp, ast.BoolOp)) and type(node.op) in SWAPS:
        new = SWAPS[type(node.op)]
        yield new.__name__, lambda one: setattr(one, "op", new())
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float) and not 0 < abs(node.value) <= ROUNDING:
        for value in (node.value * 2 if node.value else 1, -node.value if node.value else -1):
            yield f"{node.value} is {value}", lambda one, value=value: setattr(one, "value", value)
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        yield "not", lambda one: setattr(one, "test", ast.UnaryOp(ast.Not(), one.test))
    elif isinstance(node, ast.Return) and node.value is not None and getattr(node.value, "value", ...) is not None:
        yield "returns None", lambda one: setattr(one, "value", ast.Constant(None))
    if isinstance(node, (ast.Assign, ast.AugAssign)) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    ):
        yield "left out", lambda one: one.__dict__.update(value=ast.Constant(None)) or setattr(one, "gone", True)


def _is_whole(node: ast.AST) -> bool:
    """Returns whether this is a whole number by its looks: a literal or a length."""
    called = getattr(getattr(node, "func", None), "id", "")
    return called == "len" or (isinstance(node, ast.Constant) and type(node.value) is int)


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """Walks over what is no word for people."""
    called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
    if isinstance(node, (ast.Raise, ast.JoinedStr)) or called.startswith(("warnings.", "rospy.log", "CodedError")):
        return
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.Expr) and not list(walk(child.value))):
            yield from walk(child)


def mutants(path: Path) -> List[Tuple[int, str, Callable[[], ast.Module]]]:
    """Lists all mutants of a file: line, words, and what makes the tree of its functions and classes with one fault in it."""
    tree, found = ast.parse(path.read_text(encoding="utf-8")), []

    def make(index: int, place: int) -> ast.Module:
        mutant = copy.deepcopy(tree)
        chosen = next(node for number, node in enumerate(walk(mutant)) if number == index)
        list(mutations(chosen))[place][1](chosen)
        return ast.fix_missing_locations(_Remove().visit(mutant))

    for index, node in enumerate(walk(tree)):
        for place, (words, _) in enumerate(mutations(node)):
            found.append((getattr(node, "lineno", 0), words, partial(make, index, place)))
    return found


def tests_of(name: str) -> List[str]:
    """Lists the unit tests of a module's package that import the module or a test that does, the shortest file first."""
    folder, imported = TOP / "src" / name.partition(".")[0] / "test", {}
    for path in sorted(folder.glob("*.py"), key=lambda path: path.stat().st_size):
        nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
        imported[path] = {
            each for one in nodes for each in (one.module, *(f"{one.module}.{it.name}" for it in one.names))
        }
    wanted = {name, *(path.stem for path, names in imported.items() if name in names)}
    return [str(path) for path, names in imported.items() if path.stem[:5] == "test_" and names & wanted]


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


def survives(name: str, path: Path, tree: ast.Module, tests: List[str], limit_s: float = 0.0) -> bool:
    """Runs the tests on a mutant in a fork; returns whether none failed within the limit, 0 for none."""
    child = os.fork()
    if child == 0:
        signal.setitimer(signal.ITIMER_REAL, limit_s)
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
    parser.add_argument("--modules", nargs="+", default=MODULES, choices=MODULES, metavar="MODULE")
    parser.add_argument("--each", type=int, default=8, help="mutants of each module")
    given = parser.parse_args()
    table, total = Table(given.csv), 0
    for needed in NEEDED.split():
        importlib.import_module(needed)
    for name in given.modules:
        path = TOP / "src" / name.partition(".")[0] / "src" / Path(*name.split(".")).with_suffix(".py")
        source, tests, began = path.read_text(encoding="utf-8"), tests_of(name), time.monotonic()
        if not survives(name, path, ast.parse(source), tests):
            sys.exit(f"{name}: its tests fail without a fault in it")
        limit_s = PATIENCE * (time.monotonic() - began)
        random = np.random.default_rng([given.seed, *name.encode()])
        every = mutants(path)
        chosen = [every[index] for index in sorted(random.permutation(len(every))[: given.each])]
        for line, words, make in chosen:
            if survives(name, path, make(), tests, limit_s):
                table.add(module=name, line=line, change=words, source=source.splitlines()[line - 1].strip())
        total += len(chosen)
        print(f"{name}: {len(chosen)} of {len(every)}", flush=True)
    print(f"survivors: {share(len(table.rows), total)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
