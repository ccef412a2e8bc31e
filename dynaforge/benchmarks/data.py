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
from dynaforge.generators import (
    ConditionSource,
    ExploringPolicy,
    Generator,
    Goal,
    PlannerOnly,
    ResidualGenerator,
    collect,
)
from dynaforge.generators.by_name import make_generator, policy_for
from dynaforge.generators.generator import ConstantResidual
from dynaforge.sampling.processes import usable_cores
from dynaforge.tasks import Task, task_source

MAX_WRITING_SHARE = 0.02  # of the CPU time of collecting
MAX_WINDOW_SECONDS = 5e-5
ATTEMPTS = 150  # in each round of writing
PACK_EPISODES, EPISODE_FRAMES, POINTS = 200, 60, 1024
WINDOWS = 2000  # in each round of reading
REPLAYED = 100  # episodes
DEMONSTRATIONS = 800
MAX_COLLECTING_MINUTES, MAX_RENDERING_MINUTES = 4.0, 15.0  # the second includes the first


class TimedDataset(DemonstrationDataset):
    """A dataset that counts the seconds that pass inside `record`.

    Attributes:
        began: When the first attempt arrived, by `time.perf_counter`; NaN before.
        cpu: CPU seconds.
        wall: Seconds by the clock, waiting for the disk included.
    """

    began, cpu, wall = float("nan"), 0.0, 0.0

    def record(self, attempt: Attempt, episode: Episode | None = None) -> Attempt:
        """Record an attempt and add the time that it took."""
        wall, cpu = time.perf_counter(), time.thread_time()
        if math.isnan(self.began):
            self.began = wall
        recorded = super().record(attempt, episode)
        self.cpu += time.thread_time() - cpu
        self.wall += time.perf_counter() - wall
        return recorded


def writing(task: Task, *, rounds: int) -> list[Figure]:
    """Measure the share of all cores that writing takes while collecting as `dynaforge collect` does."""
    generator = make_generator(_generator_of(task), task)
    shares, busy, cores = [], [], usable_cores()
    for number in tracked(range(rounds), "writing"):
        with tempfile.TemporaryDirectory() as folder:
            dataset = TimedDataset(folder, task=task.name)
            collect(dataset, task, generator, Goal(None, ATTEMPTS), source=ConditionSource(number))
            wall = time.perf_counter() - dataset.began
        shares.append(dataset.cpu / (cores * wall))
        busy.append(dataset.wall / wall)
    return [
        Figure(
            title=f"writing while collecting, CPU share of {cores} cores",
            target=f"<= {MAX_WRITING_SHARE:g}",
            measured=f"{spread(shares, digits=4)}; "
            f"the writer, waits for the disk included, is busy {spread(busy, digits=3)}",
            ok=float(np.median(shares)) <= MAX_WRITING_SHARE,
            raw={"shares": shares, "busy": busy},
        )
    ]


def window(*, rounds: int) -> list[Figure]:
    """Time reading two frames of points, two of state and sixteen actions, as DP3 does, at random places of a pack."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "pack"
        folder.mkdir()
        n = PACK_EPISODES * EPISODE_FRAMES
        np.save(folder / "points.npy", rng.normal(size=(n, POINTS, 3)).astype(np.float16))
        np.save(folder / "state.npy", np.zeros((n, 15), np.float32))
        np.save(folder / "action.npy", np.zeros((n, 8), np.float32))
        np.save(folder / "episode_ends.npy", np.arange(1, PACK_EPISODES + 1) * EPISODE_FRAMES)
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
            title=f"random window of a pack ({POINTS} points)",
            target=f"<= {1e3 * MAX_WINDOW_SECONDS:g} ms",
            measured=f"{spread([1e3 * t for t in times], digits=4)} ms",
            ok=float(np.median(times)) <= MAX_WINDOW_SECONDS,
            raw={"times": times},
        )
    ]


def replay(task: Task) -> list[Figure]:
    """Record episodes of the planner and of noise, and simulate them again in a fresh process: every bit must agree."""
    with tempfile.TemporaryDirectory() as folder:
        dataset = DemonstrationDataset(folder, task=task.name, keep_failures=True)
        action = np.zeros(np.count_nonzero(task.residual.scales), np.float32)
        noisy = ResidualGenerator(ExploringPolicy(ConstantResidual(action), 0.5), name="noise")
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
    printed = done.stdout.strip()
    message = printed.splitlines()[-1] if printed else done.stderr.strip()[-200:]
    return [
        Figure(
            title=f"replay of {n} episodes in a fresh process",
            target="all bits agree",
            measured=message,
            ok=done.returncode == 0,
            raw={"said": message},
        )
    ]


def demonstrations(task: Task) -> list[Figure]:
    """Time collecting demonstrations on all cores, and then rendering their point clouds."""
    with tempfile.TemporaryDirectory() as parent:
        folder = f"{parent}/data"
        start = time.perf_counter()
        chosen = ("--task", task_source(task), "--generator", _generator_of(task))
        collected = _dynaforge("collect", *chosen, "--demos", str(DEMONSTRATIONS), "--out", folder)
        collecting = (time.perf_counter() - start) / 60
        rendered = _dynaforge("render", folder, "--cameras", "front", "--points", str(POINTS), "--no-images")
        both = (time.perf_counter() - start) / 60
        attempts = DemonstrationDataset(folder).attempts()
    n = sum(attempt.success for attempt in attempts)
    data = {"successes": n, "attempts": len(attempts), "collecting": collecting, "both": both}
    return [
        Figure(
            title=f"{DEMONSTRATIONS} demonstrations, all cores",
            target=f"<= {MAX_COLLECTING_MINUTES:g} minutes",
            measured=f"{collecting:.1f} minutes, {n} successes in {len(attempts)} attempts",
            ok=collected and collecting <= MAX_COLLECTING_MINUTES and n >= DEMONSTRATIONS,
            raw=data,
        ),
        Figure(
            title=f"with {POINTS}-point clouds of one camera",
            target=f"<= {MAX_RENDERING_MINUTES:g} minutes",
            measured=f"{both:.1f} minutes",
            ok=rendered and both <= MAX_RENDERING_MINUTES,
            raw=data,
        ),
    ]


def _generator_of(task: Task) -> str:
    """Return the generator to collect with: the shipped policy, or planner only where none is shipped that fits."""
    try:
        policy_for(task)
    except ValueError:
        return "planner_only"
    return "residual"


def _dynaforge(*arguments: str) -> bool:
    """Run a command with its progress shown; return whether it exited with status 0."""
    return subprocess.run([sys.executable, "-m", "dynaforge", *arguments], check=False).returncode == 0
