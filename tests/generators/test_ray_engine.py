"""Attempts on a Ray cluster of two local nodes, one of which is killed; runs where Ray is installed."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import pytest

from dynaforge.demos import DemonstrationDataset, Episode
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import Goal, PlannerOnly, collect
from dynaforge.generators.ray_engine import run_attempts_on_ray
from dynaforge.sim import Condition
from dynaforge.tasks import get_task

CAN = get_task("can")


@dataclass
class Deadly:
    """Takes its process down at one condition; at others it is the planner."""

    condition: str
    name: str = "deadly"

    def attempt(self, env: ResidualEnv, condition: Condition) -> Episode:
        if condition.id == self.condition:
            os._exit(1)
        return PlannerOnly().attempt(env, condition)


def test_without_ray_or_cluster_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(ImportError, match=r"dynaforge\[ray\]"):
        next(run_attempts_on_ray(CAN, PlannerOnly(), []))


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("another_comes", [False, True])
def test_a_killed_node_costs_nothing(tmp_path: Path, another_comes: bool) -> None:
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    second = cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    try:
        conditions = list(islice(CAN.conditions.stream("train"), 24))
        results = []
        for result in run_attempts_on_ray(CAN, PlannerOnly(), conditions, workers=2):
            results.append(result)
            if len(results) == 6:
                cluster.remove_node(second, allow_graceful=False)
                if another_comes:
                    cluster.add_node(num_cpus=1)
        assert [r.attempt.condition.id for r in results] == [c.id for c in conditions], "each once and in order"
        assert not [r for r in results if "worker lost" in r.attempt.failure]
        dataset = DemonstrationDataset(tmp_path, task="can", keep_failures=True)
        done = collect(dataset, CAN, PlannerOnly(), Goal(None, 6), engine=run_attempts_on_ray, workers=2)
        assert [a.success for a in done[:6]] == [r.attempt.success for r in results[:6]]
    finally:
        ray.shutdown()
        cluster.shutdown()


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
def test_only_the_attempt_that_takes_actors_down_is_lost() -> None:
    ray = pytest.importorskip("ray")
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    ray.init(num_cpus=2, log_to_driver=False)
    try:
        conditions = list(islice(CAN.conditions.stream("train"), 8))
        results = list(run_attempts_on_ray(CAN, Deadly(conditions[3].id), conditions))
        assert [r.attempt.condition.id for r in results] == [c.id for c in conditions]
        assert ["worker lost" in r.attempt.failure for r in results] == [k == 3 for k in range(8)]
    finally:
        ray.shutdown()
