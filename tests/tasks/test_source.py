"""What a task's functions do is part of its digest; how they are written is not."""

from __future__ import annotations

import ast
import hashlib
import sys
from dataclasses import replace
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from operator import itemgetter
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from dynaforge.sim import spec
from dynaforge.tasks import get_task
from dynaforge.tasks.digest import digest_of, task_digest
from dynaforge.tasks.source import tree_text, without_prose

CAN = get_task("can")
SOURCE = '''
from dataclasses import dataclass

RADIUS = 0.03
UNUSED = 1


def start(speed: float) -> float:
    """Say where it starts."""
    return speed / RADIUS


def launch(condition):
    """Roll it."""

    def turned(x):
        """Turn it."""
        return x * 2.0  # twice

    return {"can": turned(start(condition.difficulty))}


pick = lambda condition: condition.difficulty * 0.5


@dataclass(frozen=True)
class Slow:
    """Whether it is slow."""

    limit: float = 0.1

    def __call__(self, view) -> bool:
        """Compare."""
        return view.speed < self.limit


def made(scale):
    """Return a function with a closure."""
    return lambda condition: scale * condition.difficulty
'''
SAME = {
    "docstring": ('"""Roll it."""', '"""Roll it without slip."""'),
    "no docstring": ('    """Roll it."""\n', ""),
    "docstring of a nested function": ('"""Turn it."""', '"""Turn it twice."""'),
    "docstring of a function that it calls": ('"""Say where it starts."""', "'''Where?'''"),
    "docstring of a method": ('"""Compare."""', '"""Compare both."""'),
    "docstring of a class": ('"""Whether it is slow."""', '"""Slow."""'),
    "comment": ("# twice", "# two times"),
    "formatting": ("speed / RADIUS", "(speed\n            / RADIUS)"),
    "quotes": ('{"can": ', "{'can': "),
    "place": ("RADIUS = 0.03", "\n\nRADIUS = 0.03"),
    "annotation": ("speed: float) -> float", "speed)"),
    "what it does not use": ("UNUSED = 1", "UNUSED = 2"),
}
OTHER = {
    "constant": ("* 2.0", "* 2.5"),
    "name": ('{"can": ', '{"cup": '),
    "operator": ("speed / RADIUS", "speed * RADIUS"),
    "constant of its module": ("RADIUS = 0.03", "RADIUS = 0.04"),
    "lambda": ("* 0.5", "* 0.6"),
    "method": ("view.speed <", "view.speed <="),
}


def load(text: str, path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    path.write_text(text)
    found = spec_from_file_location(path.stem, path)
    assert found is not None
    assert found.loader is not None
    module = module_from_spec(found)
    monkeypatch.setitem(sys.modules, path.stem, module)
    found.loader.exec_module(module)
    return module


def digest(module: Any) -> str:
    """Return the digest of a function, of a function in a `partial`, of a lambda, and of a predicate."""
    return digest_of((module.launch, partial(module.start, 0.1), module.pick, module.Slow()), "parts")


@pytest.mark.parametrize("change", [*SAME, *OTHER])
def test_the_digest_changes_with_what_functions_do_only(
    change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, new = (SAME | OTHER)[change]
    assert SOURCE.count(old) == 1
    before = digest(load(SOURCE, tmp_path / "before.py", monkeypatch))
    after = digest(load(SOURCE.replace(old, new), tmp_path / "after.py", monkeypatch))
    assert (after == before) == (change in SAME)


def test_what_a_closure_or_a_partial_holds_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = load(SOURCE, tmp_path / "closures.py", monkeypatch).made
    assert digest_of(made(1.0), "launch") == digest_of(made(1.0), "launch") != digest_of(made(1.5), "launch")
    assert digest_of(partial(made, 1.0), "launch") != digest_of(partial(made, 1.5), "launch")


def test_what_has_no_source_has_a_digest() -> None:
    typed: dict[str, Any] = {}
    exec("def launch(condition): return {}", typed)
    assert len({digest_of(launch, "launch") for launch in (typed["launch"], dict, itemgetter("can"), print)}) == 4


def test_comments_in_a_urdf_do_not_count_and_sizes_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = spec.asset_path("can/can.urdf").read_text()

    def read(text: str) -> str:
        (tmp_path / "can.urdf").write_text(text)
        monkeypatch.setattr("dynaforge.tasks.digest.asset_path", lambda name: tmp_path / "can.urdf")
        return task_digest(replace(CAN))

    assert read(known) == read(known.replace("<link", "<!-- a can -->\n\n  <link")) == task_digest(CAN)
    assert read(known.replace('"0.033"', '"0.034"')) != task_digest(CAN)


def test_the_text_of_a_tree_is_the_same_in_every_version_of_python() -> None:
    text = tree_text(without_prose(ast.parse(SOURCE + "def empty(*, a=None, **b): pass\nx = f'{1!r:>5}', -1e3, 'é'\n")))
    assert hashlib.sha256(text.encode()).hexdigest()[:16] == "2cfda8c66539914e"
