"""Collecting and measuring with a generator that gets nowhere: it ends, and says why."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from pathlib import Path

import pytest

from dynaforge.cli import collect as command
from dynaforge.cli.main import main
from dynaforge.demos import Attempt, DemonstrationDataset, Episode
from dynaforge.generators import ConditionSource, GaveUp, Goal, NoWorkers, PlannerOnly, Result, collect
from dynaforge.generators.attempts import failed_attempt
from dynaforge.generators.giving_up import refuse_if_all_raise
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome, get_task

CAN = get_task("can")


def engine(
    succeeds: Callable[[int], bool], *, ahead: int = 4, raising: bool = False
) -> Callable[..., Iterator[Result]]:
    """Return an engine that simulates nothing: the k-th attempt of all its runs succeeds where `succeeds(k)`."""
    k = 0

    def attempt(condition: Condition) -> Result:
        nonlocal k
        success, k = succeeds(k), k + 1
        if raising:
            return failed_attempt(condition, "planner_only", "exception: OSError: gone")
        reason = "" if success else ("dropped" if k % 3 else "slipped\naway")
        outcome = Outcome(success=success, checkpoint=5 if success else 1, failure=reason, phase="lift")
        episode = Episode(condition=condition, generator="planner_only", outcome=outcome, duration=1.0, steps={})
        return Result(Attempt.of(episode), episode)

    def run(task: object, generator: object, conditions: Iterable[Condition], **_: object) -> Iterator[Result]:
        source = iter(conditions)
        running = list(islice(source, ahead))
        while running:
            yield attempt(running.pop(0))
            running += islice(source, 1)

    return run


def gather(
    folder: Path, goal: Goal, succeeds: Callable[[int], bool] = lambda k: False, **engine_options: int
) -> list[Attempt]:
    dataset = DemonstrationDataset(folder, task="can")
    return collect(
        dataset, CAN, PlannerOnly(), goal, source=ConditionSource(), engine=engine(succeeds, **engine_options)
    )


def test_it_gives_up_with_the_commonest_reasons_and_keeps_what_was_attempted(tmp_path: Path) -> None:
    with pytest.raises(
        GaveUp, match=r"No success in 53 attempts in a row.*dropped \(36\), slipped away \(17\)"
    ) as caught:
        gather(tmp_path, Goal(1, None))
    assert len(caught.value.attempts) == len(DemonstrationDataset(tmp_path).attempts()) == 53  # 3 were under way
    again = pickle.loads(pickle.dumps(caught.value))
    assert (str(again), len(again.attempts)) == (str(caught.value), 53)


def test_what_an_earlier_run_found_counts_and_the_bound_may_be_moved(tmp_path: Path) -> None:
    for bound, attempts in ((7, 10), (7, 10), (9, 10), (12, 15)):  # 3 more are under way when it gives up
        with pytest.raises(GaveUp):
            gather(tmp_path, Goal(1, None, bound))
        assert len(DemonstrationDataset(tmp_path).attempts()) == attempts
    assert sum(attempt.success for attempt in gather(tmp_path, Goal(1, None, 0), lambda k: k == 20)) == 1


def test_a_success_of_those_under_way_turns_back_from_giving_up(tmp_path: Path) -> None:
    attempts = gather(tmp_path, Goal(2, None, 10), lambda k: k in (25, 33), ahead=20)
    assert [k for k, attempt in enumerate(attempts) if attempt.success] == [25, 33]
    stream = islice(ConditionSource().conditions(CAN), len(attempts))
    assert [attempt.condition.id for attempt in attempts] == [condition.id for condition in stream], "none is left out"


@pytest.mark.parametrize(
    ("goal", "failures", "should_give_up"),
    [
        (Goal(1, None), 49, False),
        (Goal(1, None), 50, True),
        (Goal(10, None), 199, False),
        (Goal(10, None), 200, True),
        (Goal(None, 10**6), 10**5, False),
        (Goal(None, 100, 7), 7, True),
        (Goal(1, None, 0), 10**9, False),
    ],
)
def test_hope_ends_after_twenty_failures_a_demonstration(goal: Goal, failures: int, should_give_up: bool) -> None:
    assert goal.should_give_up(failures) is should_give_up


def test_the_command_ends_with_1_and_says_what_it_did_not_get(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "run_attempts", engine(lambda k: k == 0))
    asked = ["collect", "--generator", "planner_only", "--out", str(tmp_path)]
    assert main([*asked, "--demos", "1"]) == 0
    assert main([*asked, "--demos", "5", "--attempts", "3"]) == 1
    assert "Only 1 of 5 demonstrations in 3 attempts; dropped" in capsys.readouterr().err
    assert main([*asked, "--demos", "5", "--give-up-after", "9"]) == 1
    said = capsys.readouterr().err
    assert "failed: dropped" in said, "the bar says it too"
    assert "No success in 12 attempts in a row" in said.splitlines()[-1]
    assert "--give-up-after N" in said.splitlines()[-1]
    assert main([*asked, "--attempts", "14"]) == 0, "failures may be what is asked for"


def test_evaluate_measures_no_rate_of_a_generator_that_only_raises(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = ["evaluate", "--seeds", "2", "--attempts", "3", "--out", str(tmp_path / "rate.json")]
    monkeypatch.setattr("dynaforge.generators.measure.run_attempts", engine(lambda k: False, raising=True))
    assert main(asked) == 1
    assert "None of 6 attempts by 'planner_only' left an episode" in capsys.readouterr().err.splitlines()[-1]
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr("dynaforge.generators.measure.run_attempts", engine(lambda k: False))
    assert main(asked) == 0


def test_workers_that_do_not_even_start_are_reported_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_engine(*_: object, **__: object) -> Iterator[Result]:
        raise NoWorkers("Worker processes die as they start.")

    monkeypatch.setattr(command, "run_attempts", no_engine)
    assert main(["collect", "--generator", "planner_only", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "dynaforge collect: Worker processes die as they start."


@pytest.mark.parametrize("n", [4, 500])
def test_a_generator_that_only_raises_has_no_rate(n: int) -> None:
    conditions = list(islice(ConditionSource().conditions(CAN), n))
    raising = engine(lambda k: False, raising=True)(CAN, PlannerOnly(), conditions)
    with pytest.raises(GaveUp, match=rf"None of {min(n, 50)} attempts .*exception: OSError: gone"):
        list(refuse_if_all_raise(raising, generator="mine"))
    failing = engine(lambda k: False)(CAN, PlannerOnly(), conditions)
    assert len(list(refuse_if_all_raise(failing, generator="mine"))) == n, "0 % was measured"
