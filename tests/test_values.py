"""Laws of the package's values, read off its source: how they are shown, how they are built, who knows the engine."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import dynaforge

ROOT = Path(dynaforge.__file__).parent
LARGE = ("Array", "Floats", "Tensor", "bytes")  # types that fill the screen
BY_POSITION = 4  # fields that may be given by position: what a value is called, and what it is of
LAUNCH = "Launch"  # written by position in the `launch` of tasks, whose source is part of a task's definition


def dataclasses() -> Iterator[tuple[Path, ast.ClassDef, ast.expr]]:
    for path in ROOT.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            for decorator in node.decorator_list if isinstance(node, ast.ClassDef) else ():
                if ast.unparse(decorator).startswith("dataclass"):
                    yield path, node, decorator


def names_of(node: ast.ClassDef) -> set[str]:
    assigned = {ast.unparse(target) for item in node.body if isinstance(item, ast.Assign) for target in item.targets}
    return assigned | {item.name for item in node.body if isinstance(item, ast.FunctionDef)}


def test_every_value_that_holds_arrays_is_shown_on_one_line() -> None:
    large = [
        (path.name, node.name, "__repr__" in names_of(node))
        for path, node, _ in dataclasses()
        if any(
            word in ast.unparse(item.annotation)
            for item in node.body
            if isinstance(item, ast.AnnAssign)
            for word in LARGE
        )
    ]
    assert len(large) > 15
    assert [found for found in large if not found[2]] == []


def test_values_of_sim_with_many_fields_are_built_by_name() -> None:
    long = []
    for path, node, decorator in dataclasses():
        types = [ast.unparse(item.annotation) for item in node.body if isinstance(item, ast.AnnAssign)]
        by_position = types.index("KW_ONLY") if "KW_ONLY" in types else len(types)
        if path.parent.name == "sim" and len(types) >= 5:
            long.append(node.name)
            by_name = "kw_only=True" in ast.unparse(decorator) or by_position <= BY_POSITION
            assert by_name or node.name == LAUNCH, node.name
    assert len(long) > 6


def test_only_sim_knows_the_physics_engine() -> None:
    """Nothing else imports it, nor what a scene is by its indices."""
    inside = ("pybullet", "dynaforge.sim.bullet_scene", "dynaforge.sim.fixture")
    for path in ROOT.rglob("*.py"):
        if path.parent.name == "sim":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in modules if name in inside], path
            assert not (isinstance(node, ast.Attribute) and node.attr == "_bullet"), path
