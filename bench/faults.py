"""Small faults that can be put into a file: what bench/mutants.py runs tests on."""

from __future__ import annotations

import ast
from functools import partial
from pathlib import Path
from typing import Any, Callable, Iterator, List, Tuple

ROUNDING = 1e-6
SWAPS = {ast.Lt: ast.LtE, ast.Gt: ast.GtE, ast.Eq: ast.NotEq, ast.Is: ast.IsNot}
SWAPS.update({ast.Add: ast.Sub, ast.Mult: ast.Div, ast.And: ast.Or})
SWAPS.update({new: old for old, new in SWAPS.items()})
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
    """Returns whether this is a number that others meet exactly, by its looks: a whole one, zero, or a length."""
    called = getattr(getattr(node, "func", None), "id", "")
    return called == "len" or (isinstance(node, ast.Constant) and (type(node.value) is int or node.value == 0.0))


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """Walks over what is no word for people."""
    called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
    if isinstance(node, (ast.Raise, ast.JoinedStr)) or called.startswith(("warnings.", "rospy.log", "CodedError")):
        return
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.Expr) and not list(walk(child.value))):
            yield from walk(child)


def parse(path: Path) -> ast.Module:
    """Returns the tree of a file as it is."""
    return ast.parse(path.read_text(encoding="utf-8"))


def mutants(path: Path) -> List[Tuple[int, str, Callable[[], ast.Module]]]:
    """Lists all mutants of a file: line, words, and what makes the tree of the file with one fault in it."""
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
    """Replaces statements that are marked as gone by nothing."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        return ast.copy_location(ast.Pass(), node) if getattr(node, "gone", False) else super().generic_visit(node)
