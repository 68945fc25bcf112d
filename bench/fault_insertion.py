"""The small faults that mutation_testing.py inserts into a module.

A mutant swaps a comparison, or `and` with `or`, changes a number, negates a condition, returns None, or omits a
statement. Three kinds of changes that no test should detect are not made: changes of texts for people (a raised error, a
formatted string, a log or a warning); changes of numbers below a millionth, which guard against rounding; and swaps of
`<` and `<=` if neither side is an integer or zero, because a measured length never equals such a bound exactly.
"""

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


def possible_faults(node: ast.AST) -> Iterator[Tuple[str, Callable[[Any], None]]]:
    """Yields a node's possible faults: a description, and a function that inserts one into the node or its copy."""
    if isinstance(node, ast.Compare):
        for table in (SWAPS, REVERSED):
            new = table.get(type(node.ops[0]))
            is_exact = _is_exact(node.left) or _is_exact(node.comparators[0])
            if new and (new not in BOUNDS or table is REVERSED or is_exact):
                yield new.__name__, lambda copy, new=new: copy.ops.__setitem__(0, new())
    elif isinstance(node, (ast.BinOp, ast.BoolOp)) and type(node.op) in SWAPS:
        new = SWAPS[type(node.op)]
        yield new.__name__, lambda copy: setattr(copy, "op", new())
    elif _is_number(node) and not 0 < abs(node.value) <= ROUNDING:
        others = (node.value * 2, -node.value) if node.value else (1, -1)
        for value in others:
            yield f"{node.value} is {value}", lambda copy, value=value: setattr(copy, "value", value)
    elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
        yield "not", lambda copy: setattr(copy, "test", ast.UnaryOp(ast.Not(), copy.test))
    elif isinstance(node, ast.Return) and node.value is not None and getattr(node.value, "value", ...) is not None:
        yield "returns None", lambda copy: setattr(copy, "value", ast.Constant(None))
    is_call = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    if is_call or isinstance(node, (ast.Assign, ast.AugAssign)):
        yield "left out", lambda copy: setattr(copy, "gone", True)


def _is_exact(node: ast.AST) -> bool:
    """Returns whether a node seems to be a number that others can equal exactly: an integer, zero, or a length."""
    if getattr(getattr(node, "func", None), "id", "") == "len":
        return True
    return isinstance(node, ast.Constant) and (type(node.value) is int or node.value == 0.0)


def _is_number(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def walk(node: ast.AST) -> Iterator[ast.AST]:
    """Yields all nodes except those of texts for people."""
    called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
    if isinstance(node, (ast.Raise, ast.JoinedStr)) or called.startswith(("warnings.", "rospy.log", "CodedError")):
        return
    yield node
    for child in ast.iter_child_nodes(node):
        if not (isinstance(child, ast.Expr) and not list(walk(child.value))):
            yield from walk(child)


def parse_file(path: Path) -> ast.Module:
    """Returns the unchanged syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def list_mutants(path: Path) -> List[Tuple[int, str, Callable[[], ast.Module]]]:
    """Lists all mutants of a file: line, description, and a function that returns the file's tree with the fault."""
    result = []

    def make(index: int, number: int) -> ast.Module:
        mutant = parse_file(path)
        node = list(walk(mutant))[index]
        list(possible_faults(node))[number][1](node)
        return ast.fix_missing_locations(_Remove().visit(mutant))

    for index, node in enumerate(walk(parse_file(path))):
        for number, (change, _) in enumerate(possible_faults(node)):
            result.append((getattr(node, "lineno", 0), change, partial(make, index, number)))
    return result


class _Remove(ast.NodeTransformer):
    """Replaces statements marked as gone with `pass`."""

    def generic_visit(self, node: ast.AST) -> ast.AST:
        return ast.copy_location(ast.Pass(), node) if getattr(node, "gone", False) else super().generic_visit(node)
