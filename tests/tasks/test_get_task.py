from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

from dynaforge.tasks import get_task, task_source


@pytest.mark.parametrize(
    "given",
    [
        "toycar",
        "ToyCar",
        "TOYCAR",
        "DynaForge/ToyCar-v0",
        "DynaForge/ToyCarTask-v0",
        "dynaforge/toycar-v0",
        "dynaforge:DynaForge/ToyCar-v0",
        "dynaforge:DynaForge/ToyCarTask-v0",
    ],
)
def test_a_name_and_the_ids_of_its_envs_are_one_task(given: str) -> None:
    assert get_task(given) is get_task("toycar")


def test_a_file_its_name_and_its_ids_are_one_task(ball: Path) -> None:
    task = get_task(str(ball))
    for given in ("ball", "Ball", "DynaForge/Ball-v0", "DynaForge/BallTask-v0", "dynaforge:DynaForge/Ball-v0"):
        assert get_task(given) is task
    assert task_source(task) == str(ball)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("cann", "No task 'cann'. Did you mean 'can'?"),
        ("DynaForge/Cann-v0", "Did you mean 'DynaForge/Can-v0'?"),
        ("dynaforge:DynaForge/PaechTask-v0", "Did you mean 'DynaForge/PeachTask-v0'?"),
        ("zebra", "Known tasks are can, bottle"),
        ("bal.py", "Did you mean 'ball.py'?"),
        ("peach.py", "Did you mean 'peach'?"),
        ("ball", "If you mean the task in ball.py, give that file instead."),
        ("DynaForge/BallTask-v0", "If you mean the task in ball.py, give that file instead."),
    ],
)
def test_what_is_no_task_is_answered_with_what_may_have_been_meant(
    ball: Path, given: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ball.parent)
    with pytest.raises(ValueError) as caught:
        get_task(given)
    assert message in str(caught.value)
    assert "ball" not in sys.modules, "a file is not run until it is named"


def test_a_file_takes_no_name_or_id_of_another_task(ball: Path) -> None:
    get_task(str(ball))
    text = ball.read_text()
    renamed = text.replace('"ball"', '"other"')
    for name, changed, message in (
        ("twin.py", text, "the name 'ball' is that of the task in"),
        ("other.py", renamed, "env_name 'Ball' makes an env id of another"),
        ("trick.py", renamed.replace('"Ball"', '"CanTask"'), "env_name 'CanTask' makes an env id of another"),
    ):
        ball.with_name(name).write_text(changed)
        with pytest.raises(ValueError, match=message):
            get_task(str(ball.with_name(name)))
        assert name.removesuffix(".py") not in sys.modules, "once mended, it is read again"
    assert gymnasium.spec("DynaForge/CanTask-v0").kwargs == {"task": "can"}


def test_processes_started_later_know_the_ids_of_a_file(ball: Path) -> None:
    """As the workers of any vectorised env, which are given the id alone."""
    get_task(str(ball))
    code = "import dynaforge, gymnasium; print(gymnasium.spec('DynaForge/Ball-v0').kwargs['task'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, cwd=os.sep)
    assert done.stdout.strip() == str(ball), done.stderr


def test_a_listed_file_that_is_no_task_breaks_no_import(ball: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DYNAFORGE_TASKS", "gone.py")
    done = subprocess.run([sys.executable, "-c", "import dynaforge"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0
    assert "DYNAFORGE_TASKS lists a file that is not a task file" in done.stderr
