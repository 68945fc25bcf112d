#!/usr/bin/env python3
"""Mutation testing: inserts small faults into pure modules, which the modules' unit tests must detect.

    python3 bench/mutants.py                                         8 mutants of each module in MODULES
    python3 bench/mutants.py --modules vb_robot.driving.command_gate --each 100
    python3 bench/mutants.py --seed 2 --csv survivors.csv            other mutants, with which no test was developed

A mutant swaps a comparison, or `and` with `or`, changes a number, negates a condition, returns None, or omits a
statement. Changes that no test should detect are not made: of texts for people (a raised error, a formatted string, a
log or a warning), of numbers below a millionth, which guard against rounding, and between `<` and `<=` if neither side
is an integer or zero, because a measured length never equals another bound exactly. A mutant that passes all tests is
printed with its line; a person must judge whether it is equivalent to the original. The tests are all unit tests that
import the module, and those of its package that import a module or helper that imports it. Tests that import most of
the module run first, and the first failure ends the run. Tests that take five times the original's processor time count
as failed. Each mutant runs in a fork that loads its source instead of the file, which stays unchanged. Hypothesis does
not try one mutant's failing examples on another.
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

# modules that tests need; they are imported once, not by every fork
NEEDED = "hypothesis.strategies pandas scipy.ndimage scipy.optimize scipy.spatial scipy.stats shapely"
PATIENCE = 5  # times the processor time that the tests take on the original
STUCK_S = 900  # [s] of wall time after which a fork is ended, even on a busy computer
MODULES = (
    "vb_core.geometry",
    "vb_core.grid_map",
    "vb_core.camera_model",
    "vb_fusion.polygonal_chain",
    "vb_fusion.seed_point",
    "vb_fusion.strokes",
    "vb_map_integration.border_region",
    "vb_map_integration.open_chains",
    "vb_robot.driving.command_gate",
    "vb_robot.driving.scan_clearance",
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
    """Yields the mutations of a node: a description, and a function that applies one to the node or its copy."""
    if isinstance(node, ast.Compare):
        for table in (SWAPS, REVERSED):
            new = table.get(type(node.ops[0]))
            is_exact = _is_exact(node.left) or _is_exact(node.comparators[0])
            if new and (new not in BOUNDS or table is REVERSED or is_exact):
                yield new.__name__, lambda copy, new=new: copy.ops.__setitem__(0, new())
    elif isinstance(node, (ast.BinOp, ast.BoolOp)) and type(node.op) in SWAPS:
        new = SWAPS[type(node.op)]
        yield new.__name__, lambda copy: setattr(copy, "op", new())
    elif isinstance(node, ast.Constant) and type(node.value) in (int, float) and not 0 < abs(node.value) <= ROUNDING:
        others = (node.value * 2, -node.value) if node.value else (1, -1)
        for value in others:
            yield f"{node.value} is {value}", lambda copy, value=value: setattr(copy, "value", value)
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        yield "not", lambda copy: setattr(copy, "test", ast.UnaryOp(ast.Not(), copy.test))
    elif isinstance(node, ast.Return) and node.value is not None and getattr(node.value, "value", ...) is not None:
        yield "returns None", lambda copy: setattr(copy, "value", ast.Constant(None))
    is_call = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    if is_call or isinstance(node, (ast.Assign, ast.AugAssign)):
        yield "left out", lambda copy: copy.__dict__.update(value=ast.Constant(None)) or setattr(copy, "gone", True)


def _is_exact(node: ast.AST) -> bool:
    """Returns whether a node seems to be a number that others can equal exactly: an integer, zero, or a length."""
    called = getattr(getattr(node, "func", None), "id", "")
    return called == "len" or (isinstance(node, ast.Constant) and (type(node.value) is int or node.value == 0.0))


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """Yields all nodes except those of texts for people."""
    called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
    if isinstance(node, (ast.Raise, ast.JoinedStr)) or called.startswith(("warnings.", "rospy.log", "CodedError")):
        return
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.Expr) and not list(walk(child.value))):
            yield from walk(child)


def parse(path: Path) -> ast.Module:
    """Returns the unchanged syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def mutants(path: Path) -> List[Tuple[int, str, Callable[[], ast.Module]]]:
    """Lists all mutants of a file: line, description, and a function that returns the file's tree with the fault."""
    result = []

    def make(index: int, mutation: int) -> ast.Module:
        mutant = parse(path)
        node = list(walk(mutant))[index]
        list(mutations(node))[mutation][1](node)
        return ast.fix_missing_locations(_Remove().visit(mutant))

    for index, node in enumerate(walk(parse(path))):
        for mutation, (change, _) in enumerate(mutations(node)):
            result.append((getattr(node, "lineno", 0), change, partial(make, index, mutation)))
    return result


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
    """Returns the names of the modules that a file imports, and of the objects that it imports from them."""
    names: Set[str] = set()
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.ImportFrom):
            names |= {str(node.module), *(f"{node.module}.{imported.name}" for imported in node.names)}
        elif isinstance(node, ast.Import):
            names |= {imported.name for imported in node.names}
    return frozenset(names)


