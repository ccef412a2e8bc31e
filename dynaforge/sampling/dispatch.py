"""Runs any number of episodes over any number of envs, in lock step."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from dynaforge.geometry import one_line
from dynaforge.sampling.job_routes import choose_route, idle_action
from dynaforge.sampling.sampler import Group, Job
from dynaforge.sampling.vec_wrappers import Observations, WrapperStack, put_rows, take_rows

MAX_UNCAPPED_STEPS = 100_000  # An episode without a cap that is longer is taken for one that never ends.


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedEpisode:
    """What a job came to.

    Attributes:
        job: The job.
        total_reward: Sum of rewards; for DynaForge envs the R of Eq. 6.
        length: Steps taken.
        success: The env's "is_success" at the end; None when it does not report it.
        truncated: Whether it was cut off, by the dispatcher or by a TimeLimit.
        capped: Whether the dispatcher cut it off, at `max_episode_steps`.
        info: The env's last info.
    """

    job: Job
    total_reward: float
    length: int
    success: bool | None
    truncated: bool
    capped: bool
    info: dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class DispatchStep:
    """What one lock step did; arrays and lists other than `finished` have one row per env.

    Attributes:
        acted: Whether the row's action was a step of an episode.
        jobs: The job of each row that acted; None for the others.
        new_obs: Observations after the step: the first one of an episode that started, the old one of an idle row.
        rewards: 0 where the row did not act.
        dones: True where an episode ended, by itself or at the cap.
        infos: {"idle": True} where the row neither acted nor started an episode.
        finished: The episodes that ended.
    """

    acted: NDArray[np.bool_]
    jobs: list[Job | None]
    new_obs: Observations
    rewards: NDArray[np.float64]
    dones: NDArray[np.bool_]
    infos: list[dict[str, Any]]
    finished: list[FinishedEpisode]

    __repr__ = one_line


class EpisodeDispatcher:
    """Feeds jobs to the rows of a VecEnv as they become free.

    Call `submit(jobs)`, then `step(actions)` while `busy`, reading `obs` before each step, all inside `releasing()`.
    The innermost VecEnv is stepped directly and its wrappers are applied to live rows (see `WrapperStack`), so idle
    rows reach neither statistics nor buffers.

    Args:
        env: Any VecEnv.
        max_episode_steps: Ends episodes that are still running after this many steps; needed for endless envs.

    Attributes:
        newly_started: Rows that take the first action of an episode at the next step.

    Raises:
        ValueError: A wrapper that whole-episode sampling cannot handle, or a cap below 1.
    """

    def __init__(self, env: VecEnv, *, max_episode_steps: int | None = None) -> None:
        if max_episode_steps is not None and max_episode_steps < 1:
            raise ValueError(f"max_episode_steps is {max_episode_steps}; it must be at least 1, or None for no cap.")
        self.n_envs = env.num_envs
        self.max_episode_steps = max_episode_steps
        self._stack = WrapperStack(env)
        self._route = choose_route(self._stack.base)
        self._idle_actions = np.stack([idle_action(env.action_space)] * self.n_envs)
        self._pending: dict[Group, deque[Job]] = {}  # in the order in which groups were submitted
        self._job: list[Job | None] = [None] * self.n_envs
        self._group: list[Group | None] = [None] * self.n_envs  # of the latest job of each row
        self._acting = np.zeros(self.n_envs, dtype=bool)
        self._starting = np.zeros(self.n_envs, dtype=bool)
        self._returns = np.zeros(self.n_envs)
        self._lengths = np.zeros(self.n_envs, dtype=np.int64)
        self._reports_success = False  # whether any episode has so far
        self._obs: Observations | None = None
        self._t0 = time.monotonic()
        self.ticks = 0
        self.idle_rows = 0
        self.newly_started = np.zeros(0, dtype=np.intp)

    @property
    def busy(self) -> bool:
        """Whether any episode is still to be finished."""
        return bool(self._pending) or bool(self._acting.any()) or bool(self._starting.any())

    @property
    def obs(self) -> Observations:
        """Observations to act on, one row per env; those of rows outside an episode are old or zero."""
        if self._obs is None:
            raise RuntimeError("There is no observation yet: submit jobs first.")
        return self._obs

    @property
    def acting(self) -> list[tuple[int, Job, int]]:
        """Rows that take an action at the next step, each with its job and the number of steps that it has taken."""
        rows = np.flatnonzero(self._acting).tolist()
        return [(row, job, int(self._lengths[row])) for row in rows if (job := self._job[row]) is not None]

    @property
    def idle_share(self) -> float:
        """Share of row-steps since the last `submit` in which a row neither acted nor started an episode."""
        return self.idle_rows / max(1, self.ticks * self.n_envs)

    def submit(self, jobs: Iterable[Job]) -> None:
        """Queue jobs and start one in each env; `obs` then has their first observations.

        The jobs of a group go to one row one after the other, so that an env can begin where they begin to differ. A
        row that has none left takes the first group that no row has, then one of the group with the most jobs left.

        Raises:
            RuntimeError: Jobs of an earlier call are still running.
        """
        if self.busy:
            raise RuntimeError("Earlier jobs are still running; step until `busy` is False, or call `release`.")
        self.ticks = self.idle_rows = 0
        for job in jobs:
            self._pending.setdefault(job.group, deque()).append(job)
        self._hand_out()
        self._start_rows()

    def step(self, actions: Any) -> DispatchStep:
        """Take one action in every running episode, then start pending jobs on free rows.

        Args:
            actions: One row per env, valid in the action space; rows outside an episode are ignored.

        Raises:
            FloatingPointError: An observation or reward is NaN or infinite; it names env, episode and component.
            RuntimeError: An episode without a cap seems never to end.
        """
        result = self._tick(actions)
        self._start_rows()
        return result

    def release(self) -> None:
        """Drop pending and running jobs and restore the VecEnv's automatic resets."""
        self._pending.clear()
        self._acting[:] = self._starting[:] = False
        self._job = [None] * self.n_envs
        self._group = [None] * self.n_envs
        self._route.release()

    @contextlib.contextmanager
    def releasing(self) -> Iterator[None]:
        """Release the VecEnv however the block ends; an exception of the block is the one that is raised."""
        try:
            yield
        except BaseException:
            with contextlib.suppress(RuntimeError, OSError):  # a worker has died, or the VecEnv is closed
                self.release()
            raise
        self.release()

    def _hand_out(self) -> None:
        for row in np.flatnonzero(~(self._acting | self._starting)).tolist():
            if not self._pending:
                return
            job = self._next_job(row)
            self._route.assign(row, job)
            self._job[row] = job
            self._starting[row] = True

    def _next_job(self, row: int) -> Job:
        pending, group = self._pending, self._group[row]
        if group is None or group not in pending:
            most_left = max(pending, key=lambda each: len(pending[each]))
            group = next((each for each in pending if each not in self._group), most_left)
        job = pending[group].popleft()
        if not pending[group]:
            del pending[group]
        self._group[row] = group
        return job

    def _start_rows(self) -> None:
        # Rows usually start while others act. When none acts, a step without actions starts them.
        self.newly_started = np.flatnonzero(self._acting & (self._lengths == 0))
        if not self._acting.any() and self._starting.any():
            self._tick(self._idle_actions)
            self.newly_started = np.flatnonzero(self._acting)

    def _tick(self, actions: Any) -> DispatchStep:
        acted, started = self._acting.copy(), self._starting.copy()
        worked = acted | started
        jobs = [job if row_acted else None for job, row_acted in zip(self._job, acted, strict=True)]
        raw, rewards, dones, infos = self._route.step(actions)
        rewards = np.where(acted, rewards, 0.0)
        self._check_finite(raw, rewards, worked)
        self._lengths[started], self._returns[started] = 0, 0.0
        self._lengths[acted] += 1
        self._returns[acted] += rewards[acted]
        self.ticks += 1
        self.idle_rows += int(self.n_envs - worked.sum())

        dones, capped = self._end_at_cap(np.asarray(dones) & acted, acted)
        infos = [info if w else {"idle": True} for info, w in zip(infos, worked, strict=True)]
        obs = self._stack.observe(raw, np.flatnonzero(worked & ~dones))
        if self._obs is not None:
            put_rows(obs, ~worked, take_rows(self._obs, ~worked))
        self._obs = obs
        self._stack.film()
        finished = [self._finish(row, raw, infos[row], bool(capped[row])) for row in np.flatnonzero(dones).tolist()]
        self._acting = worked & ~dones
        self._starting[:] = False
        self._hand_out()
        return DispatchStep(
            acted=acted, jobs=jobs, new_obs=obs, rewards=rewards, dones=dones, infos=infos, finished=finished
        )

    def _end_at_cap(
        self, dones: NDArray[np.bool_], acted: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        limit = self.max_episode_steps if self.max_episode_steps is not None else MAX_UNCAPPED_STEPS
        over = acted & ~dones & (self._lengths >= limit)
        if self.max_episode_steps is None and over.any():
            job = self._job[int(np.argmax(over))]
            raise RuntimeError(
                f"{job} has not ended after {MAX_UNCAPPED_STEPS} steps. For endless envs pass max_episode_steps."
            )
        return dones | over, over

    def _finish(self, row: int, raw: Observations, info: dict[str, Any], capped: bool) -> FinishedEpisode:
        job = self._job[row]
        assert job is not None
        if capped:
            info["TimeLimit.truncated"] = True
            self._route.drop(row)
        truncated = bool(info.get("TimeLimit.truncated", False))
        if "is_success" in info:
            self._reports_success = True
        elif truncated and self._reports_success:
            info["is_success"] = False  # many envs report success only when they end an episode themselves
        last = info.get("terminal_observation")
        info["terminal_observation"] = self._stack.peek(take_rows(raw, row) if last is None else last)
        total, length = float(self._returns[row]), int(self._lengths[row])
        summary = {"r": round(total, 6), "l": length, "t": round(time.monotonic() - self._t0, 6)}
        self._stack.report_episode(summary, info)
        info.setdefault("episode", summary)
        self._job[row] = None
        return FinishedEpisode(
            job=job,
            total_reward=total,
            length=length,
            success=None if info.get("is_success") is None else bool(info["is_success"]),
            truncated=truncated,
            capped=capped,
            info=info,
        )

    def _check_finite(self, raw: Observations, rewards: NDArray[np.float64], worked: NDArray[np.bool_]) -> None:
        parts = raw.items() if isinstance(raw, dict) else [("", raw)]
        for key, part in parts:
            if part.dtype.kind != "f" or np.isfinite(part[worked]).all():
                continue
            row = int(np.argmax(worked & ~np.isfinite(part.reshape(self.n_envs, -1)).all(axis=1)))
            where = np.argwhere(~np.isfinite(part[row]))[0].tolist()
            name = f"observation[{key!r}]" if key else "observation"
            raise FloatingPointError(
                f"{name} of env {row} is {part[row][tuple(where)]} at component {where} ({self._job[row]})."
            )
        if not np.isfinite(rewards).all():
            row = int(np.argmax(~np.isfinite(rewards)))
            raise FloatingPointError(f"Reward of env {row} is {rewards[row]} ({self._job[row]}).")
