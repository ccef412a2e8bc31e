"""Where a policy's exploration noise comes from: one stream for all envs, or one for each decision of each rollout."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch as th
from stable_baselines3.common.distributions import StateDependentNoiseDistribution
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import PyTorchObs
from stable_baselines3.common.utils import obs_as_tensor

from dynaforge.algos.policies import renew_noise
from dynaforge.algos.rim import has_rim, means_at_rim
from dynaforge.sampling.dispatch import EpisodeDispatcher
from dynaforge.sampling.vec_wrappers import take_rows


class Acted(NamedTuple):
    """What a policy sampled, one row per env.

    Attributes:
        actions: Actions, shape (n, ...).
        values: Values, shape (n, 1).
        log_probs: Log-probabilities of the actions, shape (n,).
        at_rim: Whether the mean lay at the rim of the action box, shape (n,); False where there is no rim.
    """

    actions: th.Tensor
    values: th.Tensor
    log_probs: th.Tensor
    at_rim: th.Tensor


@th.no_grad()
def act(model: OnPolicyAlgorithm, dispatcher: EpisodeDispatcher, *, n_steps: int, key: tuple[int, int] | None) -> Acted:
    """Sample actions for the observations of a dispatcher.

    Args:
        model: Has the policy, and the options of gSDE.
        dispatcher: Knows which rows act, and in which step of which job.
        n_steps: Lock steps so far.
        key: Of the iteration, for noise by job; None for torch's stream.
    """
    if key is not None:
        return _act_by_job(model, dispatcher, key)
    if model.use_sde:
        # One noise matrix per episode; with `sde_sample_freq`, new ones for all rows every so many steps.
        all_rows = model.sde_sample_freq > 0 and n_steps % model.sde_sample_freq == 0
        renew_noise(model.policy, np.arange(dispatcher.n_envs) if all_rows else dispatcher.newly_started)
    return _sample(model.policy, obs_as_tensor(dispatcher.obs, model.device))


def _sample(policy: ActorCriticPolicy, obs: PyTorchObs) -> Acted:
    actions, values, log_probs = policy(obs)
    at_rim = means_at_rim(policy) if has_rim(policy) else th.zeros_like(log_probs, dtype=th.bool)
    return Acted(actions, values, log_probs, at_rim)


def _act_by_job(model: OnPolicyAlgorithm, dispatcher: EpisodeDispatcher, key: tuple[int, int]) -> Acted:
    """Sample each row's action by itself, from torch's generator seeded with iteration, group, rollout and step.

    What a rollout does then depends on nothing but its job: not on the number of envs, nor on what runs beside it
    (VecNormalize apart, whose statistics are of all envs). The rows go through the policy one by one, since a matrix
    product rounds differently in batches of other sizes.
    """
    policy, acted = model.policy, dispatcher.acting
    found: list[Acted] = []
    on_gpu = model.device.type == "cuda"
    reseed = th.manual_seed if on_gpu else th.default_generator.manual_seed  # the former takes 150 us, the latter 1
    with th.random.fork_rng(devices=[model.device] if on_gpu else []):
        for row, job, step in acted:
            seed = np.random.SeedSequence((*key, job.group.index, job.rollout, step)).generate_state(1, np.uint64)
            reseed(int(seed[0]))
            if model.use_sde:
                _take_matrix(
                    policy, row, renew=step == 0 or (model.sde_sample_freq > 0 and not step % model.sde_sample_freq)
                )
            found.append(_sample(policy, obs_as_tensor(take_rows(dispatcher.obs, slice(row, row + 1)), model.device)))
    rows = th.as_tensor([row for row, _, _ in acted], device=model.device)
    return Acted(*(_spread(th.cat(parts), rows, dispatcher.n_envs) for parts in zip(*found, strict=True)))


def _take_matrix(policy: ActorCriticPolicy, row: int, *, renew: bool) -> None:
    """Let gSDE use the noise matrix of a row for a batch of one, a new one if asked."""
    noise = policy.action_dist
    assert isinstance(noise, StateDependentNoiseDistribution)
    if renew:
        noise.exploration_matrices[row] = noise.weights_dist.sample()
    noise.exploration_mat = noise.exploration_matrices[row]


def _spread(values: th.Tensor, rows: th.Tensor, n: int) -> th.Tensor:
    """Put values into n rows, zeros where there are none."""
    return values.new_zeros((n, *values.shape[1:])).index_copy(0, rows, values)
