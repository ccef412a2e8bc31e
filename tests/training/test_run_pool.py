"""Many runs with one progress bar, wherever they are made; what is finished stays."""

from __future__ import annotations

import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from dynaforge.files import atomic
from dynaforge.tasks import get_task
from dynaforge.training import ray_runs
from dynaforge.training.matrix import run_matrix
from dynaforge.training.ray_runs import MadeRun, RunMaker
from dynaforge.training.run_pool import News, RunPool
from dynaforge.training.run_process import LocalRuns
from dynaforge.training.run_spec import Evaluation, RunSpec
from dynaforge.training.stored_training import CHECKPOINT


def planner(folder: Path) -> RunSpec:
    (spec,) = run_matrix([get_task("can")], {}, seeds=0, steps=0, evaluation=Evaluation("val", 1, 1), out=folder)
    return replace(spec, folder=folder)


class Told:
    """Runs of which a script tells the news; None is Ctrl-C."""

    def __init__(self, specs: list[RunSpec], script: list[News | None]) -> None:
        self.left, self._script, self.stopped = len(specs), iter(script), False

    def news(self, seconds: float) -> list[News]:
        news = next(self._script, ())
        if news is None:
            raise KeyboardInterrupt
        self.left -= isinstance(news[1], str) if news else 0
        return [news] if news else []

    def stop(self) -> None:
        self.stopped = True


@pytest.fixture
def two(tmp_path: Path) -> list[RunSpec]:
    return [replace(planner(tmp_path / f"seed-{seed}"), steps=100, seed=seed) for seed in range(2)]


def test_runs_are_made_until_all_are_finished(two: list[RunSpec]) -> None:
    runs = Told(two, [(two[0], {"steps": 50, "text": ""}), (two[1], ""), (two[0], {"text": "measuring"}), (two[0], "")])
    assert RunPool(two, runs, seconds=100.0).work()
    assert runs.stopped


def test_a_failed_run_is_named_and_the_others_go_on(two: list[RunSpec], capsys: pytest.CaptureFixture[str]) -> None:
    runs = Told(two, [(two[0], ": worker lost"), (two[1], "")])
    assert not RunPool(two, runs, seconds=100.0).work()
    assert runs.left == 0
    assert capsys.readouterr().err.splitlines()[-1] == f"{two[0].folder} failed: worker lost"


@pytest.mark.parametrize(("rest", "seconds"), [([None], 100.0), ([], 0.0)])
def test_at_ctrl_c_or_when_time_is_up_the_runs_are_stopped(
    two: list[RunSpec], rest: list[None], seconds: float
) -> None:
    runs = Told(two, [(two[0], ""), *rest])
    assert not RunPool(two, runs, seconds=seconds).work()
    assert runs.stopped


def test_local_runs_are_processes_whose_log_stays_where_they_fail(tmp_path: Path) -> None:
    good, bad = planner(tmp_path / "planner_only"), replace(planner(tmp_path / "bad"), task="cann")
    runs = LocalRuns([good, bad], 2)
    told: dict[Path, str] = {}
    while runs.left:
        told |= {spec.folder: what for spec, what in runs.news(60.0) if isinstance(what, str)}
    assert told[good.folder] == ""
    assert [path.name for path in good.folder.iterdir()] == ["exam.json"]
    assert told[bad.folder].startswith(" with status 1: ")
    assert "Did you mean 'can'" in told[bad.folder]
    assert told[bad.folder].endswith(f"(all of it in {bad.folder / 'log.txt'})")


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    names: list[str] = []

    def write(path: Path, content: bytes) -> None:
        names.append(path.name)
        atomic.atomic_write(path, content)

    monkeypatch.setattr(ray_runs, "atomic_write", write)
    return names


def test_the_file_that_marks_a_run_from_a_cluster_as_finished_comes_last(tmp_path: Path, written: list[str]) -> None:
    spec = planner(tmp_path / "run")
    spec.folder.mkdir()
    for name in (CHECKPOINT, "log.txt"):
        (spec.folder / name).write_bytes(b"of an interrupted run")
    assert MadeRun(spec, 0, {"exam.json": b"{}", "policy.safetensors": b"p", "run.json": b"{}"}).store() == ""
    assert written[-1] == "exam.json"
    assert spec.finished
    assert {path.name for path in spec.folder.iterdir()} == {"exam.json", "policy.safetensors", "run.json"}
    new = planner(tmp_path / "no folder yet")
    assert MadeRun(new, 0, {"exam.json": b"{}"}).store() == ""


def test_a_run_that_failed_on_a_cluster_leaves_its_log_and_what_was_there(tmp_path: Path) -> None:
    spec = planner(tmp_path / "run")
    spec.folder.mkdir()
    (spec.folder / CHECKPOINT).write_bytes(b"of an interrupted run")
    why = MadeRun(spec, 1, {"log.txt": b"Traceback\nValueError: no\n"}).store()
    assert why == f" with status 1: ValueError: no (all of it in {spec.folder / 'log.txt'})"
    assert MadeRun(spec, 1, problem="worker lost: ActorDiedError").store() == ": worker lost: ActorDiedError"
    assert not spec.finished
    assert (spec.folder / CHECKPOINT).exists()


@pytest.mark.parametrize("stopped", [False, True])
def test_a_run_on_a_node_tells_its_progress_and_leaves_no_file_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stopped: bool
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    evaluation = Evaluation("val", 1, 60 if stopped else 2)
    maker, spec = RunMaker(), replace(planner(tmp_path / "of the driver"), evaluation=evaluation)
    with ThreadPoolExecutor() as threads:
        making = threads.submit(maker, spec)
        while not (making.done() or "measuring" in maker.progress().get("text", "")):
            time.sleep(0.02)
        if stopped:
            maker.stop()
            assert not list(tmp_path.iterdir())
    made = making.result()
    assert (made.spec, made.status != 0, set(made.files)) == (spec, stopped, {"log.txt" if stopped else "exam.json"})
    assert not list(tmp_path.iterdir())
    assert maker.progress() == {}
