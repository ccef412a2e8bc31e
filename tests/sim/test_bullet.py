"""Bullet prints nothing to the terminal, and never ends the process."""

from __future__ import annotations

import os
import subprocess
import sys
from threading import Thread
from typing import Any

import pytest

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.task_env import TaskEnv
from dynaforge.sim.bullet import connect


def test_connecting_prints_nothing_and_leaves_the_descriptors_alone(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Envs are made in threads too, where redirecting a descriptor would redirect the output of all of them."""

    def refuse(*args: Any, **kwargs: Any) -> None:
        raise AssertionError("a descriptor was touched")

    clients: list[Any] = []
    with monkeypatch.context() as patched:
        patched.setattr(os, "dup2", refuse)
        threads = [Thread(target=lambda: clients.append(connect())) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert len({client._id for client in clients}) == 4
    for client in clients:
        client.disconnect()
        client.disconnect()
    os.write(1, b"out")
    os.write(2, b"err")
    assert capfd.readouterr() == ("out", "err")


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_a_process_without_a_terminal_can_import_the_simulator(closed: str, tmp_path: Any) -> None:
    code = "import sys, dynaforge.sim.bullet as b; b.connect(); open(sys.argv[1], 'w').write(str(sys.stdout is None))"
    shell = f'"$0" -c "$1" "$2" {closed}'
    mark = tmp_path / "mark"
    command = ["sh", "-c", shell, sys.executable, code, str(mark)]
    assert subprocess.run(command, check=True, timeout=60, capture_output=True, text=True).stderr == ""
    assert mark.read_text() == str(">&-" in closed.split())


@pytest.mark.skipif(sys.platform != "linux", reason="X11 displays")
@pytest.mark.parametrize("make", [ResidualEnv, TaskEnv])
def test_a_window_without_a_display_is_an_error_that_names_the_remedy(make: Any, monkeypatch: Any) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(OSError, match=r"DISPLAY is not set.*render_mode='rgb_array'"):
        make("can", render_mode="human")
    monkeypatch.setenv("DISPLAY", ":4711")
    with pytest.raises(OSError, match=r"(DISPLAY=':4711'|libX11).*xvfb-run"):
        make("can", render_mode="human")
