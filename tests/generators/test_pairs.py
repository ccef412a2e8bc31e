"""Measuring a pair of generator and task: what is stored is kept, a killed run goes on, and nothing is mixed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from dynaforge.generators import Oracle, PlannerOnly, Result
from dynaforge.generators.attempts import failed_attempt
from dynaforge.generators.measurements import Measurement
from dynaforge.generators.pairs import Pair
from dynaforge.generators.prediction import Prediction
from dynaforge.sim import Condition
from dynaforge.sim.loads import Loads
from dynaforge.tasks import Outcome, get_task

CAN = get_task("can")


class Engine:
    """Makes hand-made attempts: those slower than 0.8 m/s succeed. Counts them, and dies at the one of a number."""

    def __init__(self, dies_at: int | None = None) -> None:
        self.made: list[str] = []
        self.dies_at = dies_at

    def __call__(
        self, task: object, generator: object, conditions: Iterable[Condition], **_: object
    ) -> Iterator[Result]:
        for condition in conditions:
            if len(self.made) == self.dies_at:
                raise KeyboardInterrupt
            self.made.append(condition.id)
            attempt = failed_attempt(condition, "planner_only", "dropped").attempt
            outcome = Outcome(success=True, checkpoint=5) if condition.difficulty < 0.8 else attempt.outcome
            attempt = replace(attempt, outcome=outcome, loads=Loads(standard=0.5, strict=2.0), cpu_seconds=0.25)
            yield Result(attempt, PlannerOnly())  # type: ignore[arg-type]  # anything but None is an episode here


def pair(folder: Path, **changes: object) -> Pair:
    made = Pair(
        task=CAN,
        row="planner_only",
        generator=PlannerOnly(),
        stream="val",
        blocks=2,
        attempts=3,
        path=folder / "can" / "planner_only.json",
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def test_what_is_measured_is_stored_as_it_was(tmp_path: Path) -> None:
    made = pair(tmp_path).measure(engine=Engine())
    read = Measurement.load(tmp_path / "can" / "planner_only.json")
    assert list(read.attempts) == list(made.attempts)
    assert {**read.header} == {**made.header}
    assert [attempt.block for attempt in read.attempts] == [0, 0, 0, 1, 1, 1]
    streams = [CAN.conditions.stream("val", block) for block in (0, 1)]
    assert read.ids == [next(stream).id for stream in streams for _ in range(3)]
    assert all(attempt.speed == attempt.difficulty for attempt in read.attempts)
    assert read.success == [attempt.difficulty < 0.8 for attempt in read.attempts]
    assert read.attempts[0].loads == Loads(standard=0.5, strict=2.0)
    assert (read.header["skill"], read.header["unit"], read.header["speed_range"]) == ("grasp", "m/s", (0.05, 1.5))


def test_what_is_there_is_not_measured_again(tmp_path: Path) -> None:
    first = pair(tmp_path).measure(engine=Engine())
    again = Engine()
    assert list(pair(tmp_path).measure(engine=again).attempts) == list(first.attempts)
    assert again.made == []


def test_a_kill_leaves_no_half_pair(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        pair(tmp_path).measure(engine=Engine(dies_at=4))
    assert pair(tmp_path).stored() is None


def test_a_pair_that_ended_early_goes_on_where_it_stopped(tmp_path: Path) -> None:
    seen: list[bool] = []
    early = pair(tmp_path).measure(
        engine=Engine(), until=lambda attempt: seen.append(attempt.success) or len(seen) == 4
    )
    assert [attempt.block for attempt in early.attempts] == [0, 0, 0, 1]
    assert seen == early.success
    rest = Engine()
    whole = pair(tmp_path).measure(engine=rest)
    assert len(rest.made) == 2
    assert list(whole.attempts) == list(pair(tmp_path / "elsewhere").measure(engine=Engine()).attempts)
    judged: list[bool] = []
    pair(tmp_path).measure(engine=rest, until=lambda attempt: judged.append(attempt.success) is not None)
    assert judged == whole.success  # what is stored is judged too


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"attempts": 4}, "was measured with attempts 3, now attempts 4 is asked for. Choose another --out"),
        ({"stream": "test", "blocks": 1}, "with stream 'val', blocks 2, now stream 'test', blocks 1 is"),
        ({"generator": Oracle(m=2)}, "with generator 'planner_only', now generator 'oracle' is"),
        ({"task": CAN.under(reflex="strict")}, "with setting (reflex contact"),
        ({"generator": Prediction(0.1)}, "with generator 'planner_only', now generator 'prediction' is"),
        (
            {"task": replace(CAN, lead_time=0.1)},
            "another definition of task 'can' than the present one",
        ),
    ],
)
def test_a_measurement_of_something_else_is_refused(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    pair(tmp_path).measure(engine=Engine())
    other, engine = pair(tmp_path, **changes), Engine()
    with pytest.raises(ValueError) as refused:
        other.measure(engine=engine)
    assert message in str(refused.value)
    assert not engine.made


@pytest.mark.parametrize("damage", ["", "[]", "{}", '{"attempts": [{}]}', '{"attempts": 3}', "\udcff", "[" * 9999])
def test_a_damaged_file_is_refused_by_its_name(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "can" / "planner_only.json"
    path.parent.mkdir()
    path.write_bytes(damage.encode("utf-8", "surrogateescape"))
    with pytest.raises(ValueError, match=r"can/planner_only.json holds no measurement \(.*\). Remove it\."):
        pair(tmp_path).measure(engine=Engine())
