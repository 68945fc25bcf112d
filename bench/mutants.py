#!/usr/bin/env python3
"""Mutation testing: small faults are put into pure modules, and the modules' unit tests must notice them.

    python3 bench/mutants.py                                         8 mutants of each module in MODULES
    python3 bench/mutants.py --modules vb_robot.driving.gate --each 100
    python3 bench/mutants.py --seed 2 --csv survivors.csv            other mutants: another seed's were held out

A mutant swaps a comparison or `and` with `or`, changes a number, negates a condition, returns nothing, or leaves a
statement out. Changes that nobody could see are no mutants: of words for people (a raised error, a formatted string, a
log or a warning), of numbers below a millionth, which guard against rounding, and between `<` and `<=` where neither
side is a whole number or zero: a measured length never equals another bound exactly. A mutant that passes all tests is
printed with its line; whether it is equivalent to the original must be judged by eye. The tests are all unit tests that
import the module, and those of its package that import a module or helper importing it; those that import most of it
come first, and the first failure ends them. Tests that take five times the processor time of the original count as
failed. Each mutant runs in a fork that loads its source instead of the file's; the files stay unchanged, and examples
that one mutant failed on are not tried on another.
"""

import ast
import importlib
import importlib.util
import os
import signal
import sys
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Callable, Dict, FrozenSet, Iterable, Iterator, List, Set, Tuple

import hypothesis
import numpy as np
import pytest

from bench.harness import TOP, Table, arguments, share

# what tests need is imported once, not by every fork
NEEDED = "hypothesis.strategies pandas scipy.ndimage scipy.optimize scipy.spatial scipy.stats shapely"
PATIENCE = 5  # times the processor time that the tests take on the original
STUCK_S = 900  # however busy the computer is
MODULES = (
    "vb_core.geometry",
    "vb_core.grid_map",
    "vb_core.camera_model",
    "vb_fusion.polygonal_chain",
    "vb_fusion.seed_point",
    "vb_fusion.strokes",
    "vb_map_integration.integration",
    "vb_map_integration.grid.raster",
    "vb_robot.driving.gate",
    "vb_robot.driving.safety",
    "vb_robot.driving.arbiter",
    "vb_robot.driving.spot_follower",
    "vb_robot.driving.escape",
    "vb_evaluation.statistics",
    "vb_evaluation.report.study_files",
    "vb_evaluation.report.cross_checks",
    "vb_evaluation.user_study.recording_measures",
)


# ------------------------------------------------------------------ faults
ROUNDING = 1e-6
SWAPS = {ast.Lt: ast.LtE, ast.Gt: ast.GtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot}
SWAPS.update({ast.Add: ast.Sub, ast.Mult: ast.Div, ast.And: ast.Or})
SWAPS.update({new: old for old, new in SWAPS.items()})
BOUNDS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
REVERSED = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE}


def mutations(node: ast.AST) -> Iterator[Tuple[str, Callable[[Any], None]]]:
    """Yields the mutations of a node: words, and a function that applies one to the node or its copy."""
    if isinstance(node, ast.Compare):
        for table in (SWAPS, REVERSED):
            new = table.get(type(node.ops[0]))
            if new and (
                new not in BOUNDS or table is REVERSED or _is_exact(node.left) or _is_exact(node.comparators[0])
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


def _is_exact(node: ast.AST) -> bool:
    """Returns whether a node looks like a number that others can equal exactly: a whole one, zero, or a length."""
    called = getattr(getattr(node, "func", None), "id", "")
    return called == "len" or (isinstance(node, ast.Constant) and (type(node.value) is int or node.value == 0.0))


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """Walks over everything but words for people."""
    called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
    if isinstance(node, (ast.Raise, ast.JoinedStr)) or called.startswith(("warnings.", "rospy.log", "CodedError")):
        return
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.Expr) and not list(walk(child.value))):
            yield from walk(child)


def parse(path: Path) -> ast.Module:
    """Returns the syntax tree of a file, unchanged."""
    return ast.parse(path.read_text(encoding="utf-8"))


def mutants(path: Path) -> List[Tuple[int, str, Callable[[], ast.Module]]]:
    """Lists all mutants of a file: line, words, and a function that makes the file's tree with this fault."""
    found = []

    def make(index: int, place: int) -> ast.Module:
        mutant = parse(path)
        chosen = list(walk(mutant))[index]
        list(mutations(chosen))[place][1](chosen)
        return ast.fix_missing_locations(_Remove().visit(mutant))

    for index, node in enumerate(walk(parse(path))):
        for place, (words, _) in enumerate(mutations(node)):
            found.append((getattr(node, "lineno", 0), words, partial(make, index, place)))
    return found


class _Remove(ast.NodeTransformer):
    """Replaces statements marked as gone with `pass`."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        return ast.copy_location(ast.Pass(), node) if getattr(node, "gone", False) else super().generic_visit(node)


# ------------------------------------------------------------------ tests
def file_of(name: str) -> Path:
    """Returns a module's file."""
    return TOP / "src" / name.partition(".")[0] / "src" / Path(*name.split(".")).with_suffix(".py")


