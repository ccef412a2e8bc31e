"""What tests all over the package share."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import gymnasium
import pytest

from dynaforge.registration import ENV_NAMES, TASK_FILES, env_ids

PAGE = Path(__file__).parents[1] / "docs" / "add_a_task.md"


@pytest.fixture
def ball(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Write the task file that docs/add_a_task.md shows; user-defined tasks are forgotten afterwards."""
    page = PAGE.read_text()
    for name, language, between in (("ball.urdf", "xml", "\n"), ("ball.py", "python", "\n\n")):
        blocks = re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)
        (tmp_path / name).write_text(between.join(blocks))
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setenv("DYNAFORGE_TASKS", "")  # so that what `get_task` adds is undone
    yield tmp_path / "ball.py"
    _forget_tasks()


@pytest.fixture
def forget_tasks() -> Callable[[], None]:
    """Return what makes this process forget user-defined tasks, as if it had just started."""
    return _forget_tasks


def _forget_tasks() -> None:
    for name in [*TASK_FILES]:
        for env in env_ids(name):
            gymnasium.registry.pop(env, None)
        sys.modules.pop(Path(TASK_FILES.pop(name)).stem, None)
        ENV_NAMES.pop(name)
