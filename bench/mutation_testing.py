#!/usr/bin/env python3
"""Mutation testing: inserts small faults into modules without ROS. Their unit tests must detect the faults.

    python3 bench/mutation_testing.py                                8 mutants of each module in MODULES
    python3 bench/mutation_testing.py --modules vb_robot.driving.command_gate --each 100
    python3 bench/mutation_testing.py --seed 2 --csv survivors.csv   other mutants, with which no test was developed

A mutant is a module with one of the faults of fault_insertion.py. If a mutant passes all tests, its line is printed,
and a person must judge whether it is equivalent to the original. A module's tests are all unit tests that import it,
and the tests of its package that import it through another module. Tests that import most of the module run first, and
the first failure ends the run. Tests that take five times the original's processor time count as failed. Each mutant
runs in a fork of its own, and no file is changed. Hypothesis does not try one mutant's failing examples on another.
"""

import ast
import importlib
import importlib.util
import os
import signal
import sys
from functools import lru_cache, partial
from pathlib import Path
from typing import Callable, Dict, FrozenSet, Iterable, Iterator, List, Set, Tuple

import hypothesis
import numpy as np
import pytest

from bench.harness import TOP, ResultTable, arguments, share
from bench.fault_insertion import list_mutants, parse_file

# modules that tests import; they are loaded once, before the forks
USED_BY_TESTS = "hypothesis.strategies pandas scipy.ndimage scipy.optimize scipy.spatial scipy.stats shapely"
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
    "vb_robot.driving.localization",
    "vb_robot.driving.scan_clearance",
    "vb_robot.driving.workspace",
    "vb_robot.driving.arbiter",
    "vb_robot.driving.spot_follower",
    "vb_robot.driving.escape",
    "vb_evaluation.statistics",
    "vb_evaluation.report.study_files",
    "vb_evaluation.report.cross_checks",
    "vb_evaluation.user_study.recording_measures",
)


def file_of(name: str) -> Path:
    """Returns a module's file."""
    return TOP / "src" / name.partition(".")[0] / "src" / Path(*name.split(".")).with_suffix(".py")


@lru_cache(maxsize=None)
def imports(path: Path) -> FrozenSet[str]:
    """Returns the names of the modules that a file imports, and of the objects that it imports from them."""
    names: Set[str] = set()
    for node in ast.walk(parse_file(path)):
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
    indirect = [path for path in own if users & imports(path)]
    return [str(path) for path in dict.fromkeys([*direct, *indirect])]


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


def run_forks(starts: Iterable[Callable[[], int]], processes: int) -> Iterator[Tuple[int, bool, float]]:
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
    table = ResultTable(options.csv, options.seed)
    tests = {name: tests_of(name) for name in options.modules}
    for module in USED_BY_TESTS.split():
        importlib.import_module(module)
    hypothesis.settings.register_profile("mutants", database=None, deadline=None)
    hypothesis.settings.load_profile("mutants")
    originals = [partial(run_tests, name, partial(parse_file, file_of(name)), tests[name]) for name in options.modules]
    limits = {}
    for fork, passed, used_s in run_forks(originals, options.processes):
        if not passed:
            sys.exit(f"{options.modules[fork]}: its tests fail without a fault in it")
        limits[options.modules[fork]] = PATIENCE * used_s
    selection = []
    for name in options.modules:
        pool = list_mutants(file_of(name))
        random = np.random.default_rng([options.seed, *name.encode()])
        chosen = sorted(random.permutation(len(pool))[: options.each])
        for index in chosen:
            line, change, make = pool[index]
            selection.append((name, line, change, partial(run_tests, name, make, tests[name], limits[name])))
        print(f"{name}: {len(chosen)} of {len(pool)} mutants, {len(tests[name])} files of tests", flush=True)
    for fork, passed, _ in run_forks((start for *_, start in selection), options.processes):
        if passed:
            name, line, change, _ = selection[fork]
            source = file_of(name).read_text(encoding="utf-8").splitlines()[line - 1].strip()
            table.add(module=name, line=line, change=change, source=source)
    table.add(module="all", change="survivors", source=share(len(table.rows), len(selection)))


if __name__ == "__main__":
    main()
