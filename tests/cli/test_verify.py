"""`dynaforge verify` on several cores: the same findings in the same order, whatever happens to a worker."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from itertools import islice

import pytest

from dynaforge.cli.main import main
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.folder_checks import read_notes
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import PlannerOnly
from dynaforge.generators.recording_checks import VerifyOptions, check_recordings
from dynaforge.geometry import Pose
from dynaforge.tasks import get_task
from dynaforge.tasks.view import PhaseView


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> DemonstrationDataset:
    env = ResidualEnv("toycar")
    made = DemonstrationDataset(tmp_path_factory.mktemp("data") / "toycar", task="toycar", keep_failures=True)
    for condition in islice(env.task.conditions.stream("val"), 8):
        made.add(PlannerOnly().attempt(env, condition))
    env.close()
    return made


@dataclass(frozen=True)
class Deadly:
    """Holds never, and ends the process in the episode that begins with the object at one place."""

    x: float

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        if view.start.objects["toycar"].pose.position[0] == self.x:
            os._exit(7)
        return False


@pytest.mark.slow
def test_a_recording_that_ends_its_worker_is_a_finding_and_the_rest_goes_on(dataset: DemonstrationDataset) -> None:
    task, names = get_task("toycar"), dataset.ids()
    x = float(dataset[names[4]].steps["object/toycar/position"][0, 0])
    deadly = replace(task, impossible=(*task.impossible, ("never", Deadly(x))))
    options = VerifyOptions(folder=dataset.path, task=deadly, notes=read_notes(dataset), replay=True)
    found = list(check_recordings(options, names, workers=2))
    assert len(found) == len(names)
    for k, findings in enumerate(found):
        problems = [finding.problem for finding in findings if "task_hash" not in finding.problem]
        assert any("ends the process" in problem for problem in problems) == (k == 4), problems
        assert [finding.path for finding in findings] == [dataset.file_of(names[k])] * len(findings)


@pytest.mark.slow
def test_workers_find_the_same_in_the_same_order(
    dataset: DemonstrationDataset, capsys: pytest.CaptureFixture[str]
) -> None:
    texts = []
    whole = {path: path.read_bytes() for path in (dataset.file_of(name) for name in dataset.ids()[::3])}
    for path, data in whole.items():
        path.write_bytes(data[:-1])
    for workers in ("1", "2"):
        assert main(["verify", str(dataset.path), "--replay", "--workers", workers]) == 1
        texts.append(capsys.readouterr().out)
    for path, data in whole.items():
        path.write_bytes(data)
    assert texts[0] == texts[1]
    assert texts[0].count("do not match the hash") == len(whole)
