"""FrontierGRPO: group-relative policy optimisation with an implicit curriculum, as an SB3 algorithm."""

from __future__ import annotations

from itertools import chain
from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule
from stable_baselines3.common.utils import FloatSchedule
from stable_baselines3.common.vec_env import VecEnv

from dynaforge.algos.buffer import GroupRolloutBuffer
from dynaforge.algos.collection import CollectionSettings, run_rounds
from dynaforge.algos.group_results import GroupResults
from dynaforge.algos.learning import fitting_record, learn_from, log_counters, remember
from dynaforge.algos.options import (
    AdvantageScale,
    Exploration,
    GroupFilter,
    LossAggregation,
    RateScale,
    StratumWeights,
    TimestepCount,
    check_grpo_options,
    check_seed,
)
from dynaforge.algos.policies import POLICY_ALIASES
from dynaforge.algos.resumable import ResumableAlgorithm
from dynaforge.algos.rim import has_rim
from dynaforge.algos.stopwatch import Stopwatch
from dynaforge.algos.success_signal import warn_of_unknown_success
from dynaforge.geometry import Array
from dynaforge.sampling.dispatch import EpisodeDispatcher
from dynaforge.sampling.frontier_strata import StratumRecord
from dynaforge.sampling.sampler import ConditionSampler, condition_sampler_of

# Without a critic there is neither value loss nor lambda; one return per episode needs no discount; and the entropy of
# a fixed sigma is constant.
_UNUSED: dict[str, Any] = {"vf_coef": 0.0, "gae_lambda": 1.0, "gamma": 1.0, "ent_coef": 0.0}


