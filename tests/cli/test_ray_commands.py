"""`--engine ray` of the commands: the same bits as locally, on two local nodes of which one is killed."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dynaforge.cli.main import main
from dynaforge.sim.setting import Setting
from dynaforge.training import run as runs
from dynaforge.training.history import TrainingHistory
from dynaforge.training.ray_runs import RayRuns
from dynaforge.training.run_pool import News, RunPool
from dynaforge.training.run_spec import PLANNER_ONLY, Evaluation, RunSpec
from dynaforge.training.stored_training import CHECKPOINT

BY_COMMAND = {
    "collect": ["--generator", "planner_only"],
    "evaluate": ["--generator", "planner_only"],
    "compare": ["--algos", "grpo"],
}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    asked = ["collect", "--generator", "planner_only", "--attempts", "3", "--keep-failures", "--workers", "1"]
    assert main([*asked, "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Return a cluster of two nodes with one core each, to which this process is connected."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    cluster.second = cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    yield cluster
    ray.shutdown()
    cluster.shutdown()


@pytest.mark.parametrize("command", [*BY_COMMAND, "render"])
def test_without_ray_a_command_says_what_to_install_and_makes_nothing(
    command: str,
    data: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    asked = [*BY_COMMAND.get(command, [str(data)]), "--out", str(tmp_path / "out"), "--engine"]
    assert main([command, *asked, "ray"]) == 2
    said = capsys.readouterr()
    assert said.err == f"dynaforge {command}: Engine ray needs Ray: pip install 'dynaforge[ray]'.\n"
    assert said.out == ""
    assert main([command, *asked, "rya"]) == 2
    assert "No engine 'rya'. Did you mean 'ray'? Known are local, ray." in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.filterwarnings("ignore")
def test_evaluate_and_render_give_the_same_bits_as_locally(cluster: Any, data: Path, tmp_path: Path) -> None:
    measured, rendered = {}, {}
    for engine in ("local", "ray"):
        out = tmp_path / f"{engine}.json"
        asked = ["--generator", "planner_only", "--seeds", "2", "--attempts", "3", "--workers", "2"]
        assert main(["evaluate", *asked, "--engine", engine, "--out", str(out)]) == 0
        measured[engine] = json.loads(out.read_text()) | {"command": ""}
        out = tmp_path / f"{engine}-pictures"
        asked = ["--cameras", "front", "--size", "32", "24", "--workers", "2"]
        assert main(["render", str(data), *asked, "--engine", engine, "--out", str(out)]) == 0
        rendered[engine] = {path.name: path.read_bytes() for path in out.iterdir()}
    assert measured["ray"] == measured["local"]
    assert rendered["ray"] == rendered["local"]
    assert len(rendered["ray"]) == 1 + 3


class KillsNode:
    """Runs on a cluster that loses its second node as soon as two of them are under way."""

    def __init__(self, runs: RayRuns, cluster: Any) -> None:
        self._runs, self._cluster = runs, cluster
        self.steps: dict[Path, list[int]] = {}
        self.killed = False

    @property
    def left(self) -> int:
        return self._runs.left

    def news(self, seconds: float) -> list[News]:
        news = self._runs.news(seconds)
        for spec, what in news:
            if isinstance(what, dict) and "steps" in what:
                self.steps.setdefault(spec.folder, []).append(what["steps"])
        if len(self.steps) == 2 and not self.killed:
            assert self.left == 2
            self.killed = True
            self._cluster.remove_node(self._cluster.second, allow_graceful=False)
        return news

    def stop(self) -> None:
        self._runs.stop()


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.filterwarnings("ignore")
def test_a_killed_node_costs_compare_only_the_run_that_it_made(cluster: Any, tmp_path: Path) -> None:
    evaluation = Evaluation("val", 1, 2)
    planner = RunSpec(
        task="can",
        setting=Setting(),
        variant=PLANNER_ONLY,
        algo="",
        changes={},
        seed=0,
        steps=0,
        evaluation=evaluation,
        folder=tmp_path / "ray" / "can" / PLANNER_ONLY,
    )
    tiny = {"n_groups": 4, "group_size": 2, "n_envs": 4}
    trained = [
        replace(planner, variant="grpo", algo="grpo", changes=tiny, seed=seed, steps=400, folder=folder)
        for seed in range(2)
        for folder in [tmp_path / "ray" / "can" / "grpo" / f"seed-{seed}"]
    ]
    specs = [planner, *trained]
    trained[0].folder.mkdir(parents=True)
    (trained[0].folder / CHECKPOINT).write_bytes(b"of an interrupted run")
    pool = KillsNode(RayRuns(specs), cluster)
    assert RunPool(specs, pool, seconds=1000.0).work()
    assert pool.killed
    restarted = [steps for steps in pool.steps.values() if steps != sorted(steps)]
    assert len(restarted) <= 1, "the other went on where it was"
    for spec in specs:
        here = replace(spec, folder=tmp_path / "local" / spec.folder.relative_to(tmp_path / "ray"))
        if spec is planner:
            here.folder.mkdir(parents=True)
            runs.evaluate(here.make_task(), runs.PlannerOnly(), evaluation, here.folder / "exam.json")
        else:
            runs.train(here)
        assert {path.name for path in spec.folder.iterdir()} == {path.name for path in here.folder.iterdir()}
        for name in ("run.json", "exam.json", "policy.safetensors"):
            if (here.folder / name).exists():
                assert (spec.folder / name).read_bytes() == (here.folder / name).read_bytes(), name
        if spec is not planner:
            there, local = (TrainingHistory.load(s.folder / "history.json") for s in (spec, here))
            for name in ("successes", "trials", "groups", "timesteps", "optimizer_steps", "probes"):
                assert getattr(there, name) == getattr(local, name), name
