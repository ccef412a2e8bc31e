from __future__ import annotations

from pathlib import Path

import pytest

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.cli.commands import COMMANDS
from dynaforge.cli.main import main
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import TASK_NAMES


def error_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(arguments) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1, "a user's mistake is answered in one line"
    return message


def test_misspelt_command_is_answered_with_the_close_match(capsys: pytest.CaptureFixture[str]) -> None:
    assert "Did you mean 'forge'?" in error_of(capsys, "forgee")


def test_misspelt_task_is_answered_with_the_close_match(capsys: pytest.CaptureFixture[str]) -> None:
    assert "No task 'cann'. Did you mean 'can'?" in error_of(capsys, "forge", "--task", "cann")
    assert "No task 'cann'. Did you mean 'can'?" in error_of(capsys, "evaluate", "--task", "cann")


def test_unknown_generator_and_missing_policy_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert "No generator 'magic'" in error_of(capsys, "evaluate", "--generator", "magic")
    assert "--policy gone: no such file" in error_of(capsys, "evaluate", "--generator", "residual", "--policy", "gone")


def test_shipped_policies_are_policies_of_their_task() -> None:
    for name in TASK_NAMES:
        assert MlpPolicyFile.load(asset_path(f"{name}/policy.safetensors")).task == name


def test_forge_refuses_a_folder_with_other_data_and_leaves_it_alone(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    assert "holds other data" in error_of(capsys, "forge", "--out", str(tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_forge_refuses_a_folder_that_cannot_be_made(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert "cannot be made" in error_of(capsys, "forge", "--out", str(tmp_path / "file" / "run"))


def test_forge_names_an_unknown_algorithm_before_it_measures(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert "--algo: No algorithm 'magic'" in error_of(
        capsys, "forge", "--algo", "magic", "--out", str(tmp_path / "run")
    )
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("budget", ["-1m", "soon", "0s", "nan"])
def test_forge_refuses_a_budget_that_is_no_span_of_time(capsys: pytest.CaptureFixture[str], budget: str) -> None:
    assert f"--budget {budget!r} is no span of time" in error_of(capsys, "forge", f"--budget={budget}")


def test_list_and_describe_show_what_the_task_data_says(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    assert "DynaForge/Can-v0" in capsys.readouterr().out
    assert main(["describe", "can"]) == 0
    page = capsys.readouterr().out
    for word in ("pregrasp", "track", "descend", "close", "lift", "speed (difficulty) | 0.05 | 1.5"):
        assert word in page


def test_measurements_in_several_settings_do_not_overwrite_each_other() -> None:
    asked = ([], ["--physics", "wide"], ["--physics", "wide:hand_delay"], ["--reflex", "strict"], ["--reflex", "30"])
    files = [COMMANDS["evaluate"].read("evaluate", arguments).out for arguments in asked]
    assert files[0] == Path("runs/evaluate/planner_only-val.json")
    assert files[2] == Path("runs/evaluate/planner_only-val-wide-hand_delay.json")
    assert len(set(files)) == len(files)
