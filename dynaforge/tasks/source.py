"""What a function or class does, as its source says it: without prose, formatting, or the version of Python."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterator
from types import FunctionType
from typing import Any

_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


def source_trees(thing: FunctionType | type) -> list[ast.AST]:
    """Return the syntax trees of a function or class without prose; of lambdas that begin on the same line, all.

    Whole files are parsed, because what Python returns as the source of a lambda depends on its version.

    Raises:
        OSError, TypeError: It has no source: it was defined at a prompt, or is built in.
    """
    lines, _ = inspect.findsource(thing)
    nodes = ast.walk(without_prose(ast.parse("".join(lines))))
    if isinstance(thing, type):
        return [node for node in nodes if isinstance(node, ast.ClassDef) and node.name == thing.__name__]
    line = thing.__code__.co_firstlineno
    return [node for node in nodes if isinstance(node, _FUNCTIONS) and _first_line(node) == line]


def _first_line(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) -> int:
    decorators: list[ast.expr] = getattr(node, "decorator_list", [])
    return min(each.lineno for each in (node, *decorators))


def without_prose(tree: ast.AST) -> ast.AST:
    """Take docstrings, other constants that stand alone, and annotations out of a syntax tree, and return it."""
    for node in ast.walk(tree):
        for name, part in ast.iter_fields(node):
            if isinstance(part, list):
                part[:] = [item for item in part if not _stands_alone(item)]
            elif name in ("annotation", "returns"):
                setattr(node, name, None)
    return tree


def _stands_alone(node: Any) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def tree_text(node: Any) -> str:
    """Return a syntax tree as text, the same in every version of Python.

    `ast.dump` writes empty fields in some versions and not in others, and new versions add fields; here, what is empty
    is left out.
    """
    if isinstance(node, ast.Constant):
        return ascii(node.value)
    if isinstance(node, list):
        return f"[{','.join(map(tree_text, node))}]"
    if not isinstance(node, ast.AST):
        return ascii(node)
    fields = (f"{name}={tree_text(part)}" for name, part in ast.iter_fields(node) if part is not None and part != [])
    return f"{type(node).__name__}({','.join(fields)})"


def names_used(thing: FunctionType | type, trees: list[ast.AST]) -> Iterator[tuple[str, Any]]:
    """Yield by name what a function or class uses from around it: from its closure, and of its module's globals."""
    if isinstance(thing, type):
        around = vars(sys.modules[thing.__module__])
    else:
        cells = zip(thing.__code__.co_freevars, thing.__closure__ or (), strict=True)
        around = thing.__globals__ | {name: cell.cell_contents for name, cell in cells}
    used = {node.id for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Name)}
    yield from ((name, around[name]) for name in sorted(used & around.keys()))