def tests_of(name: str) -> List[str]:
    """Lists the unit tests that import a module, then those of its package that import it through another module.

    Tests that import most of the module come first, and of these the shortest.
    """
    package = TOP / "src" / name.partition(".")[0]
    users = {path.stem for path in package.glob("test/*.py") if name in imports(path)}
    for path in package.glob("src/**/*.py"):
        if name in imports(path):
            users.add(".".join(path.relative_to(package / "src").with_suffix("").parts))

    def order(path: Path) -> Tuple[int, int]:
        return -sum(imported.startswith(f"{name}.") for imported in imports(path)), path.stat().st_size

    tests = sorted(TOP.glob("src/*/test/test_*.py"), key=order)
    own = [path for path in tests if path.parent.parent == package]
    direct = [path for paths in (own, tests) for path in paths if name in imports(path)]
    return [str(path) for path in dict.fromkeys([*direct, *(path for path in own if users & imports(path))])]


def import_mutant(name: str, tree: ast.Module) -> None:
    """Loads a mutant instead of its module, for all that import the module."""
    for loaded in [module_name for module_name in sys.modules if module_name.startswith("vb_")]:
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
        status = 1  # also if the mutant cannot be imported
        try:
            import_mutant(name, make())
            status = int(pytest.main([*options, *tests]) != 0)
        finally:
            os._exit(status)
    return child


def in_forks(starts: Iterable[Callable[[], int]], processes: int) -> Iterator[Tuple[int, bool, float]]:
    """Runs forks in parallel, and yields each fork's number, whether its tests passed, and its processor time [s]."""
    running: Dict[int, int] = {}
    waiting = list(enumerate(starts))[::-1]
    while waiting or running:
        while waiting and len(running) < processes:
            index, start = waiting.pop()
            running[start()] = index
        child, status, used = os.wait3(0)
        if child in running:
            yield running.pop(child), status == 0, used.ru_utime + used.ru_stime


def main() -> None:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("--modules", nargs="+", default=MODULES, choices=MODULES, metavar="MODULE")
    parser.add_argument("--each", type=int, default=8, help="mutants of each module")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    table, tests = Table(options.csv, options.seed), {name: tests_of(name) for name in options.modules}
    for module in NEEDED.split():
        importlib.import_module(module)
    hypothesis.settings.register_profile("mutants", database=None, deadline=None)
    hypothesis.settings.load_profile("mutants")
    originals = [partial(run_tests, name, partial(parse, file_of(name)), tests[name]) for name in options.modules]
    limits = {}
    for fork, passed, used_s in in_forks(originals, options.processes):
        if not passed:
            sys.exit(f"{options.modules[fork]}: its tests fail without a fault in it")
        limits[options.modules[fork]] = PATIENCE * used_s
    selection = []
    for name in options.modules:
        pool = mutants(file_of(name))
        random = np.random.default_rng([options.seed, *name.encode()])
        for index in sorted(random.permutation(len(pool))[: options.each]):
            line, change, make = pool[index]
            selection.append((name, line, change, partial(run_tests, name, make, tests[name], limits[name])))
        print(f"{name}: {min(options.each, len(pool))} of {len(pool)}, {len(tests[name])} files of tests", flush=True)
    for fork, passed, _ in in_forks((start for *_, start in selection), options.processes):
        if passed:
            name, line, change, _ = selection[fork]
            source = file_of(name).read_text(encoding="utf-8").splitlines()[line - 1].strip()
            table.add(module=name, line=line, change=change, source=source)
    table.add(module="all", change="survivors", source=share(len(table.rows), len(selection)))


if __name__ == "__main__":
    main()
