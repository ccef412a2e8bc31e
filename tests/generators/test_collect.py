from __future__ import annotations

from itertools import islice
from pathlib import Path

import pytest

from dynaforge.cli.main import main
from dynaforge.demos import Attempt, DemonstrationDataset
from dynaforge.generators import Goal, PlannerOnly, Source, collect
from dynaforge.tasks import get_task

CAN = get_task("can")


def stream(n: int, source: Source | None = None) -> list[str]:
    return [condition.id for condition in islice((source or Source()).conditions(CAN), n)]


def ids(attempts: list[Attempt]) -> list[str]:
    return [attempt.condition.id for attempt in attempts]


def test_shards_divide_the_stream() -> None:
    shards = [stream(4, Source(0, (i, 3))) for i in range(3)]
    assert [shards[k % 3][k // 3] for k in range(12)] == stream(12)
    assert not set(stream(12)) & set(stream(12, Source(1)))


def test_an_interrupted_collection_goes_on_and_attempts_nothing_twice(tmp_path: Path) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can")
    told: list[str] = []

    def stop_at_three(attempt: Attempt) -> None:
        told.append(attempt.condition.id)
        if len(told) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(dataset, CAN, PlannerOnly(), Goal(None, 6), workers=2, tell=stop_at_three)
    assert told == stream(3)
    again: list[str] = []
    dataset = DemonstrationDataset(tmp_path, task="can")
    done = collect(
        dataset, CAN, PlannerOnly(), Goal(None, 6), workers=2, tell=lambda attempt: again.append(attempt.condition.id)
    )
    assert ids(done) == again == stream(6)
    assert ids(dataset.ledger.attempts()) == stream(6)
    lines = (tmp_path / "ledger.jsonl").read_text().splitlines()
    assert len(lines) == 6


def test_what_is_missing_in_the_middle_is_attempted(tmp_path: Path) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can")
    for index, condition in enumerate(islice(Source().conditions(CAN), 4)):
        if index != 1:
            dataset.record(Attempt(condition, "planner_only", success=False, checkpoint=0, failure="x", phase="",
                                   duration=0.0))  # fmt: skip
    done = collect(dataset, CAN, PlannerOnly(), Goal(None, 4), workers=1)
    assert sorted(ids(done)) == sorted(stream(4))
    assert [attempt.condition.id for attempt in done if attempt.failure != "x"] == stream(4)[1:2]


def test_a_goal_of_successes_counts_those_already_held(tmp_path: Path) -> None:
    dataset = DemonstrationDataset(tmp_path, task="can")
    for condition in islice(Source().conditions(CAN), 2):
        dataset.record(
            Attempt(condition, "planner_only", success=True, checkpoint=5, failure="", phase="", duration=0.0)
        )
    assert ids(collect(dataset, CAN, PlannerOnly(), Goal(2, None))) == stream(2)


def test_collect_says_what_it_holds_and_refuses_another_policy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["collect", "--generator", "planner_only", "--attempts", "2", "--workers", "1", "--out", str(tmp_path)]
    assert main(asked) == 0
    assert main(asked) == 0
    printed = capsys.readouterr().out
    assert "holds 2 attempts; going on" in printed
    assert "in 2 attempts, DGR" in printed
    (tmp_path / "generators.json").write_text('{"planner_only": "another"}')
    assert main(asked) == 2
    assert "holds attempts of policy another" in capsys.readouterr().err
    assert main(["collect", "--demos", "0", "--out", str(tmp_path)]) == 2