class FrontierGRPO(ResumableAlgorithm):
    """Learn from the conditions on which the policy sometimes succeeds and sometimes fails (Eq. 6-9).

    One iteration draws N conditions, one from each stratum of difficulty, runs each K times with the current policy,
    compares the K returns with one another, drops the groups that succeeded or failed throughout, and takes a few
    epochs of clipped policy gradient on the gated transitions of the rest. There is no critic, no discount, and,
    sigma being fixed, no entropy bonus. `group_filter="none", stratified=False` is vanilla GRPO.

    An iteration is N*K whole episodes on however many envs there are, so `learn` overshoots `total_timesteps` by
    up to one iteration. `load` runs pickled payloads, as in SB3: load only your own files.

    Args:
        policy: "MlpPolicy", "CnnPolicy", "MultiInputPolicy", or a class; see `CriticFreePolicy`.
        env: Env id, env, or any VecEnv; None to load for prediction.
        learning_rate: Adam's, a float or a schedule of the remaining progress.
        n_groups: N, conditions per iteration.
        group_size: K, rollouts of each condition, at least 2.
        n_epochs: Passes over the kept transitions.
        batch_size: Largest minibatch; None takes the whole update at once.
        clip_range: How far the probability ratio may fall below 1; float or schedule.
        clip_range_high: How far it may rise above 1; float or schedule. None takes `clip_range`.
        group_filter: "mixed_success" (the paper), "margin" (two successes and two failures at least; both need
            info["is_success"]), "mixed_return", or "none"; see `frontier_mask`.
        stratified: One condition from each of N strata; False draws all from the whole range.
        stratum_weights: "equal" (the paper), or "frontier": the N groups come from the strata in proportion to the
            trailing p (1 - p) of their success, see `StratumRecord.draw`; needs info["is_success"].
        condition_sampler: Source of conditions. Default: the env's own `condition_sampler`, else reset seeds.
        scale_advantage: Divide by the deviation of the "group" (the paper), of the "batch", or "none"; or multiply by
            the group's "learnability", see `group_advantages`.
        scale_learning_rate: "failures" multiplies the rate by the share of the iteration's rollouts that failed, so
            that a policy which mostly succeeds changes little; needs info["is_success"]. Not in the paper: "none".
        loss_agg: Mean over transitions ("step") or over episodes ("episode").
        kl_coef: Weight of KL(old || new), old being the policy at the update's start.
        anchor_coef: Weight of KL(old || new) on groups that succeeded throughout. The filter drops them, so that
            nothing else keeps the policy as it is there; not in the paper, where it is 0.
        rim_coef: Weight of a penalty on means outside the action box, see `rim_penalty`. Not in the paper: 0.
        target_kl: Ends an update whose approximate KL exceeds 1.5 times this.
        desired_kl: The rate follows the KL of the updates: after one of more than twice this it falls by 1.5, after one
            of less than half it rises by 1.5, at most to what `learning_rate` says. Not in the paper: None.
        max_grad_norm: Gradient clipping.
        max_episode_steps: Ends longer episodes; needed for envs that never end.
        timesteps: What `num_timesteps` counts: "active", steps taken inside episodes; "gated", of these only the ones
            whose action had an effect, so that gate modes "skip" and "mask" count alike (an episode without any counts
            as one step, as under "skip"); or "nominal", all envs at every lock step whether idle or not, as SB3 counts.
        resample_max: Rounds of drawing other conditions in place of filtered groups, within an iteration.
        use_sde: Generalised state-dependent exploration; each episode has its own noise matrix.
        exploration: "stream" draws noise from torch's generator, row by row as envs come free. "job" seeds it with
            iteration, group, rollout and step, so that results are the same, bit for bit, for any number of envs. Not
            so with VecNormalize, whose statistics depend on which envs step together, nor with `timesteps="nominal"`,
            by which schedules and the end of training depend on idle envs.
        sde_sample_freq: Renew all noise matrices every so many steps; -1 renews them once per episode.
        stats_window_size: Episodes in the means under rollout/.
        tensorboard_log: Folder for TensorBoard, or None.
        policy_kwargs: See `CriticFreePolicy`: net_arch, log_std_init (default log 0.3), learn_std, squash_mean, ...
        verbose: 0 silent, 1 info, 2 debug.
        seed: Of conditions, minibatch order, initial weights and exploration.
        device: "cpu", "cuda" or "auto".

    Attributes:
        iterations: Iterations so far, those without an update included.
        optimizer_steps: Steps of the optimizer so far; SB3's `_n_updates` counts epochs.
        transitions_used: Gated transitions of kept groups so far, each counted once per update.
        rate_factor: With `desired_kl`, what the scheduled rate is multiplied by.
        stratum_record: Success of each stratum from its own trials; None with equal weights.
        skipped_updates: Iterations in which no group was kept.
        last_group_success: Success of the last iteration, shape (N, K); None when the env does not report it.
        last_group_returns: Its returns, shape (N, K).
        last_group_strata: Its strata, shape (N,); -1 when drawn from the whole range.
        last_group_conditions: Its conditions; not saved.

    Raises:
        ValueError: An option out of range or unknown, or "mixed_success" on an env that reports no success.
        FloatingPointError: NaN or infinity in observation, reward, ratio or gradient; the weights stay finite.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = POLICY_ALIASES
    rollout_buffer: GroupRolloutBuffer  # type: ignore[assignment]

    def __init__(
        self,
        policy: str | type[BasePolicy],
        env: GymEnv | str | None,
        learning_rate: float | Schedule = 1e-3,
        *,
        n_groups: int = 16,
        group_size: int = 8,
        n_epochs: int = 4,
        batch_size: int | None = 1024,
        clip_range: float | Schedule = 0.2,
        clip_range_high: float | Schedule | None = 0.28,
        group_filter: GroupFilter = "mixed_success",
        stratified: bool = True,
        stratum_weights: StratumWeights = "equal",
        condition_sampler: ConditionSampler | None = None,
        scale_advantage: AdvantageScale = "group",
        scale_learning_rate: RateScale = "none",
        loss_agg: LossAggregation = "step",
        kl_coef: float = 0.0,
        anchor_coef: float = 0.0,
        rim_coef: float = 0.0,
        target_kl: float | None = None,
        desired_kl: float | None = None,
        max_grad_norm: float = 0.5,
        max_episode_steps: int | None = None,
        timesteps: TimestepCount = "active",
        resample_max: int = 0,
        exploration: Exploration = "stream",
        use_sde: bool = False,
        sde_sample_freq: int = -1,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        policy_kwargs: dict[str, Any] | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "auto",
        _init_setup_model: bool = True,
    ) -> None:
        check_seed(seed)
        super().__init__(
            policy,  # type: ignore[arg-type]
            env,  # type: ignore[arg-type]
            learning_rate=learning_rate,
            n_steps=1,  # n_groups * group_size, once they are checked
            **_UNUSED,
            max_grad_norm=max_grad_norm,
            use_sde=use_sde,
            sde_sample_freq=sde_sample_freq,
            rollout_buffer_class=GroupRolloutBuffer,  # type: ignore[arg-type]
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            policy_kwargs=policy_kwargs,
            verbose=verbose,
            seed=seed,
            device=device,
            supported_action_spaces=(spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary),
            _init_setup_model=False,
        )
        self.n_groups, self.group_size = n_groups, group_size
        self.n_epochs, self.batch_size = n_epochs, batch_size
        self.clip_range, self.clip_range_high = clip_range, clip_range_high
        self.group_filter, self.stratified, self.condition_sampler = group_filter, stratified, condition_sampler
        self.stratum_weights, self.exploration = stratum_weights, exploration
        self.scale_advantage, self.scale_learning_rate, self.loss_agg = scale_advantage, scale_learning_rate, loss_agg
        self.kl_coef, self.anchor_coef, self.rim_coef = kl_coef, anchor_coef, rim_coef
        self.target_kl, self.desired_kl = target_kl, desired_kl
        self.max_episode_steps, self.timesteps, self.resample_max = max_episode_steps, timesteps, resample_max
        self._seed_generators(seed)
        self._start_counting()
        if _init_setup_model:
            self._setup_model()

    def _start_counting(self) -> None:
        """Set counters and the results of the last iteration to those of a model that has not been trained."""
        self.iterations = self.optimizer_steps = self.transitions_used = self.skipped_updates = 0
        self.rate_factor = 1.0
        self.last_group_success: NDArray[np.bool_] | None = None
        self.last_group_returns: Array | None = None
        self.last_group_strata: NDArray[np.int64] | None = None
        self.last_group_conditions: tuple[Any, ...] = ()
        self._dispatcher: EpisodeDispatcher | None = None
        self._conditions: ConditionSampler | None = None
        self._results: GroupResults | None = None
        self.stratum_record: StratumRecord | None = None

    def _setup_model(self) -> None:
        if not hasattr(self, "observation_space"):
            raise ValueError("FrontierGRPO needs an env to build its policy: pass an env id, an env or a VecEnv.")
        check_grpo_options(self)
        self.stratum_record = fitting_record(self)
        self.n_steps = self.n_groups * self.group_size
        super()._setup_model()
        if self.rim_coef and not has_rim(self.policy):
            raise ValueError(f"rim_coef needs a bounded Box and no squash_output; given {self.action_space}.")
        high = self.clip_range if self.clip_range_high is None else self.clip_range_high
        self.clip_range, self.clip_range_high = FloatSchedule(self.clip_range), FloatSchedule(high)

    def _maybe_recommend_cpu(self, mlp_class_name: str = "CriticFreePolicy") -> None:
        super()._maybe_recommend_cpu(mlp_class_name)

    def _setup_learn(self, total_timesteps: int, *args: Any, **kwargs: Any) -> tuple[int, BaseCallback]:
        if self.env is None:
            raise ValueError("This model has no env to learn in: call `set_env(env)`, or load it with `env=`.")
        self._dispatcher = EpisodeDispatcher(self.env, max_episode_steps=self.max_episode_steps)
        prepared = super()._setup_learn(total_timesteps, *args, **kwargs)
        self._conditions = condition_sampler_of(self.env) if self.condition_sampler is None else self.condition_sampler
        return prepared

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_dispatcher", "_conditions", "_results", "last_group_conditions"]

    def collect_rollouts(self, env: VecEnv, callback: BaseCallback, rollout_buffer: Any, n_rollout_steps: int) -> bool:
        """Run the N*K episodes of an iteration; `n_rollout_steps` plays no part.

        Returns:
            False when a callback stopped training.
        """
        assert self._dispatcher is not None
        assert self._conditions is not None
        self.policy.set_training_mode(False)
        rollout_buffer.reset()
        self._begin_iteration()
        if self.use_sde:
            self.policy.reset_noise(env.num_envs)
        callback.on_rollout_start()
        settings = CollectionSettings.of(self)
        with Stopwatch() as watch, self._dispatcher.releasing():
            rounds = run_rounds(self, settings, self._conditions, self._dispatcher, callback)
        if rounds is None:
            return False
        rollout_buffer.finish()
        self._results = GroupResults.of(chain.from_iterable(rounds))
        warn_of_unknown_success(self._results, settings.readers)
        # Reported are the conditions drawn first: replacements come from the strata of filtered groups, and would bias
        # success by stratum.
        first = GroupResults.of(rounds[0])
        first.log(self.logger, self.group_filter)
        self.last_group_success, self.last_group_returns = first.success, first.returns
        self.last_group_strata, self.last_group_conditions = first.strata, first.conditions
        self.logger.record("frontier/idle_share", self._dispatcher.idle_share)
        self.logger.record("frontier/groups_run", len(self._results.groups))
        watch.log(self.logger, "collect")
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """Update the policy on the kept groups (Eq. 7-9); without any, change nothing but the counters."""
        assert self._results is not None
        with Stopwatch() as watch:
            kept, report = learn_from(self, self._results)
        remember(self, self._results)
        if report is None:
            self.skipped_updates += 1
        else:
            self._n_updates += report.n_epochs
            self.optimizer_steps += report.optimizer_steps
            report.log(self.logger)
        self.transitions_used += len(kept)
        log_counters(self, len(kept) / self.rollout_buffer.size())
        watch.log(self.logger, "optimize")
        self.iterations += 1
        self._end_iteration()
