from __future__ import annotations

import json
import shutil
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest

from dynaforge.cli.main import main
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.generators import ConditionSource, Goal, PlannerOnly, collect, run_attempts
from dynaforge.generators.attempts import failed_attempt
from dynaforge.tasks import get_task

CAN = get_task("can")


def stream(n: int, source: ConditionSource | None = None) -> list[str]:
    return [condition.id for condition in islice((source or ConditionSource()).conditions(CAN), n)]


def ids(attempts: list[Attempt]) -> list[str]:
    return [attempt.condition.id for attempt in attempts]


def test_shards_divide_the_stream() -> None:
    shards = [stream(4, ConditionSource(0, (i, 3))) for i in range(3)]
    assert [shards[k % 3][k // 3] for k in range(12)] == stream(12)
    assert not set(stream(12)) & set(stream(12, ConditionSource(1)))


def test_an_interrupted_collection_goes_on_and_attempts_nothing_twice(tmp_path: Path) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can")
    collected: list[str] = []

    def stop_at_three(attempt: Attempt) -> None:
        collected.append(attempt.condition.id)
        if len(collected) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(dataset, CAN, PlannerOnly(), Goal(None, 6), workers=2, on_attempt=stop_at_three)
    assert collected == stream(3)
    again: list[str] = []
    dataset = DemonstrationDataset(tmp_path, task="can")
    done = collect(
        dataset,
        CAN,
        PlannerOnly(),
        Goal(None, 6),
        workers=2,
        on_attempt=lambda attempt: again.append(attempt.condition.id),
    )
    assert ids(done) == again == stream(6)
    assert done == dataset.ledger.attempts(), "with what was kept of each"
    lines = (tmp_path / "ledger.jsonl").read_text().splitlines()
    assert len(lines) == 6


def test_what_is_missing_in_the_middle_is_attempted(tmp_path: Path) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can")
    for index, condition in enumerate(islice(ConditionSource().conditions(CAN), 4)):
        if index != 1:
            dataset.record(failed_attempt(condition, "planner_only", "x").attempt)
    done = collect(dataset, CAN, PlannerOnly(), Goal(None, 4), workers=1)
    assert sorted(ids(done)) == sorted(stream(4))
    assert [attempt.condition.id for attempt in done if attempt.failure != "x"] == stream(4)[1:2]


@pytest.fixture(scope="module")
def two_successes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the two easiest conditions of some, on which the planner succeeds."""
    folder = tmp_path_factory.mktemp("successes")
    dataset = DemonstrationDataset(folder, task="can")
    easy = sorted(islice(ConditionSource().conditions(CAN), 24), key=lambda condition: condition.difficulty)[:2]
    for result in run_attempts(CAN, PlannerOnly(), easy, workers=1):
        assert result.episode is not None
        dataset.add(result.episode)
    assert len(dataset) == 2
    return folder


def test_a_goal_of_successes_counts_those_already_recorded(two_successes: Path, tmp_path: Path) -> None:
    shutil.copytree(two_successes, tmp_path, dirs_exist_ok=True)
    dataset = DemonstrationDataset(tmp_path, task="can")
    attempt = dataset.attempts()[0]
    source = ConditionSource(shard=(stream(24).index(attempt.condition.id), 24))
    assert ids(collect(dataset, CAN, PlannerOnly(), Goal(1, None), source=source)) == [attempt.condition.id]
    assert len(dataset.ledger.path.read_text().splitlines()) == 2, "the recorded one was not made again"


def test_a_recording_that_was_deleted_is_made_again_bit_for_bit(two_successes: Path, tmp_path: Path) -> None:
    """As the message on a damaged file advises."""
    shutil.copytree(two_successes, tmp_path, dirs_exist_ok=True)
    dataset = DemonstrationDataset(tmp_path, task="can")
    attempt = dataset.attempts()[0]
    path, place = dataset.file_of(attempt.id), stream(24).index(attempt.condition.id)
    whole = path.read_bytes()
    path.unlink()
    assert [lost.id for lost in dataset.missing_recordings()] == [attempt.id]
    collect(dataset, CAN, PlannerOnly(), Goal(None, 1), source=ConditionSource(shard=(place, 24)), workers=1)
    assert path.read_bytes() == whole
    assert not dataset.missing_recordings()
    assert len(dataset.attempts()) == 2, "it is the same attempt"


def test_two_definitions_of_a_task_do_not_mix(tmp_path: Path) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can")
    collect(dataset, CAN, PlannerOnly(), Goal(None, 1), workers=1)
    other = replace(CAN, impossible=())
    with pytest.raises(ValueError, match="another definition of task 'can'"):
        collect(dataset, other, PlannerOnly(), Goal(None, 2), workers=1)


def test_collect_says_what_it_holds_and_refuses_another_policy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["collect", "--generator", "planner_only", "--attempts", "2", "--workers", "1", "--out", str(tmp_path)]
    assert main(asked) == 0
    assert main(asked) == 0
    printed = capsys.readouterr().out
    assert "holds 2 attempts; resuming" in printed
    assert "in 2 attempts, DGR" in printed
    noted = DemonstrationDataset(tmp_path).sources()["planner_only"]
    other = {"planner_only": {"policy": "another", "task_definition": noted.task_definition}}
    (tmp_path / "generators.json").write_text(json.dumps(other))
    assert main(asked) == 2
    assert "holds attempts of policy another" in capsys.readouterr().err
    assert main(["collect", "--demos", "0", "--out", str(tmp_path)]) == 2
