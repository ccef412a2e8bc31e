"""What stored training runs say about the algorithms that made them."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, stdev
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from dynaforge.evaluation.frontier import FrontierAnalysis, analyse_frontier
from dynaforge.evaluation.statistics import BootstrapDifference, bootstrap_over_tasks
from dynaforge.geometry import Array, one_line
from dynaforge.training.history import TrainingHistory

PLANNER = "planner_only"
COLUMNS = (
    "seeds", "DGR %", "std", "val %", "opt. steps", "against", "95 %", "opt. ratio", "steps to", "greedy", "used",
    "sim", "opt.", "wall sim", "wall opt.",
)  # fmt: skip
LATE = 5  # probes at the end of a run, whose mean says where it ends
VANILLA = "grpo"


@dataclass(frozen=True, slots=True, eq=False)
class StoredRun:
    """A finished run.

    Attributes:
        task, arm, seed: Which run; arm "planner_only" was not trained.
        settings: Hyperparameters it was trained with.
        history: Of its training; None for the planner.
        success: Of the final policy on the exam's conditions, shape (C,).
        conditions: Their ids.
        failures: Reasons of the failures.
        exam: Stream, blocks and attempts.
    """

    task: str
    arm: str
    seed: int
    settings: dict[str, Any]
    history: TrainingHistory | None
    success: NDArray[np.bool_]
    conditions: tuple[str, ...]
    failures: tuple[str, ...]
    exam: dict[str, Any]

    __repr__ = one_line

    @staticmethod
    def load(folder: Path) -> StoredRun:
        """Read a run's folder.

        Raises:
            ValueError: A file in it is damaged.
        """
        try:
            exam = json.loads((folder / "exam.json").read_text())
            about = json.loads((folder / "run.json").read_text()) if (folder / "run.json").is_file() else None
            outcomes = [attempt["outcome"] for attempt in exam["attempts"]]
            return StoredRun(
                task=exam["task"],
                arm=about["run"]["arm"] if about else PLANNER,
                seed=about["run"]["seed"] if about else 0,
                settings=about["settings"] if about else {},
                history=TrainingHistory.load(folder / "history.json") if about else None,
                success=np.array([outcome == "success" for outcome in outcomes]),
                conditions=tuple(attempt["id"] for attempt in exam["attempts"]),
                failures=tuple(outcome for outcome in outcomes if outcome != "success"),
                exam=exam["exam"],
            )
        except (json.JSONDecodeError, UnicodeError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise ValueError(f"{folder} holds no readable run: {type(error).__name__}: {error}.") from error

    @property
    def rate(self) -> float:
        """Demonstration generation rate."""
        return float(self.success.mean())


@dataclass(frozen=True, slots=True, eq=False)
class ArmSummary:
    """An arm on a task, over its training seeds; figures of training are means over the seeds.

    Attributes:
        rates: DGR of each training seed.
        late: Success without exploration on `val`, mean of the last five probes; NaN without probes.
        optimizer_steps: Made in a run.
        transitions_used: Gated transitions of the kept groups of a run.
        collect_cpu, optimize_cpu, collect_wall, optimize_wall: Seconds of a run, on the one core it has.
        groups: Shares of groups that failed throughout, were mixed, succeeded throughout; empty without groups.
        steps_to_vanilla: Environment steps until the trailing success in training, mean over seeds, first was what
            vanilla GRPO's is at its end; infinite where it never was.
        greedy_steps_to_vanilla: The same without exploration: until the mean of three probes was that of vanilla's
            last five; NaN without probes.
        lost_again: Share of strata won without exploration in two probes running and lost in the last two.
    """

    rates: tuple[float, ...]
    late: float
    optimizer_steps: float
    transitions_used: float
    collect_cpu: float
    optimize_cpu: float
    collect_wall: float
    optimize_wall: float
    groups: tuple[float, ...]
    steps_to_vanilla: float
    greedy_steps_to_vanilla: float
    lost_again: float


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Finished runs of several arms on several tasks.

    Attributes:
        runs: In the order in which they are shown.
    """

    runs: tuple[StoredRun, ...]

    @staticmethod
    def load(root: Path, folders: Iterable[Path]) -> Comparison:
        """Read run folders.

        Raises:
            ValueError: A damaged folder, or runs of a task that were measured on different conditions.
        """
        runs = tuple(StoredRun.load(folder) for folder in folders)
        for task in {run.task for run in runs}:
            if len({run.conditions for run in runs if run.task == task}) > 1:
                raise ValueError(f"The runs of {task!r} in {root} were measured on different conditions.")
        return Comparison(runs)

    @property
    def tasks(self) -> list[str]:
        """Task names, in order."""
        return list(dict.fromkeys(run.task for run in self.runs))

    @property
    def arms(self) -> list[str]:
        """Names of the trained arms, in order."""
        return list(dict.fromkeys(run.arm for run in self.runs if run.arm != PLANNER))

    @property
    def reference(self) -> str:
        """What arms are compared with: vanilla GRPO, else the first arm."""
        return VANILLA if VANILLA in self.arms else (self.arms or [PLANNER])[0]

    def of(self, task: str, arm: str) -> list[StoredRun]:
        """Return the finished training seeds of an arm on a task."""
        return [run for run in self.runs if run.task == task and run.arm == arm]

    def outcomes(self, task: str, arm: str) -> NDArray[np.bool_]:
        """Return the success of each training seed on each condition, shape (S, C)."""
        return np.array([run.success for run in self.of(task, arm)])

    def planner(self, task: str) -> float:
        """DGR of the planner alone; NaN where it was not measured."""
        return next((run.rate for run in self.of(task, PLANNER)), math.nan)

    def complete_tasks(self, arm: str) -> list[str]:
        """Return the tasks on which both this arm and the reference finished a run."""
        return [task for task in self.tasks if self.of(task, arm) and self.of(task, self.reference)]

    def difference(self, arm: str, tasks: Sequence[str]) -> BootstrapDifference:
        """Compare an arm's DGR with the reference's, mean over tasks; bootstrap over training seeds and conditions."""
        pairs = [(self.outcomes(task, self.reference), self.outcomes(task, arm)) for task in tasks]
        return bootstrap_over_tasks(pairs, rng=np.random.default_rng(0))

    def curve(self, task: str, arm: str) -> Array:
        """Success in training at each update, mean over seeds, shape (U,); as long as the shortest run."""
        curves = [history.success for history in self._histories(task, arm)]
        shortest = min(map(len, curves))
        return np.asarray(np.mean([curve[:shortest] for curve in curves], axis=0))

    def steps(self, task: str, arm: str) -> Array:
        """Environment steps at the updates of `curve`, mean over seeds, shape (U,)."""
        steps = [history.timesteps for history in self._histories(task, arm)]
        shortest = min(map(len, steps))
        return np.asarray(np.mean([row[:shortest] for row in steps], axis=0))

    def frontier(self, task: str, arm: str) -> FrontierAnalysis:
        """Analyse the frontier of an arm, outcomes of all its seeds pooled update by update."""
        histories = self._histories(task, arm)
        shortest = min(map(len, histories))
        successes, trials = (
            np.sum([getattr(history, name)[:shortest] for history in histories], axis=0)
            for name in ("successes", "trials")
        )
        return analyse_frontier(successes, trials)

    def probes(self, task: str, arm: str) -> tuple[Array, Array]:
        """Environment steps and success without exploration of the probes, means over seeds, shape (P,) each."""
        rows = [history.probes for history in self._histories(task, arm)]
        shortest = min(map(len, rows))
        steps = np.mean([[probe.timesteps for probe in row[:shortest]] for row in rows], axis=0)
        return steps, np.mean([[np.mean(probe.success) for probe in row[:shortest]] for row in rows], axis=0)

    def summary(self, task: str, arm: str) -> ArmSummary:
        """Put an arm's runs on a task in figures."""
        histories = self._histories(task, arm)
        groups = np.array([np.sum(history.groups, axis=0) for history in histories if history.groups])
        probes = [_probes(history) for history in histories]
        return ArmSummary(
            rates=tuple(run.rate for run in self.of(task, arm)),
            late=mean(float(p[-LATE:].mean()) if len(p) else math.nan for p in probes),
            optimizer_steps=mean(h.optimizer_steps[-1] for h in histories),
            transitions_used=mean(h.transitions_used[-1] for h in histories),
            collect_cpu=mean(sum(h.collect_cpu) for h in histories),
            optimize_cpu=mean(sum(h.optimize_cpu) for h in histories),
            collect_wall=mean(sum(h.collect_wall) for h in histories),
            optimize_wall=mean(sum(h.optimize_wall) for h in histories),
            groups=tuple((groups.sum(axis=0) / groups.sum()).tolist()) if len(groups) else (),
            steps_to_vanilla=self._steps_to_vanilla(task, arm),
            greedy_steps_to_vanilla=self._greedy_steps_to_vanilla(task, arm),
            lost_again=mean(_lost_again(p) for p in probes),
        )

    def _steps_to_vanilla(self, task: str, arm: str) -> float:
        if not self.of(task, self.reference):
            return math.nan
        level = self.frontier(task, self.reference).overall_trailing[-1]
        reached = np.flatnonzero(self.frontier(task, arm).overall_trailing >= level)
        return float(self.steps(task, arm)[reached[0]]) if len(reached) else math.inf

    def _greedy_steps_to_vanilla(self, task: str, arm: str) -> float:
        if not self.of(task, self.reference):
            return math.nan
        level, (steps, success) = self.probes(task, self.reference)[1][-LATE:], self.probes(task, arm)
        if not len(level) or len(success) < 3:
            return math.nan
        reached = np.flatnonzero(np.convolve(success, np.ones(3) / 3, "valid") >= level.mean() - 1e-9)
        return float(steps[reached[0] + 2]) if len(reached) else math.inf

    def table(self) -> str:
        """Return all of it as plain text: a row an arm and task, then the means over the tasks."""
        grid = Table()
        for name in ("task", "arm", *COLUMNS):
            grid.add_column(name, justify="left" if name in ("task", "arm") else "right")
        for task in self.tasks:
            if not math.isnan(self.planner(task)):
                grid.add_row(task, "planner only", "", f"{100 * self.planner(task):.1f}")
            for arm in self.arms:
                if self.of(task, arm):
                    grid.add_row(task, arm, *self.cells(arm, [task]))
            grid.add_section()
        for arm in self.arms:
            shared = self.complete_tasks(arm)
            if len(shared) > 1:
                grid.add_row(f"mean of {len(shared)}", arm, *self.cells(arm, shared))
        console = Console(file=io.StringIO(), width=200, color_system=None, force_terminal=False)
        with console.capture() as capture:
            console.print(grid)
        rows = "\n".join(line.rstrip() for line in capture.get().rstrip().splitlines())
        return f"{rows}\n{self.legend()}"

    def legend(self) -> str:
        """Say what the columns of the table mean."""
        exam = self.runs[0].exam
        return (
            f"DGR of the final policy without exploration on {exam['blocks']} x {exam['attempts']} conditions of "
            f"{exam['stream']}, mean and std over training seeds; mean of the last {LATE} probes\non val, without "
            f"exploration; optimizer steps of a run; against {self.reference} in points, 95 % bootstrap over training "
            f"seeds and conditions;\noptimizer steps and environment steps to {self.reference}'s final success in "
            "training, and in probes, as ratios to it ('-': not reached);\nof a run: thousands of transitions in kept "
            "groups, minutes of simulation and of optimisation, CPU and wall, on one core."
        )

    def cells(self, arm: str, tasks: Sequence[str]) -> list[str]:
        """Return the figures of an arm over tasks as text, in the order of `COLUMNS`."""
        mine = [self.summary(task, arm) for task in tasks]
        seeds = min(len(s.rates) for s in mine)
        rate = mean(mean(s.rates) for s in mine)
        over_seeds = [mean(s.rates[k] for s in mine) for k in range(seeds)]
        cells = [str(seeds), f"{100 * rate:.1f}", f"{100 * stdev(over_seeds):.1f}" if seeds > 1 else "-"]
        late = mean(s.late for s in mine)
        cells += ["-" if math.isnan(late) else f"{100 * late:.1f}", f"{mean(s.optimizer_steps for s in mine):.0f}"]
        if arm == self.reference or not all(self.of(task, self.reference) for task in tasks):
            compared = ["-"] * 5
        else:
            theirs = [self.summary(task, self.reference) for task in tasks]
            found = self.difference(arm, tasks)
            low, high = found.interval
            ratios = (
                mean(getattr(a, name) / getattr(b, name) for a, b in zip(mine, theirs, strict=True))
                for name in ("optimizer_steps", "steps_to_vanilla", "greedy_steps_to_vanilla")
            )
            compared = [
                f"{100 * found.difference:+.1f}", f"{100 * low:+.1f} to {100 * high:+.1f}",
                *(f"{ratio:.2f} x" if math.isfinite(ratio) else "-" for ratio in ratios),
            ]  # fmt: skip
        costs = [f"{mean(s.transitions_used for s in mine) / 1000:.1f}"]
        for name in ("collect_cpu", "optimize_cpu", "collect_wall", "optimize_wall"):
            minutes = mean(getattr(s, name) for s in mine) / 60
            costs.append(f"{minutes:.2f}" if name.startswith("optimize") else f"{minutes:.1f}")
        return [*cells, *compared, *costs]

    def _histories(self, task: str, arm: str) -> list[TrainingHistory]:
        return [run.history for run in self.of(task, arm) if run.history is not None]


def _probes(history: TrainingHistory) -> NDArray[np.bool_]:
    return np.array([probe.success for probe in history.probes], dtype=bool)


def _lost_again(probes: NDArray[np.bool_]) -> float:
    """Return the share of strata that were won in two probes running and are lost in the last two."""
    if len(probes) < 4:
        return 0.0
    won_once = (probes[:-1] & probes[1:])[:-2].any(axis=0)
    return float((won_once & ~probes[-1] & ~probes[-2]).mean())
