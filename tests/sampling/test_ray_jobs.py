"""Jobs on actors that die, hang and never come up, on a stand-in for Ray."""

from __future__ import annotations

import sys
from collections.abc import Callable
from itertools import count
from typing import Any

import pytest
from fake_ray import FakeRay

from dynaforge.sampling import ray_jobs
from dynaforge.sampling.jobs import in_order
from dynaforge.sampling.processes import NoWorkers
from dynaforge.sampling.ray_jobs import RayJobs

Connect = Callable[..., FakeRay]


@pytest.fixture
def connect(monkeypatch: pytest.MonkeyPatch) -> Connect:
    def to(ray: FakeRay) -> FakeRay:
        monkeypatch.setitem(sys.modules, "ray", ray)  # type: ignore[arg-type]
        return ray

    return to


class Squaring:
    made = 0

    def __init__(self) -> None:
        type(self).made += 1

    def __call__(self, job: int) -> int:
        if job < 0:
            raise ValueError(f"{job} is negative")
        return job**2

    def mood(self) -> str:
        return "well"


def squaring(**options: Any) -> RayJobs[int, Any]:
    return RayJobs(Squaring, failed=lambda job, problem: f"{job}: {problem}", **options)


def test_each_actor_makes_one_worker_and_results_come_in_order(
    connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Squaring, "made", 0)
    ray = connect(FakeRay(cores=3))
    assert list(in_order(squaring(), range(20))) == [k**2 for k in range(20)]
    assert Squaring.made == len(ray.actors) == 3
    assert not any(actor.alive for actor in ray.actors), "they end with the jobs"


def test_no_more_is_taken_than_keeps_the_actors_busy(connect: Connect) -> None:
    connect(FakeRay(cores=3))
    source = count()
    results = in_order(squaring(size=2, queued=2), source)
    assert [next(results) for _ in range(10)] == [k**2 for k in range(10)]
    results.close()
    assert next(source) <= 10 + 2 * 2


def test_a_job_that_takes_its_actors_down_is_the_only_one_that_fails(connect: Connect) -> None:
    ray = connect(FakeRay(cores=2, deadly=[5]))
    results = list(in_order(squaring(), range(12)))
    assert results == [k**2 if k != 5 else "5: worker lost: RayError" for k in range(12)]
    assert ray.died_at == [5] * ray_jobs.MAX_ACTOR_DEATHS


def test_a_lost_node_costs_no_job(connect: Connect) -> None:
    ray = connect(FakeRay(cores=6))
    jobs, results = squaring(), []
    for result in in_order(jobs, range(30)):
        results.append(result)
        if len(results) % 5 == 0:
            for actor in ray.actors[-4:]:
                actor.die()
    assert results == [k**2 for k in range(30)]


def test_actors_that_died_while_idle_are_no_fault_of_the_next_job(connect: Connect) -> None:
    ray = connect(FakeRay(cores=8))
    jobs = squaring()
    source = iter(range(9))
    jobs.hand_out(source)
    assert jobs.next_result() == 0
    while jobs._starting:
        jobs.wait(1.0)
    for actor in ray.actors[:7]:
        actor.die()
    jobs.hand_out(iter([7]))
    assert jobs.next_result() == 49


def test_a_hanging_job_fails_and_the_rest_goes_on(connect: Connect) -> None:
    connect(FakeRay(cores=1, hanging=[1]))
    assert list(in_order(squaring(timeout=0.05), range(4))) == [0, "1: worker lost: it ran for 0.05 s", 4, 9]


def test_what_a_worker_raises_ends_the_jobs_as_it_does_locally(connect: Connect) -> None:
    ray = connect(FakeRay())
    with pytest.raises(ValueError, match=r"^-1 is negative$"):
        list(in_order(squaring(), [1, -1, 2]))
    assert not any(actor.alive for actor in ray.actors)


def test_without_any_actor_it_ends_with_the_reason(connect: Connect, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray_jobs, "NO_ACTOR_TIMEOUT", 0.2)
    connect(FakeRay()).broken = True
    with pytest.raises(NoWorkers, match=r"within 0\.2 s \(the actor is dead\).*installed on every node"):
        list(in_order(squaring(), range(4)))


def test_results_may_be_taken_as_they_come_and_workers_be_asked(connect: Connect) -> None:
    connect(FakeRay(cores=2, hanging=[0]))
    jobs, source, results = squaring(queued=1, answering=True), iter(range(5)), []
    while len(results) < 4:
        jobs.hand_out(source)
        jobs.wait(1.0)
        results += jobs.finished()
    assert results == [1, 4, 9, 16], "the first still hangs"
    assert len(jobs.running) == 1
    assert jobs.ask("mood") == [(0, "well")], "the other worker is idle"
    jobs.kill()
