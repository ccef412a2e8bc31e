"""What watches a training run: the history that it leaves, and the limit of its time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from tqdm import tqdm

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.residual_sac import ResidualSAC
from dynaforge.geometry import Array
from dynaforge.tasks import ConditionSpace, Outcome
from dynaforge.training.checkpoint import optimizers_of
from dynaforge.training.history import STRATA, TrainingHistory
from dynaforge.training.sparkline import sparkline

UPDATE_OF_SAC = 2000
"""Environment steps that count as one update of SAC, which has none: about as many as the others take for theirs."""


class TrainingMonitor(BaseCallback):
    """Keeps the history of a run.

    An update is a rollout and the optimisation after it. SAC takes turns at every step: `UPDATE_OF_SAC` of them are
    one update.

    Args:
        history: Filled during training; that of a resumed run contains what came before.
        conditions: Those of the task; episodes are counted in equal strata of their difficulty.
        between_updates: Called before every update and at the end with the number of updates made so far; returns
            whether training continues.
    """

    def __init__(
        self,
        history: TrainingHistory,
        conditions: ConditionSpace,
        between_updates: Callable[[int], bool] = lambda updates: True,
    ) -> None:
        super().__init__()
        self.history = history
        self._conditions = conditions
        self._between_updates = between_updates
        self._optimizer_steps = history.optimizer_steps[-1] if history.optimizer_steps else 0
        self._collected = self._under_way = False
        self._continues = True

    def _on_training_start(self) -> None:
        self._collected = self._under_way = False
        self._steps = UPDATE_OF_SAC if isinstance(self.model, ResidualSAC) else 1

        def count(*_: Any) -> None:
            self._optimizer_steps += 1

        counted = next(iter(optimizers_of(self.model).values()))
        self._hook = counted.register_step_post_hook(count)

    def _on_rollout_start(self) -> None:
        self._close_update()
        if self._under_way:
            return
        self._successes, self._trials = np.zeros(STRATA, int), np.zeros(STRATA, int)
        self._collecting, self._optimising = np.zeros(2), np.zeros(2)
        self._begun, self._under_way = self.num_timesteps, True
        self._continues = self._between_updates(len(self.history))
        self._clock = self._now()

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        for row in np.flatnonzero(self.locals["dones"]).tolist():
            info = infos[row]
            stratum = self._conditions.stratum(info["difficulty"], STRATA)
            self._trials[stratum] += 1
            outcome = Outcome.of_info(info)
            self._successes[stratum] += outcome is not None and outcome.success
        return self._continues

    def _on_rollout_end(self) -> None:
        self._collecting += self._lap()
        if self.num_timesteps - self._begun >= self._steps:
            self._note_collection()

    def _note_collection(self) -> None:
        """Add to the history what was collected in this update."""
        history, model = self.history, self.model
        wall, cpu = self._collecting.round(4).tolist()
        history.successes.append(self._successes.tolist())
        history.trials.append(self._trials.tolist())
        history.collect_wall.append(wall)
        history.collect_cpu.append(cpu)
        history.timesteps.append(self.num_timesteps)
        if isinstance(model, FrontierGRPO):
            rates = np.asarray(model.last_group_success).mean(axis=1)
            failed, succeeded = rates == 0, rates == 1
            history.groups.append([int(kind.sum()) for kind in (failed, ~failed & ~succeeded, succeeded)])
        self._collected = True

    def _on_training_end(self) -> None:
        if self._under_way and self._continues and not self._collected and self.num_timesteps > self._begun:
            self._note_collection()  # SAC ends wherever its steps are used up
        self._close_update()
        self._hook.remove()
        if self._continues:
            self._between_updates(len(self.history))

    def _close_update(self) -> None:
        """Count the time of the latest optimisation; add it to the history if the update has collected its steps."""
        if not self._under_way:
            return
        self._optimising += self._lap()
        if not self._collected:
            return
        history = self.history
        wall, cpu = self._optimising.round(4).tolist()
        history.optimize_wall.append(wall)
        history.optimize_cpu.append(cpu)
        history.optimizer_steps.append(self._optimizer_steps)
        history.transitions_used.append(getattr(self.model, "transitions_used", self.num_timesteps))
        self._collected = self._under_way = False

    def _lap(self) -> Array:
        """Return wall and CPU seconds since the last call."""
        before, self._clock = self._clock, self._now()
        return np.subtract(self._clock, before)

    def _now(self) -> tuple[float, float]:
        """Return the time, and the processor time that this process and the workers of its env have used, seconds."""
        workers = getattr(self.training_env, "processor_seconds", None)
        return time.perf_counter(), time.process_time() + (workers() if workers is not None else 0.0)


class TimeLimit:
    """Ends training when the time or the updates are used up, and shows a bar with success by stratum.

    Args:
        history: Of the run; the time that earlier calls spent on it counts.
        seconds: Wall time allowed; no update begins that is expected to end too late.
        updates: Updates allowed; None for no limit.
    """

    def __init__(self, history: TrainingHistory, *, seconds: float, updates: int | None = None) -> None:
        self._history, self._seconds, self._updates = history, seconds, updates
        self._last = time.monotonic()
        self._start = self._last - sum(history.collect_wall) - sum(history.optimize_wall)
        self._longest = 0.0
        self._bar = tqdm(
            total=round(seconds),
            unit="s",
            bar_format="training {percentage:3.0f}%|{bar:20}| {n:.0f}/{total_fmt} s {postfix}",
        )

    def __call__(self, updates: int) -> bool:
        """Return whether another update may begin."""
        now = time.monotonic()
        if updates:
            self._longest = max(self._longest, now - self._last)
            self._bar.set_postfix_str(f"update {updates}, {describe_update(self._history)}")
        self._last = now
        self._bar.update(min(now - self._start, self._seconds) - self._bar.n)
        time_is_up = now - self._start + self._longest > self._seconds
        return not time_is_up and (self._updates is None or updates < self._updates)

    def used(self) -> float:
        """Return the larger of two shares: of the time used, and of the updates made before the one under way."""
        time_share = (time.monotonic() - self._start) / self._seconds if self._seconds > 0 else 1.0
        update_share = max(0, len(self._history) - 1) / self._updates if self._updates else 0.0
        return min(1.0, max(time_share, update_share))

    def close(self) -> None:
        """Leave the bar as it is."""
        self._bar.close()


def describe_update(history: TrainingHistory) -> str:
    """Describe the last update's success, overall and by stratum, in a few characters."""
    analysis = history.frontier()
    return f"success {analysis.overall[-1]:4.0%}, easy {sparkline(analysis.success[-1])} hard"
