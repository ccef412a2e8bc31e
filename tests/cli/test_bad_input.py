"""Nonsense at every option of every command, found from the parsers themselves: a new option is covered by itself."""

from __future__ import annotations

import argparse
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from dynaforge.cli import main as entry
from dynaforge.cli.arguments import generators, setting, tasks
from dynaforge.cli.commands import COMMANDS
from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.options import numbers
from dynaforge.options.numbers import Number, WholeNumber
from dynaforge.options.paths import ExistingPath, OutputPath
from dynaforge.options.words import Choice, Text

HUGE = ("9" * 30, "9" * 5000, "-" + "9" * 5000)
NOT_A_NUMBER = ("", " ", "x", "nan", "-nan", "inf", "-inf", "1e400", "٣", "1_0", "1,5", "0x10", "1\n2", "1\0", "½")
NO_PATH = ("", "a\0b", "x" * 300, "x/" * 3000)
BY_FUNCTION = {
    numbers.shard: ("", "0", "1/1", "2/1", "-1/4", "0/0", "٠/٤", "0/1000000000000", "0/4/5", "a/b", "0/4\n"),
    numbers.minutes: ("", "soon", "0", "0s", "-1m", "nan", "inf", "1e400h", "٣m", "1_0m", "5d", "m"),
    tasks.task: ("", "cann", "gone.py", "broken.py", "a folder", "DynaForge/X-v0", "a\nb", "a\0b", "x" * 5000),
    setting.reflex: ("", "soft", "0", "-5", "nan", "inf", "1e400", "40 N", "a\nb", "a\0b", "x" * 5000),
    generators.object_speed: (
        "",
        "fast",
        "0",
        "0.009",
        "2.1",
        "-1",
        "nan",
        "inf",
        "0.1 m/s",
        "a\nb",
        "a\0b",
        "x" * 5000,
    ),
    tasks.task_or_all: ("", "cann", "gone.py", "broken.py", "alle", "a\nb"),
}


def nonsense(kind: object) -> tuple[str, ...]:
    """Return what an option of some type must refuse."""
    match kind:
        case WholeNumber():
            return (*NOT_A_NUMBER, *HUGE, "1.5", "1e3", str(kind.minimum - 1), str(kind.maximum + 1))
        case Number():
            return (*NOT_A_NUMBER, *(str(end) for end in (kind.minimum - 1, kind.maximum + 1) if abs(end) < 1e300))
        case Choice():
            first = kind.names[0]
            return ("", "nonsense", f"{first}x", first.upper() + " ", f"{first}\n", "a\0b", "x" * 5000)
        case Text():
            return ("", "a\nb", "a\0b", "a\rb", "a/b", "../x", "x" * 5000)
        case ExistingPath():
            wrong = "a folder" if kind.kind.endswith("file") else "a file"
            return (*NO_PATH, "gone", "a file/below", wrong, *(["a folder"] if kind.containing else []))
        case OutputPath():
            wrong = "a folder" if kind.kind == "file" else "a file"
            taken = ["data"] if kind.containing or kind.new else []
            return (*NO_PATH, "a\nb", "\udce4", "a file/below", "a link/below", "a link", wrong, *taken)
    return BY_FUNCTION[kind]  # type: ignore[index]  # KeyError: give the option one of the types of dynaforge/options


@cache
def arguments_of(command: str) -> list[argparse.Action]:
    return [action for action in COMMANDS[command].parser(command)._actions if action.nargs != 0]


def line_with(command: str, action: argparse.Action, value: str) -> list[str]:
    """Return a command line that is good but for one value."""
    good = {"folder": ["demonstrations"], "format": ["--format", "lerobot"], "task": ["can"], "report": ["motivation"]}
    line = [command]
    for other in arguments_of(command):
        if other.required and other.dest != action.dest:
            line += good[other.dest]
    n = action.nargs if isinstance(action.nargs, int) else 1
    return [*line, *action.option_strings[-1:], *[value] * n]


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with one of each; a command that is not refused fails there, since its module is not found."""

    def begin(module: str) -> object:
        raise AssertionError(f"{module} is imported though the arguments are none")

    monkeypatch.setattr(entry, "import_module", begin)
    DemonstrationDataset(tmp_path / "demonstrations", task="can")
    (tmp_path / "a file").write_text("text")
    (tmp_path / "a folder").mkdir()
    (tmp_path / "a link").symlink_to("nowhere")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "thesis.txt").write_text("years of work")
    (tmp_path / "broken.py").write_text("TASK = 1 +")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", COMMANDS)
def test_nonsense_is_refused_in_one_line_that_names_the_option(
    command: str, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(place.rglob("*"))
    for action in arguments_of(command):
        name = action.option_strings[-1] if action.option_strings else action.dest
        for value in nonsense(action.type):
            line = line_with(command, action, value)
            assert main(line) == 2, line
            said = capsys.readouterr()
            assert said.err.count("\n") == 1, line
            assert name in said.err.replace(value, ""), (line, said.err)
            assert len(said.err) < 1500, line
            assert not said.out
            assert sorted(place.rglob("*")) == before, line


def test_options_that_contradict_each_other_are_refused(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for line, name in (
        ("evaluate --generator oracle oracle", "--generator"),
        ("evaluate --task can CAN", "can"),
        ("evaluate --policy data/thesis.txt", "--policy"),
        ("evaluate --sigma 1", "--sigma"),
        ("evaluate --oracle-tries 3", "--oracle-tries"),
        ("render demonstrations --no-images", "--no-images"),
        ("collect --generator planner_only --policy data/thesis.txt", "--policy"),
        ("render demonstrations --workspace 0 0 0 1 0 1", "--workspace"),
        ("list can", "can"),
        ("render demonstrations --cameras front front", "--cameras"),
        ("collect --demoz 3", "--demos"),
        ("forge --budget 3s", "--budget"),
        ("compare --vary 1x 2", "--vary"),
        ("compare --vary gamma 1 1", "--vary"),
        ("verify demonstrations --task-file bottle", "--task-file"),
        ("list --all", "--all"),
        ("collect --task peach --out demonstrations", "--out"),
        ("evaluate --out .", "--out"),
        ("export demonstrations", "--format"),
        ("info", "folder"),
        ("--version of", "--version"),
        ("colect", "collect"),
    ):
        before = sorted(place.rglob("*"))
        assert main(line.split()) == 2, line
        said = capsys.readouterr().err
        assert said.count("\n") == 1, line
        assert name in said, line
        assert sorted(place.rglob("*")) == before, line


def test_refusing_imports_neither_torch_nor_physics(tmp_path: Path) -> None:
    code = f"""
import sys
from dynaforge.cli.main import main
for command in {list(COMMANDS)!r}:
    assert main([command, "--nonsense"]) == 2
assert main(["collect", "--seed", "-1"]) == main(["evaluate", "--task", "cann"]) == main(["info", "gone"]) == 2
assert main(["compare", "--vary", "n_steps", "0"]) == main(["compare", "--report-only", "--out", "new"]) == 2
print([name for name in ("torch", "pybullet", "pinocchio", "matplotlib", "rich") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stdout == "[]\n"
    assert done.stderr.count("\n") == len(COMMANDS) + 5
    assert not list(tmp_path.iterdir())
