"""Terminals of all encodings, and what `--help` and `--version` say."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dynaforge.cli import main as entry
from dynaforge.cli.commands import COMMANDS
from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.evaluation import DgrReport, comparison_table
from dynaforge.evaluation.dgr import CountedAttempt
from dynaforge.training.sparkline import sparkline


def printed(monkeypatch: pytest.MonkeyPatch, encoding: str, show: Callable[[], object]) -> str:
    """Return what a command prints on a terminal of that encoding."""
    screen = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", screen)
        patch.setattr(entry, "import_module", lambda name: type("module", (), {"run": lambda options: show() or 0}))
        assert main(["list"]) == 0
    screen.flush()
    return screen.buffer.getvalue().decode(encoding)


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp437", "utf-8"])
def test_what_is_printed_shows_on_any_terminal(encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    report = DgrReport.from_attempts(
        [CountedAttempt(0.2, True), CountedAttempt(0.8, False, "dropped")], difficulty_range=(0, 1), n_bins=2
    )

    def show() -> None:
        print(comparison_table([report]), report.table(), sparkline((0.0, 0.5, 1.0)), sep="\n")
        print("p ≥ 0.05, 2 × 3 … Größe пробел \udcff", file=sys.stdout)

    text = printed(monkeypatch, encoding, show)
    widths = {len(line) for line in text.splitlines() if line[:1] in ("|", "+", "│", "├", "┏", "┃", "└", "┡")}
    assert len(widths) == 2, "the two tables keep their shape"
    if encoding == "ascii":
        assert text.isascii()
        assert "_=#\n" in text
        assert "p >= 0.05, 2 x 3 ... Gr\\xf6\\xdfe" in text


def test_no_terminal_at_all_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    assert main(["list"]) == 0
    assert main(["collect", "--demos", "0"]) == 2


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert "None" not in text
    assert not re.search(r"default: (False|\[)", text)
    assert COMMANDS[command].examples
    for example in COMMANDS[command].examples:
        assert f"  dynaforge {example}" in text


def test_examples_of_help_are_command_lines(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    DemonstrationDataset("data/can", task="can")
    for name, command in COMMANDS.items():
        for example in command.examples:
            for made in re.findall(r"--(?:policy|measured) (\S+)", example):  # by other commands
                Path(made).parent.mkdir(parents=True, exist_ok=True)
                Path(made).touch()
            for made in re.findall(r"--training (\S+)", example):
                Path(made).mkdir(parents=True, exist_ok=True)
            command.read(name, example.split()[1:])


def test_version_tells_that_of_the_package_and_on_request_those_of_others(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == main(["-V"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"dynaforge \d+\.\d+\.\d+", first)
    assert first == second
    assert main(["--version", "all"]) == 0
    assert {"dynaforge", "torch", "pybullet", "python"} <= {
        line.split()[0] for line in capsys.readouterr().out.splitlines()
    }
