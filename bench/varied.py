"""What a package's constants do: versions of it in which one is halved or doubled, for the benches that judge them.

Constants are all numbers that modules name, and all decimal numbers within their expressions, but those that only keep a
division from failing.
"""

from __future__ import annotations

import ast
import copy
import multiprocessing
import shutil
import tempfile
from functools import partial
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, Sequence, Tuple

from bench.frame import TOP, import_from

FACTORS = (0.5, 2.0)
NO_DIVISOR = 1e-4  # and below it: keeps a division from failing


def rows(
    package: str, files: Sequence[str], only: Sequence[str], judge: Callable[[Path], str]
) -> Iterator[Dict[str, Any]]:
    """Yields a row for each constant of some modules: what is judged of the versions in which it is another one.

    Args:
        files: patterns of names within the package.
        only: constants with one of these in the name of their module, or in their lines.
        judge: says what a version's folder `src` does; in a process of its own.
    """
    folder = TOP / "src" / package / "src"
    for path in sorted(path for pattern in files for path in (folder / package).glob(pattern)):
        lines = path.read_text(encoding="utf-8").splitlines()
        for name, line, value, make in constants(path, ".".join(path.relative_to(folder).with_suffix("").parts)):
            text = f"{path.stem}: " + lines[line - 1].split("  #")[0].strip()
            if not any(part in text for part in only):
                continue
            row = {"constant": name or "within", "value": value, "line": text}
            for factor in FACTORS:
                with tempfile.TemporaryDirectory() as other:
                    copied = Path(other) / package
                    shutil.copytree(folder, copied / "src", ignore=shutil.ignore_patterns("__pycache__"))
                    shutil.copy(folder.parent / "package.xml", copied)
                    (copied / "src" / path.relative_to(folder)).write_text(ast.unparse(make(factor)))
                    row[f"times {factor:g}"] = _in_process(judge, Path(other))
            yield row


def constants(path: Path, module: str) -> Iterator[Tuple[str, int, float, Callable[[float], ast.Module]]]:
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

    outside = [statement for statement in tree.body if isinstance(statement, (ast.Assign, ast.ClassDef))]
    inside = {one for statement in outside for one in ast.walk(statement)}
    values = vars(import_from(None, module)[0])
    for index, node in enumerate(ast.walk(tree)):
        name, value = "", getattr(node, "value", None)
        if node in outside and isinstance(node, ast.Assign):
            name = getattr(node.targets[0], "id", "")
            value = values[name] if name.isupper() else None
        elif node in inside or type(value) is not float or abs(value) <= NO_DIVISOR or value == 1.0:
            value = None
        if isinstance(value, (int, float)):
            yield name, node.lineno, float(value), partial(changed, index)


def _in_process(judge: Callable[[Path], str], source: Path) -> str:
    """Judges a version in a child; what a senseless number leads to is told too."""
    receive, send = multiprocessing.Pipe(duplex=False)

    def work() -> None:
        try:
            send.send(judge(source))
        except Exception as error:
            send.send(f"fails: {type(error).__name__}")

    child = multiprocessing.get_context("fork").Process(target=work)
    child.start()
    found = receive.recv()
    child.join()
    return found
