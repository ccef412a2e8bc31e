"""What stored training runs say about the algorithms that made them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

import numpy as np
from numpy.typing import NDArray

from dynaforge.evaluation.few_seeds import few_seeds_interval
from dynaforge.evaluation.frontier import FrontierAnalysis, analyse_frontier
from dynaforge.evaluation.statistics import BootstrapDifference, Interval, bootstrap_over_tasks
from dynaforge.geometry import Array
from dynaforge.training.history import TrainingHistory
from dynaforge.training.run_spec import PLANNER_ONLY
from dynaforge.training.stored_run import StoredRun

FINAL_PROBES = 5  # the mean of a run's last probes is its final success without exploration
VANILLA = "grpo"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VariantSummary:
    """A variant on a task, over its training seeds; figures of training are means over the seeds.

    Attributes:
        rates: DGR of each training seed.
        final_probes: Success without exploration on `val`, mean of the last five probes; NaN without probes.
        optimizer_steps: Optimizer steps of a run.
        transitions_used: Gated transitions of the kept groups of a run.
        collect_cpu, optimize_cpu, collect_wall, optimize_wall: Seconds of a run, on the one core it has.
        groups: Shares of groups that all failed, were mixed, all succeeded; empty without groups.
        steps_to_vanilla: Environment steps needed to reach vanilla GRPO's final success in training (trailing means
            over the seeds); infinite where it was not reached.
        probe_steps_to_vanilla: The same without exploration: environment steps until the mean of three probes reached
            the mean of vanilla's last five; NaN without probes.
        forgotten: Share of strata that succeeded in two probes in a row and failed in the last two.
    """

    rates: tuple[float, ...]
    final_probes: float
    optimizer_steps: float
    transitions_used: float
    collect_cpu: float
    optimize_cpu: float
    collect_wall: float
    optimize_wall: float
    groups: tuple[float, ...]
    steps_to_vanilla: float
    probe_steps_to_vanilla: float
    forgotten: float


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Finished runs of several variants on several tasks.

    Attributes:
        runs: In the order in which they are shown.
    """

    runs: tuple[StoredRun, ...]

    @staticmethod
    def load(root: Path, folders: Iterable[Path]) -> Comparison:
        """Read finished runs.

        Args:
            root: Folder of the comparison, named in messages.
            folders: Folders of the runs.

        Raises:
            ValueError: A damaged folder, or runs of a task that were measured on different conditions.
        """
        comparison = Comparison(tuple(StoredRun.load(folder) for folder in folders))
        for task in comparison.tasks:
            if len({run.conditions for run in comparison.runs if run.task == task}) > 1:
                mixed = f": {comparison.settings}" if task in comparison.mixed_tasks else ""
                raise ValueError(f"The runs of {task!r} in {root} were measured on different conditions{mixed}.")
        return comparison

    @property
    def tasks(self) -> list[str]:
        """Task names, in order."""
        return list(dict.fromkeys(run.task for run in self.runs))

    @property
    def mixed_tasks(self) -> list[str]:
        """Tasks whose runs are not all of one definition, in order: their figures do not compare."""
        definitions = {(run.task, run.definition) for run in self.runs}
        tasks = [task for task, _ in definitions]
        return [task for task in self.tasks if tasks.count(task) > 1]

    @property
    def settings(self) -> str:
        """In which setting the runs were made, in words; by task where there are several, by run where one is mixed."""
        made_under: dict[str, list[str]] = {}
        for run in self.runs:
            name = f"{run.task}/{run.variant}" if run.task in self.mixed_tasks else run.task
            made_under.setdefault(run.setting, []).append(name)
        if len(made_under) == 1:
            return next(iter(made_under))
        return "; ".join(f"{setting} ({', '.join(dict.fromkeys(names))})" for setting, names in made_under.items())

    @property
    def variants(self) -> list[str]:
        """Names of the trained variants, in order."""
        return list(dict.fromkeys(run.variant for run in self.runs if run.variant != PLANNER_ONLY))

    @property
    def reference(self) -> str:
        """What variants are compared with: vanilla GRPO, else the first variant."""
        return VANILLA if VANILLA in self.variants else (self.variants or [PLANNER_ONLY])[0]

    def of(self, task: str, variant: str) -> list[StoredRun]:
        """Return the finished training seeds of a variant on a task."""
        return [run for run in self.runs if run.task == task and run.variant == variant]

    def outcomes(self, task: str, variant: str) -> NDArray[np.bool_]:
        """Return the success of each training seed on each condition, shape (S, C)."""
        return np.array([run.success for run in self.of(task, variant)])

    def planner(self, task: str) -> float:
        """Return the DGR of the planner only; NaN where it was not measured."""
        return next((run.rate for run in self.of(task, PLANNER_ONLY)), math.nan)

    def complete_tasks(self, variant: str) -> list[str]:
        """Return the tasks on which both this variant and the reference finished a run."""
        return [task for task in self.tasks if self.of(task, variant) and self.of(task, self.reference)]

    def difference(self, variant: str, tasks: Sequence[str]) -> BootstrapDifference:
        """Compare a variant's mean DGR over tasks with the reference's; bootstrap over seeds and conditions."""
        return bootstrap_over_tasks(self._pairs(variant, tasks), rng=np.random.default_rng(0))

    def few_seeds_interval(self, variant: str, tasks: Sequence[str]) -> Interval:
        """Return the interval of the same difference by Student's t, which is right with few seeds too."""
        return few_seeds_interval(self._pairs(variant, tasks))

    def curve(self, task: str, variant: str) -> Array:
        """Return success in training at each update, mean over seeds, shape (U,); as long as the shortest run."""
        curves = [history.success for history in self._histories(task, variant)]
        shortest = min(map(len, curves))
        return np.asarray(np.mean([curve[:shortest] for curve in curves], axis=0))

    def steps(self, task: str, variant: str) -> Array:
        """Return the environment steps at the updates of `curve`, mean over seeds, shape (U,)."""
        steps = [history.timesteps for history in self._histories(task, variant)]
        shortest = min(map(len, steps))
        return np.asarray(np.mean([row[:shortest] for row in steps], axis=0))

    def frontier(self, task: str, variant: str) -> FrontierAnalysis:
        """Analyse the frontier of a variant, with the outcomes of all its seeds pooled update by update."""
        histories = self._histories(task, variant)
        shortest = min(map(len, histories))
        successes, trials = (
            np.sum([getattr(history, name)[:shortest] for history in histories], axis=0)
            for name in ("successes", "trials")
        )
        return analyse_frontier(successes, trials)

    def probes(self, task: str, variant: str) -> tuple[Array, Array]:
        """Return environment steps and success of the probes, means over seeds, shape (P,) each."""
        rows = [history.probes for history in self._histories(task, variant)]
        shortest = min(map(len, rows))
        steps = np.mean([[probe.timesteps for probe in row[:shortest]] for row in rows], axis=0)
        return steps, np.mean([[np.mean(probe.success) for probe in row[:shortest]] for row in rows], axis=0)

    def summary(self, task: str, variant: str) -> VariantSummary:
        """Summarise a variant's runs on a task."""
        histories = self._histories(task, variant)
        groups = np.array([np.sum(history.groups, axis=0) for history in histories if history.groups])
        probes = [_probes(history) for history in histories]
        return VariantSummary(
            rates=tuple(run.rate for run in self.of(task, variant)),
            final_probes=mean(float(p[-FINAL_PROBES:].mean()) if len(p) else math.nan for p in probes),
            optimizer_steps=mean(h.optimizer_steps[-1] for h in histories),
            transitions_used=mean(h.transitions_used[-1] for h in histories),
            collect_cpu=mean(sum(h.collect_cpu) for h in histories),
            optimize_cpu=mean(sum(h.optimize_cpu) for h in histories),
            collect_wall=mean(sum(h.collect_wall) for h in histories),
            optimize_wall=mean(sum(h.optimize_wall) for h in histories),
            groups=tuple((groups.sum(axis=0) / groups.sum()).tolist()) if len(groups) else (),
            steps_to_vanilla=self._steps_to_vanilla(task, variant),
            probe_steps_to_vanilla=self._probe_steps_to_vanilla(task, variant),
            forgotten=mean(_forgotten(p) for p in probes),
        )

    def _steps_to_vanilla(self, task: str, variant: str) -> float:
        if not self.of(task, self.reference):
            return math.nan
        level = self.frontier(task, self.reference).overall_trailing[-1]
        reached = np.flatnonzero(self.frontier(task, variant).overall_trailing >= level)
        return float(self.steps(task, variant)[reached[0]]) if len(reached) else math.inf

    def _probe_steps_to_vanilla(self, task: str, variant: str) -> float:
        if not self.of(task, self.reference):
            return math.nan
        vanilla = self.probes(task, self.reference)[1][-FINAL_PROBES:]
        steps, success = self.probes(task, variant)
        if not len(vanilla) or len(success) < 3:
            return math.nan
        reached = np.flatnonzero(np.convolve(success, np.ones(3) / 3, "valid") >= vanilla.mean() - 1e-9)
        return float(steps[reached[0] + 2]) if len(reached) else math.inf

    def _pairs(self, variant: str, tasks: Sequence[str]) -> list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
        return [(self.outcomes(task, self.reference), self.outcomes(task, variant)) for task in tasks]

    def _histories(self, task: str, variant: str) -> list[TrainingHistory]:
        return [run.history for run in self.of(task, variant) if run.history is not None]


def _probes(history: TrainingHistory) -> NDArray[np.bool_]:
    return np.array([probe.success for probe in history.probes], dtype=bool)


def _forgotten(probes: NDArray[np.bool_]) -> float:
    """Return the share of strata that succeeded in two probes in a row and failed in the last two."""
    if len(probes) < 4:
        return 0.0
    solved_once = (probes[:-1] & probes[1:])[:-2].any(axis=0)
    return float((solved_once & ~probes[-1] & ~probes[-2]).mean())
