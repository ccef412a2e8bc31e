"""Residual SAC: an off-policy rival of FrontierGRPO, to compare at equal environment steps.

Stable-Baselines3's SAC with what its use on residuals has shown to matter. Layer-normed critics, several gradient steps
for each environment step, and batches half of which come from prior successes: Ball et al., "Efficient Online
Reinforcement Learning with Offline Data" (RLPD, 2023). All of these for a residual on a fixed policy: Ankile et al.,
"Residual Off-Policy RL for Finetuning Behavior Cloning Policies" (ResFiT, 2025). There the successes are
demonstrations; here they are those of the planner, made at the start of training at the cost of environment steps.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.policies import BasePolicy, ContinuousCritic
from stable_baselines3.common.preprocessing import get_action_dim
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, create_mlp
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.sac.policies import SACPolicy
from torch import nn

from dynaforge.algos.decision_replay import DecisionReplay
from dynaforge.algos.options import check_whole


class LayerNormCritic(ContinuousCritic):
    """SB3's critics with a layer norm after each hidden linear layer, which bounds what they extrapolate."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        size = kwargs["features_dim"] + get_action_dim(self.action_space)
        hidden, activation = kwargs["net_arch"], kwargs["activation_fn"]
        for k in range(self.n_critics):
            layers = create_mlp(size, 1, hidden, activation, post_linear_modules=[nn.LayerNorm])
            self.q_networks[k] = nn.Sequential(*layers)
            self.add_module(f"qf{k}", self.q_networks[k])


class ResidualSACPolicy(SACPolicy):
    """SAC's policy with layer-normed critics, and an actor that begins at the planner.

    Its mean begins at zero and its noise at one sigma for all observations, where SAC's begins as wide as the box.

    Args:
        observation_space: Observation space, a flat Box.
        action_space: Action space.
        lr_schedule: Learning rate as a function of the remaining progress.
        log_std_init: Logarithm of the first sigma, of the action's unit; with gSDE, of the weights of its noise.
        kwargs: All other arguments of SB3's `SACPolicy`.
    """

    def __init__(
        self,
        observation_space: spaces.Space,
        action_space: spaces.Box,
        lr_schedule: Schedule,
        *,
        log_std_init: float = -1.8,
        **kwargs: Any,
    ) -> None:
        super().__init__(observation_space, action_space, lr_schedule, log_std_init=log_std_init, **kwargs)

    def _build(self, lr_schedule: Schedule) -> None:
        super()._build(lr_schedule)
        with th.no_grad():
            for parameter in self.actor.mu.parameters():
                parameter.zero_()
            if isinstance(self.actor.log_std, nn.Linear):  # not with gSDE
                self.actor.log_std.weight.zero_()
                self.actor.log_std.bias.fill_(self.actor.log_std_init)

    def make_critic(self, features_extractor: BaseFeaturesExtractor | None = None) -> ContinuousCritic:
        """Make the critics."""
        options = self._update_features_extractor(self.critic_kwargs, features_extractor)
        return LayerNormCritic(**options).to(self.device)


class ResidualSAC(SAC):
    """SAC on residuals, with the planner's own successes as half of every batch.

    The first `learning_starts` steps are taken with a residual of zero, on conditions that the envs draw, and count as
    all others do. Then every step of the vectorised env is followed by `update_ratio` gradient steps for each env.

    Args:
        policy: "MlpPolicy", or a subclass of `ResidualSACPolicy`.
        env: Env of the residual; observations are a flat Box.
        learning_starts: Environment steps of the planner alone.
        update_ratio: Gradient steps for each environment step.
        gamma: Discount; 1 by default, since decisions differ in duration and Eq. 6 does not discount.
        ent_coef: As in SB3. Returns are within [0, 1], so the learned coefficient begins far below SB3's 1.
        buffer_size: Decisions in each of the two buffers.
        seed: Seeds everything.
        kwargs: All other arguments of SB3's SAC, but those that make buffers and say when to train.

    Raises:
        TypeError: `update_ratio` is no whole number.
        ValueError: `update_ratio` below 1.
    """

    action_space: spaces.Box
    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": ResidualSACPolicy}
    replay_buffer: DecisionReplay

    def __init__(
        self,
        policy: str | type[ResidualSACPolicy],
        env: GymEnv | str,
        *,
        learning_starts: int = 2000,
        update_ratio: int = 4,
        gamma: float = 1.0,
        ent_coef: str | float = "auto_0.01",
        buffer_size: int = 100_000,
        seed: int | None = None,
        **kwargs: Any,
    ) -> None:
        check_whole("update_ratio", update_ratio, 1, "critics learn from what was collected")
        self.update_ratio = update_ratio
        super().__init__(
            policy,
            env,
            learning_starts=learning_starts,
            gamma=gamma,
            ent_coef=ent_coef,
            buffer_size=buffer_size,
            seed=seed,
            replay_buffer_class=DecisionReplay,
            replay_buffer_kwargs={"seed": seed},
            **kwargs,
        )

    def _setup_model(self) -> None:
        self.gradient_steps = self.update_ratio * self.n_envs
        super()._setup_model()

    def _setup_learn(
        self, total_timesteps: int, callback: MaybeCallback = None, reset_num_timesteps: bool = True, *args: Any
    ) -> tuple[int, BaseCallback]:
        if reset_num_timesteps:
            self.replay_buffer.forget_unfinished()
        return super()._setup_learn(total_timesteps, callback, reset_num_timesteps, *args)

    def _sample_action(
        self, learning_starts: int, action_noise: ActionNoise | None = None, n_envs: int = 1
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        if self.num_timesteps >= learning_starts:
            return super()._sample_action(learning_starts, action_noise, n_envs)
        zero = np.zeros((n_envs, *self.action_space.shape), np.float32)
        return zero, self.policy.scale_action(zero)

    def train(self, gradient_steps: int, batch_size: int = 256) -> None:
        """Make gradient steps, once an episode has ended."""
        if self.replay_buffer.decisions:
            super().train(gradient_steps, batch_size)
