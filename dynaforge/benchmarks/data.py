"""Figures of datasets: what writing costs, how fast training reads, whether replays are exact."""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from dynaforge.benchmarks.figure import Figure, spread, tracked
from dynaforge.demos import Attempt, DemonstrationDataset, Episode
from dynaforge.demos.pack import Pack
from dynaforge.generators import Exploring, Generator, Goal, PlannerOnly, ResidualGenerator, Source, collect
from dynaforge.generators.by_name import make_generator
from dynaforge.generators.generator import ConstantResidual
from dynaforge.sampling.processes import usable_cores
from dynaforge.sim.spec import asset_path
from dynaforge.tasks import Task, task_source

MOST_WRITING = 0.02  # of the time of collecting
MOST_WINDOW = 5e-5  # seconds
ATTEMPTS = 150  # a round of writing
PACKED, LENGTH, POINTS = 200, 60, 1024  # episodes, frames each, points each
WINDOWS = 2000
REPLAYED = 100
DEMONSTRATIONS, MOST_COLLECTING, MOST_RENDERING = 800, 4.0, 15.0  # minutes, the second with the first


class TimedDataset(DemonstrationDataset):
    """Counts the seconds that pass inside `record`.

    Attributes:
        began: When the first attempt arrived; NaN before.
        cpu, wall: Seconds of CPU, and of waiting for the disk too.
    """

    began, cpu, wall = float("nan"), 0.0, 0.0

    def record(self, attempt: Attempt, episode: Episode | None = None) -> Attempt:
        """Record it and note the time."""
        start, cpu = time.perf_counter(), time.thread_time()
        noted = super().record(attempt, episode)
        self.cpu, self.wall = self.cpu + time.thread_time() - cpu, self.wall + time.perf_counter() - start
        if math.isnan(self.began):
            self.began = start
        return noted


def writing(task: Task, *, rounds: int) -> list[Figure]:
    """Collect as `dynaforge collect` does: the share of all cores that writing takes."""
    generator = make_generator(_generator_of(task), task)
    shares, busy, cores = [], [], usable_cores()
    for number in tracked(range(rounds), "writing"):
        with tempfile.TemporaryDirectory() as folder:
            dataset = TimedDataset(folder, task=task.name)
            collect(dataset, task, generator, Goal(None, ATTEMPTS), source=Source(number))
            wall = time.perf_counter() - dataset.began
        shares.append(dataset.cpu / (cores * wall))
        busy.append(dataset.wall / wall)
    return [
        Figure(
            f"writing while collecting, CPU share of {cores} cores", f"<= {MOST_WRITING:g}",
            f"{spread(shares, digits=4)}; the writer, waits for the disk included, is busy {spread(busy, digits=3)}",
            float(np.median(shares)) <= MOST_WRITING, {"shares": shares, "busy": busy},
        )
    ]  # fmt: skip


def window(*, rounds: int) -> list[Figure]:
    """Read two frames of points, two of state and sixteen actions, as DP3 does, at random places of a pack."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "pack"
        folder.mkdir()
        n = PACKED * LENGTH
        np.save(folder / "points.npy", rng.normal(size=(n, POINTS, 3)).astype(np.float16))
        np.save(folder / "state.npy", np.zeros((n, 15), np.float32))
        np.save(folder / "action.npy", np.zeros((n, 8), np.float32))
        np.save(folder / "episode_ends.npy", np.arange(1, PACKED + 1) * LENGTH)
        (folder / "pack.json").write_text('{"arrays": ["points", "state", "action"], "action_names": []}')
        pack, times = Pack(folder), []
        for _ in tracked(range(rounds), "window"):
            frames = rng.integers(n, size=WINDOWS).tolist()
            start = time.perf_counter()
            for frame in frames:
                pack.window("points", frame, before=1, after=0).copy()
                pack.window("state", frame, before=1, after=0).copy()
                pack.window("action", frame, before=1, after=14).copy()
            times.append((time.perf_counter() - start) / WINDOWS)
    return [
        Figure(
            f"random window of a pack ({POINTS} points)", f"<= {1e3 * MOST_WINDOW:g} ms",
            f"{spread([1e3 * t for t in times], digits=4)} ms", float(np.median(times)) <= MOST_WINDOW,
            {"times": times},
        )
    ]  # fmt: skip


def replay(task: Task) -> list[Figure]:
    """Record episodes by planner and noise, simulate them again in a fresh process: every bit must agree."""
    with tempfile.TemporaryDirectory() as folder:
        dataset = DemonstrationDataset(folder, task=task.name, keep_failures=True)
        action = np.zeros(np.count_nonzero(task.residual.scales), np.float32)
        noisy = ResidualGenerator(Exploring(ConstantResidual(action), 0.5), name="noise")
        generators: tuple[Generator, ...] = (PlannerOnly(), noisy)
        for generator in generators:
            collect(dataset, task, generator, Goal(None, REPLAYED // 2))
        n = len(dataset)
        done = subprocess.run(
            [sys.executable, "-m", "dynaforge", "verify", folder, "--replay"],
            capture_output=True,
            text=True,
            check=False,
        )
    exact = done.returncode == 0
    said = done.stdout.strip().splitlines()[-1] if done.stdout.strip() else done.stderr.strip()[-200:]
    return [Figure(f"replay of {n} episodes in a fresh process", "all bits agree", said, exact, {"said": said})]


def demonstrations(task: Task) -> list[Figure]:
    """Collect successes on all cores, then render point clouds: minutes of each command."""
    with tempfile.TemporaryDirectory() as parent:
        folder = f"{parent}/data"
        start = time.perf_counter()
        what = ("--task", task_source(task), "--generator", _generator_of(task))
        collected = _dynaforge("collect", *what, "--demos", str(DEMONSTRATIONS), "--out", folder)
        collecting = (time.perf_counter() - start) / 60
        rendered = _dynaforge("render", folder, "--cameras", "front", "--points", str(POINTS), "--no-images")
        both = (time.perf_counter() - start) / 60
        attempts = DemonstrationDataset(folder).attempts()
    n = sum(attempt.success for attempt in attempts)
    data = {"successes": n, "attempts": len(attempts), "collecting": collecting, "both": both}
    return [
        Figure(
            f"{DEMONSTRATIONS} demonstrations, all cores", f"<= {MOST_COLLECTING:g} minutes",
            f"{collecting:.1f} minutes, {n} successes in {len(attempts)} attempts",
            collected and collecting <= MOST_COLLECTING and n >= DEMONSTRATIONS, data,
        ),
        Figure(
            f"with {POINTS}-point clouds of one camera", f"<= {MOST_RENDERING:g} minutes", f"{both:.1f} minutes",
            rendered and both <= MOST_RENDERING, data,
        ),
    ]  # fmt: skip


def _generator_of(task: Task) -> str:
    """Name what collects: the planner with the shipped policy, or alone where none is shipped."""
    try:
        asset_path(f"{task.name}/policy.safetensors")
    except FileNotFoundError:
        return "planner_only"
    return "residual"


def _dynaforge(*arguments: str) -> bool:
    """Run a command with its progress shown; tell whether it ended well."""
    return subprocess.run([sys.executable, "-m", "dynaforge", *arguments], check=False).returncode == 0