@lru_cache(maxsize=None)
def imports(path: Path) -> FrozenSet[str]:
    """Returns the names of the modules that a file imports, and of what it imports from them."""
    found: Set[str] = set()
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.ImportFrom):
            found |= {str(node.module), *(f"{node.module}.{what.name}" for what in node.names)}
        elif isinstance(node, ast.Import):
            found |= {what.name for what in node.names}
    return frozenset(found)


def tests_of(name: str) -> List[str]:
    """Lists the unit tests that import a module, then those of its package that import a helper or a module that does.

    Tests that import most of it come first, and of these the shortest.
    """
    package = TOP / "src" / name.partition(".")[0]
    users = {path.stem for path in package.glob("test/*.py") if name in imports(path)}
    for path in package.glob("src/**/*.py"):
        if name in imports(path):
            users.add(".".join(path.relative_to(package / "src").with_suffix("").parts))

    def order(path: Path) -> Tuple[int, int]:
        return -sum(used.startswith(f"{name}.") for used in imports(path)), path.stat().st_size

    tests = sorted(TOP.glob("src/*/test/test_*.py"), key=order)
    own = [path for path in tests if path.parent.parent == package]
    chosen = [path for part in (own, tests) for path in part if name in imports(path)]
    return [str(path) for path in dict.fromkeys([*chosen, *(path for path in own if users & imports(path))])]


def import_mutant(name: str, tree: ast.Module) -> None:
    """Loads a mutant in place of its module, for everything that imports that."""
    for loaded in [one for one in sys.modules if one.startswith("vb_")]:
        del sys.modules[loaded]
    spec = importlib.util.find_spec(name)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    setattr(sys.modules[spec.parent], name.rpartition(".")[2], module)
    exec(compile(tree, spec.origin, "exec"), vars(module))


def run_tests(name: str, make: Callable[[], ast.Module], tests: List[str], limit_s: float = 0.0) -> int:
    """Starts a fork that runs the tests on a mutant, with a limit of processor time [s] (0: none); returns its id."""
    child = os.fork()
    if child == 0:
        signal.setitimer(signal.ITIMER_PROF, limit_s)
        signal.alarm(STUCK_S)
        null = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(null, stream)
        options = ["-x", "-q", "--import-mode=importlib", "-p", "no:cacheprovider", "-n", "0", "--hypothesis-seed=0"]
        status = 1  # also of a mutant that cannot be imported
        try:
            import_mutant(name, make())
            status = int(pytest.main([*options, *tests]) != 0)
        finally:
            os._exit(status)
    return child


def in_forks(starts: Iterable[Callable[[], int]], processes: int) -> Iterator[Tuple[int, bool, float]]:
    """Runs forks in parallel, and yields each one's number, whether its tests passed, and its processor time [s]."""
    running: Dict[int, int] = {}
    waiting = list(enumerate(starts))[::-1]
    while waiting or running:
        while waiting and len(running) < processes:
            number, start = waiting.pop()
            running[start()] = number
        child, status, used = os.wait3(0)
        if child in running:
            yield running.pop(child), status == 0, used.ru_utime + used.ru_stime


def main() -> None:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("--modules", nargs="+", default=MODULES, choices=MODULES, metavar="MODULE")
    parser.add_argument("--each", type=int, default=8, help="mutants of each module")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args()
    table, tests = Table(given.csv, given.seed), {name: tests_of(name) for name in given.modules}
    for needed in NEEDED.split():
        importlib.import_module(needed)
    hypothesis.settings.register_profile("mutants", database=None, deadline=None)
    hypothesis.settings.load_profile("mutants")
    originals = [partial(run_tests, name, partial(parse, file_of(name)), tests[name]) for name in given.modules]
    limits = {}
    for number, passed, used_s in in_forks(originals, given.processes):
        if not passed:
            sys.exit(f"{given.modules[number]}: its tests fail without a fault in it")
        limits[given.modules[number]] = PATIENCE * used_s
    chosen = []
    for name in given.modules:
        every = mutants(file_of(name))
        random = np.random.default_rng([given.seed, *name.encode()])
        for index in sorted(random.permutation(len(every))[: given.each]):
            line, words, make = every[index]
            chosen.append((name, line, words, partial(run_tests, name, make, tests[name], limits[name])))
        print(f"{name}: {min(given.each, len(every))} of {len(every)}, {len(tests[name])} files of tests", flush=True)
    for number, passed, _ in in_forks((start for *_, start in chosen), given.processes):
        if passed:
            name, line, words, _ = chosen[number]
            source = file_of(name).read_text(encoding="utf-8").splitlines()[line - 1].strip()
            table.add(module=name, line=line, change=words, source=source)
    table.add(module="all", change="survivors", source=share(len(table.rows), len(chosen)))


if __name__ == "__main__":
    main()
