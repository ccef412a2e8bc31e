from __future__ import annotations

import json
from dataclasses import replace

import pytest

from dynaforge.benchmarks import data as bench_data
from dynaforge.benchmarks import determinism as bench_determinism
from dynaforge.benchmarks import forces as bench_forces
from dynaforge.benchmarks import hand as bench_hand
from dynaforge.benchmarks import limits as bench_limits
from dynaforge.benchmarks import prefix as bench_prefix
from dynaforge.benchmarks import speed as bench_speed
from dynaforge.benchmarks import suite
from dynaforge.benchmarks import training as bench_training
from dynaforge.benchmarks import vector as bench_vector
from dynaforge.benchmarks.figure import Figure
from dynaforge.cli import bench
from dynaforge.cli.main import main
from dynaforge.tasks import TASK_NAMES, get_task

CAN = get_task("can")


@pytest.fixture
def found(monkeypatch):
    """Let `dynaforge bench` find these figures instead of measuring."""
    figures = {"light": Figure(title="lightness", target="<= 1 kg", measured="0.5 kg", ok=True, raw={"rounds": [0.5]})}
    measurements = {n: lambda task, rounds, n=n: [figures[n]] for n in ("light", "tall")}
    for module in (bench, suite):
        monkeypatch.setattr(module, "MEASUREMENTS", measurements)
    figures["tall"] = replace(figures["light"], title="height", ok=True)
    return figures


def test_bench_ends_with_0_when_every_figure_is_met_and_with_1_when_one_is_missed(found, capsys):
    assert main(["bench"]) == 0
    assert "| lightness | <= 1 kg | 0.5 kg | yes |" in capsys.readouterr().out
    found["tall"] = replace(found["tall"], ok=False)
    assert main(["bench"]) == 1
    out = capsys.readouterr().out
    assert "| height | <= 1 kg | 0.5 kg | NO |" in out
    assert "missed: tall" in out
    assert main(["bench", "--only", "light"]) == 0


def test_what_takes_long_is_measured_only_when_named(found, monkeypatch, capsys):
    for module in (bench, suite):
        monkeypatch.setattr(module, "LONG", {"tall"})
    assert main(["bench"]) == 0
    assert "height" not in capsys.readouterr().out
    assert main(["bench", "--only", "tall"]) == 0
    assert "height" in capsys.readouterr().out


def test_the_record_holds_command_machine_versions_and_rounds(found, tmp_path):
    out = tmp_path / "new" / "bench.json"
    assert main(["bench", "--rounds", "3", "--out", str(out)]) == 0
    record = json.loads(out.read_text())
    assert record["rounds"] == 3
    assert record["machine"]["cores"] >= 1
    assert record["machine"]["cpu"]
    assert {"pybullet", "numpy"} <= set(record["versions"])
    assert record["figures"]["light"][0]["raw"] == {"rounds": [0.5]}
    assert record["command"].startswith("dynaforge")
    assert record["date"].endswith("UTC")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--only", "lihgt"], "Did you mean 'light'?"),
        (["--rounds", "0"], "--rounds is 0"),
        (["--task", "cann"], "Did you mean 'can'?"),
        (["--out", "."], "is a folder"),
    ],
)
def test_a_mistake_is_named_in_one_line_before_anything_is_measured(found, capsys, arguments, words):
    found.clear()
    assert main(["bench", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_record_that_cannot_be_written_is_refused_before_anything_is_measured(found, capsys, tmp_path):
    found.clear()
    (tmp_path / "file").write_text("")
    assert main(["bench", "--out", str(tmp_path / "file" / "bench.json")]) == 2
    assert "file" in capsys.readouterr().err


QUICK = {
    "finger-speed": lambda task: bench_hand.finger_speed(task),
    "hand": lambda task: bench_hand.hand(task, n=2),
    "peak-force": lambda task: bench_forces.peak_force(task, n=2),
    "reflex": lambda task: bench_forces.reflex(task, rounds=1, n=2),
    "speed-limits": lambda task: bench_limits.speed_limits(task, n=2),
    "zero-residual": lambda task: bench_determinism.zero_residual(task, n=2),
    "one-trajectory": lambda task: bench_determinism.one_trajectory(task, n=1, sizes=(2,)),
    "reset": lambda task: bench_speed.scene_reset(task, rounds=1, n=2),
    "control-steps": lambda task: bench_speed.control_rate(task, rounds=1, n=2),
    "control-steps-plain": lambda task: bench_speed.control_rate(task, rounds=1, n=2, plain=True),
    "vectorised": lambda task: bench_vector.vectorised(task, rounds=1, n_envs=2, n_steps=10),
    "prefix": lambda task: bench_prefix.shared_prefix(tasks=(task.name,), n_groups=1, group_size=2),
    "trainer": lambda task: bench_training.trainer(task, rounds=1),
    "collection": lambda task: bench_training.collection(task, rounds=1),
    "writing": lambda task: bench_data.writing(task, rounds=1),
    "window": lambda task: bench_data.window(rounds=1),
    "replay": lambda task: bench_data.replay(task),
    "worker-killed": lambda task: bench_vector.worker_killed(task, rounds=1, n_envs=2),
    "global-plans": lambda task: bench_speed.global_plans(task, n=2),
    "global-planner": lambda task: bench_limits.global_planner(task, n=2),
}
EXACT = (
    "zero-residual",
    "one-trajectory",
    "replay",
    "hand",
    "peak-force",
    "speed-limits",
)  # whatever else runs on this machine


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", TASK_NAMES)
def test_every_row_is_measured_on_every_task(name, monkeypatch):
    assert set(QUICK) == set(suite.MEASUREMENTS) - suite.LONG
    for constant, value in (("ATTEMPTS", 6), ("REPLAYED", 4), ("PACK_EPISODES", 5), ("WINDOWS", 100)):
        monkeypatch.setattr(bench_data, constant, value)
    task = get_task(name)
    for row, measure in QUICK.items():
        for figure in measure(task):
            assert figure.measured
            assert figure.ok or row not in EXACT, figure
            assert figure.raw.get("replays_astray", 0) == 0, figure
