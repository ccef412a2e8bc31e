"""The sampling side of an iteration: policy and envs in lock step, seen by callbacks as in SB3."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.utils import obs_as_tensor
from stable_baselines3.common.vec_env import VecEnv

from dynaforge.algos.buffer import GroupRolloutBuffer
from dynaforge.algos.outcomes import GroupOutcomes
from dynaforge.algos.policies import renew_noise
from dynaforge.sampling.dispatch import EpisodeDispatcher, FinishedEpisode
from dynaforge.sampling.sampler import Job
from dynaforge.sampling.vec_wrappers import take_rows

if TYPE_CHECKING:
    from dynaforge.algos.frontier_grpo import FrontierGRPO

_READS_SUCCESS = (
    ("group_filter", "mixed_success", "'mixed_return' or 'none'"),
    ("scale_learning_rate", "failures", "'none'"),
)


def run_jobs(
    model: FrontierGRPO,
    jobs: list[Job],
    episodes: dict[int, FinishedEpisode],
    *,
    dispatcher: EpisodeDispatcher,
    env: VecEnv,
    callback: BaseCallback,
    rollout_buffer: GroupRolloutBuffer,
) -> bool:
    """Run jobs to their ends with the model's policy, into `episodes` (by job index) and the buffer.

    Callbacks are called once a lock step in which some env acted, and find the names of SB3's rollout loop in their
    `locals`: infos, dones, rewards, new_obs, actions, clipped_actions, values, log_probs, n_steps, env,
    rollout_buffer. Idle rows have reward 0, done False and info {"idle": True}.

    Returns:
        False when a callback stopped training.

    Raises:
        ValueError: The group filter needs "is_success" and the env does not report it.
        FloatingPointError: NaN or infinity in an observation or reward.
    """
    dispatcher.submit(jobs)
    n_steps = 0
    gated = np.zeros(1 + max(job.index for job in jobs), dtype=np.int64)
    while dispatcher.busy:
        if model.use_sde:
            all_rows = model.sde_sample_freq > 0 and n_steps % model.sde_sample_freq == 0
            renew_noise(model.policy, np.arange(env.num_envs) if all_rows else dispatcher.newly_started)
        obs = dispatcher.obs
        with th.no_grad():
            actions, values, log_probs = model.policy(obs_as_tensor(obs, model.device))
        actions = actions.cpu().numpy()
        clipped_actions = env_actions(actions, model.policy)
        tick = dispatcher.step(clipped_actions)
        new_obs, rewards, dones, infos = tick.new_obs, tick.rewards, tick.dones, tick.infos
        rows = np.flatnonzero(tick.acted)
        mask = np.array([infos[row].get("residual_mask", 1.0) > 0.0 for row in rows])
        gated[tick.jobs[rows]] += mask
        model.num_timesteps += {
            "active": len(rows),
            "gated": int(mask.sum()) + sum(not gated[episode.job.index] for episode in tick.finished),
            "nominal": env.num_envs,
        }[model.timesteps]
        callback.update_locals(locals() | {"self": model})
        if not callback.on_step():
            return False
        model._update_info_buffer(infos, dones)
        n_steps += 1
        rollout_buffer.add(take_rows(obs, rows), actions[rows], log_probs.cpu().numpy()[rows], mask, tick.jobs[rows])
        for episode in tick.finished:
            require_success(episode, model)
            episodes[episode.job.index] = episode
        model._last_obs, model._last_episode_starts = new_obs, dones
    return True


def env_actions(actions: NDArray[Any], policy: ActorCriticPolicy) -> NDArray[Any]:
    """Turn sampled actions into those the env takes: unscaled when squashed, else clipped to a Box's bounds."""
    space = policy.action_space
    if not isinstance(space, spaces.Box):
        return actions
    return policy.unscale_action(actions) if policy.squash_output else np.clip(actions, space.low, space.high)


def require_success(episode: FinishedEpisode, model: FrontierGRPO) -> None:
    """Refuse options that read success when an episode ends by itself and does not tell whether it succeeded.

    Raises:
        ValueError: Says so, with the remedy.
    """
    if episode.success is not None or episode.truncated:
        return
    for option, reading, remedy in _READS_SUCCESS:
        if getattr(model, option) == reading:
            raise ValueError(
                f"{option}={reading!r} reads info['is_success'] at the end of an episode, and this env does not give "
                f"it. Report it there, or use {option}={remedy}."
            )


def warn_of_unknown_success(outcomes: GroupOutcomes, model: FrontierGRPO) -> None:
    """Warn when all episodes of an iteration were cut off before the env said whether they succeed."""
    for option, reading, remedy in _READS_SUCCESS:
        if outcomes.success is None and getattr(model, option) == reading:
            warnings.warn(
                f"{option}={reading!r} reads info['is_success'], and every episode was cut off before the env gave it: "
                f"all count as failures. Allow longer episodes, or use {option}={remedy}.",
                stacklevel=3,
            )
