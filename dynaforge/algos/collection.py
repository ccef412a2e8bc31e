"""The sampling side of an iteration: policy and envs in lock step, seen by callbacks as in SB3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy

from dynaforge.algos.buffer import GroupRolloutBuffer
from dynaforge.algos.exploration import act
from dynaforge.algos.group_results import GroupResults
from dynaforge.algos.options import GroupFilter, TimestepCount
from dynaforge.algos.resumable import ResumableAlgorithm
from dynaforge.algos.success_signal import SuccessReader, require_success, success_readers
from dynaforge.sampling.dispatch import DispatchStep, EpisodeDispatcher, FinishedEpisode
from dynaforge.sampling.sampler import ConditionSampler, Job, StratifiedSampler
from dynaforge.sampling.vec_wrappers import take_rows


@dataclass(frozen=True, kw_only=True)
class CollectionSettings:
    """Settings of one iteration's sampling; see `FrontierGRPO` for their meaning.

    Attributes:
        noise_key: What the exploration noise of the iteration is keyed by; None draws it from torch's stream.
        readers: Those options that read success.
    """

    n_groups: int
    group_size: int
    stratified: bool
    group_filter: GroupFilter
    resample_max: int
    timesteps: TimestepCount
    noise_key: tuple[int, int] | None
    readers: list[SuccessReader]

    @staticmethod
    def of(model: Any) -> CollectionSettings:
        """Read the options of a FrontierGRPO model."""
        return CollectionSettings(
            n_groups=model.n_groups,
            group_size=model.group_size,
            stratified=model.stratified,
            group_filter=model.group_filter,
            resample_max=model.resample_max,
            timesteps=model.timesteps,
            noise_key=(model.noise_entropy, model.iterations) if model.exploration == "job" else None,
            readers=success_readers(model),
        )


def run_rounds(
    model: ResumableAlgorithm,
    settings: CollectionSettings,
    conditions: ConditionSampler,
    dispatcher: EpisodeDispatcher,
    callback: BaseCallback,
) -> list[list[FinishedEpisode]] | None:
    """Run N groups, then up to `resample_max` rounds of other conditions in place of filtered groups.

    Args:
        model: Draws the conditions, acts, and owns the buffer.
        settings: Numbers, filter and so on.
        conditions: Source of conditions.
        dispatcher: Runs the episodes on the model's env.
        callback: Called at every lock step.

    Returns:
        The episodes of each round; None when a callback stopped training.
    """
    sampler = StratifiedSampler(settings.n_groups, settings.group_size, stratified=settings.stratified)
    rounds: list[list[FinishedEpisode]] = []
    record = model.stratum_record
    strata: list[int | None] = [*(sampler.strata if record is None else record.draw(model.condition_rng))]
    n_drawn = 0
    while strata and len(rounds) <= settings.resample_max:
        groups = sampler.draw(conditions, model.condition_rng, strata=strata, first_index=n_drawn)
        n_drawn += len(groups)
        episodes = run_jobs(model, settings, sampler.jobs(groups), dispatcher, callback)
        if episodes is None:
            return None
        rounds.append(episodes)
        # A replacement comes from the stratum of the group that was dropped, so that the strata stay balanced.
        kept = GroupResults.of(episodes).kept(settings.group_filter)
        strata = [group.stratum for group, keep in zip(groups, kept, strict=True) if not keep]
    return rounds


def run_jobs(
    model: OnPolicyAlgorithm,
    settings: CollectionSettings,
    jobs: Sequence[Job],
    dispatcher: EpisodeDispatcher,
    callback: BaseCallback,
) -> list[FinishedEpisode] | None:
    """Run jobs to their ends with the model's policy, adding their transitions to the model's rollout buffer.

    Callbacks are called once for every lock step in which some env acted. Their `locals` have the names of SB3's
    rollout loop: infos, dones, rewards, new_obs, actions, clipped_actions, values, log_probs, n_steps, env,
    rollout_buffer. Idle rows have reward 0, done False and info {"idle": True}.

    Args:
        model: Acts, counts `num_timesteps`, and owns the buffer; its rollout buffer is a `GroupRolloutBuffer`.
        settings: What is counted as a time step, and which options need the env to report success.
        jobs: Episodes to run.
        dispatcher: Runs them on the model's env.
        callback: Called at every lock step.

    Returns:
        The finished episodes; None when the callback stopped training.

    Raises:
        ValueError: An option needs "is_success" and the env does not report it.
        FloatingPointError: NaN or infinity in an observation or reward.
    """
    env, rollout_buffer = model.env, cast(GroupRolloutBuffer, model.rollout_buffer)  # callbacks read these names
    assert env is not None
    episodes: list[FinishedEpisode] = []
    gated_jobs: set[Job] = set()  # those in which some action had an effect
    dispatcher.submit(jobs)
    n_steps = 0
    while dispatcher.busy:
        obs = dispatcher.obs
        sampled, values, log_probs, at_rim = act(model, dispatcher, n_steps=n_steps, key=settings.noise_key)
        actions = sampled.cpu().numpy()
        # The env takes the clipped action; the buffer keeps the sampled one, whose log-probability is known.
        clipped_actions = env_actions(actions, model.policy)
        tick = dispatcher.step(clipped_actions)
        new_obs, rewards, dones, infos = tick.new_obs, tick.rewards, tick.dones, tick.infos
        rows = np.flatnonzero(tick.acted)
        acting = [job for job in tick.jobs if job is not None]  # one per entry of `rows`
        # Gate m of Eq. 5: where it is 0 the residual had no effect. An env without gates lets every action count.
        mask = np.array([infos[row].get("residual_mask", 1.0) > 0.0 for row in rows])
        gated_jobs.update(job for job, gated in zip(acting, mask, strict=True) if gated)
        model.num_timesteps += _count_timesteps(settings.timesteps, tick, mask, gated_jobs)
        callback.update_locals(locals() | {"self": model})
        if not callback.on_step():
            return None
        model._update_info_buffer(infos, dones)
        n_steps += 1
        rollout_buffer.add(
            take_rows(obs, rows),
            actions[rows],
            log_probs.cpu().numpy()[rows],
            at_rim.cpu().numpy()[rows],
            mask,
            acting,
        )
        for episode in tick.finished:
            require_success(episode, settings.readers)
        episodes += tick.finished
        model._last_obs, model._last_episode_starts = new_obs, dones
    return episodes


def env_actions(actions: NDArray[Any], policy: ActorCriticPolicy) -> NDArray[Any]:
    """Turn sampled actions into those the env takes: unscaled when squashed, else clipped to a Box's bounds."""
    space = policy.action_space
    if not isinstance(space, spaces.Box):
        return actions
    return policy.unscale_action(actions) if policy.squash_output else np.clip(actions, space.low, space.high)


def _count_timesteps(
    timesteps: TimestepCount, tick: DispatchStep, mask: NDArray[np.bool_], gated_jobs: set[Job]
) -> int:
    match timesteps:
        case "active":
            return int(tick.acted.sum())
        case "gated":
            # An episode without any gated step counts as one, since gate mode "skip" shows it as one step.
            return int(mask.sum()) + sum(episode.job not in gated_jobs for episode in tick.finished)
        case "nominal":
            return len(tick.acted)
