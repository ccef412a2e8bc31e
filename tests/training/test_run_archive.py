"""The finished runs of a task in one file replace their folders."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from dynaforge.cli.main import main
from dynaforge.training.run_archive import ARCHIVE, is_finished, read_run, write_archives
from dynaforge.training.stored_run import StoredRun

RESULTS = Path(__file__).parents[2] / "results" / "compare"


def run_folder(folder: Path, *, seed: int | None, outcomes: tuple[str, ...] = ("success", "slipped")) -> Path:
    folder.mkdir(parents=True)
    attempts = [{"block": 0, "id": f"c{k}", "difficulty": 0.1 * k, "outcome": o} for k, o in enumerate(outcomes)]
    exam = {"stream": "val", "blocks": 1, "attempts": len(outcomes)}
    (folder / "exam.json").write_text(json.dumps({"task": "can", "exam": exam, "attempts": attempts}))
    if seed is not None:
        metadata = {"run": {"arm": "grpo", "seed": seed}, "settings": {"n_groups": 4}}
        (folder / "run.json").write_text(json.dumps(metadata))
        history = {"successes": [[1]], "trials": [[2]], "timesteps": [9], "probes": []}
        (folder / "history.json").write_text(json.dumps(history))
    return folder


def test_an_archive_replaces_the_folders_that_it_was_written_from(tmp_path: Path) -> None:
    folders = [run_folder(tmp_path / "can" / "planner_only", seed=None)]
    folders += [run_folder(tmp_path / "can" / "grpo" / f"seed-{seed}", seed=seed) for seed in (0, 1)]
    files = [read_run(folder) for folder in folders]
    write_archives(folders[:2])
    write_archives(folders[2:])  # what was archived before stays
    for folder in folders:
        shutil.rmtree(folder)
    assert [read_run(folder) for folder in folders] == files
    assert all(is_finished(folder) for folder in folders)
    assert not is_finished(tmp_path / "can" / "grpo" / "seed-2")
    stored = StoredRun.load(folders[2])
    assert (stored.variant, stored.seed, stored.rate, stored.failures) == ("grpo", 1, 0.5, ("slipped",))
    assert stored.history is not None


def test_a_folder_takes_precedence_over_the_archive(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "can" / "grpo" / "seed-0", seed=0)
    write_archives([folder])
    shutil.rmtree(folder)
    run_folder(folder, seed=0, outcomes=("success", "success"))
    assert StoredRun.load(folder).rate == 1.0


def test_runs_that_were_evaluated_on_other_conditions_are_not_archived_together(tmp_path: Path) -> None:
    write_archives([run_folder(tmp_path / "can" / "grpo" / "seed-0", seed=0)])
    other = run_folder(tmp_path / "can" / "grpo" / "seed-1", seed=1, outcomes=("success",))
    with pytest.raises(ValueError, match="different conditions"):
        write_archives([other])


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"conditions": [], "runs": {"grpo/seed-0": {"exam.json": {}}}}', "[" * 9999]
)
def test_a_damaged_archive_is_named_in_one_line(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "can").mkdir()
    (tmp_path / "can" / ARCHIVE).write_text(text)
    assert main(["compare", "--task", "can", "--algos", "grpo", "--report-only", "--out", str(tmp_path)]) == 2
    printed = capsys.readouterr().err
    assert f"{tmp_path / 'can' / ARCHIVE} is not an archive of runs" in printed
    assert printed.count("\n") == 1


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.skipif(not RESULTS.exists(), reason="results are not part of a source distribution")
def test_the_stored_table_is_computed_again_from_the_archives(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "compare"
    shutil.copytree(RESULTS, out, ignore=shutil.ignore_patterns("*.safetensors"))
    command, table = (RESULTS / "table.txt").read_text().split("\n", 1)
    arguments = command.removeprefix("dynaforge ").split()
    arguments[arguments.index("--out") + 1] = str(out)
    assert main(arguments) == 0
    assert (out / "table.txt").read_text().split("\n", 1)[1] == table
    assert [path.name for path in (out / "can").rglob("*.json")] == [ARCHIVE], "no run was made again"
