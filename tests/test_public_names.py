"""The public names: there, light to import, and described in the API reference."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

import dynaforge

BUILD = Path(__file__).parents[1] / "docs" / "build_api.py"


def test_every_public_name_is_there_for_python_and_for_type_checkers() -> None:
    module = ast.parse(Path(dynaforge.__file__).read_text()).body
    (guarded,) = (node for node in module if _checks_types(node))
    assert "__getattr__" not in {getattr(node, "name", "") for node in module}, "type checkers believe in any name"
    seen = {name.name: f"{node.module}" for node in guarded.body for name in node.names}
    assert seen == {name: module for module, names in dynaforge._HOMES.items() for name in names}
    assert sorted(seen) == sorted(dynaforge.__all__)
    assert all(getattr(dynaforge, name) is not None for name in dynaforge.__all__)
    assert set(dynaforge.__all__) <= set(dir(dynaforge))
    with pytest.raises(AttributeError, match="no attribute 'Tusk'"):
        _ = dynaforge.Tusk


def _checks_types(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def test_a_task_file_loads_no_physics_and_no_network_by_its_imports() -> None:
    names = "BodySpec, Condition, ConditionSpace, Launch, Mode, Phase, Pose, ResidualSpec, SceneSpec, Task"
    code = f"from dynaforge import {names}; import sys; print(any(m in sys.modules for m in ('pybullet', 'torch')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "False"


def test_a_task_file_in_the_environment_variable_may_import_public_names(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("from dynaforge import Task, Phase\nraise ValueError(Task.__name__)\n")
    code = "import dynaforge"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={"DYNAFORGE_TASKS": str(tmp_path / "mine.py"), "PATH": ""},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert "line 2: Task" in done.stderr


@pytest.fixture
def build(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    pytest.importorskip("pdoc")
    monkeypatch.syspath_prepend(str(BUILD.parent))
    import build_api

    return build_api.build


@pytest.mark.slow
def test_the_api_reference_describes_every_public_name(build: Callable[[Path], None], tmp_path: Path) -> None:
    build(tmp_path)
    page = (tmp_path / "dynaforge.html").read_text()
    assert [name for name in dynaforge.__all__ if f'id="{name}"' not in page] == []
    assert 'id="Grasped"' in (tmp_path / "dynaforge" / "tasks" / "predicates.html").read_text()


@pytest.mark.slow
def test_the_api_reference_is_not_built_with_a_name_left_undescribed(
    build: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dynaforge, "Goal", SimpleNamespace(__doc__=""))
    with pytest.raises(ValueError, match=r"dynaforge\.Goal has no docstring"):
        build(tmp_path)
