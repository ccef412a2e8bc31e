"""FrontierGRPO: group-relative policy optimisation with an implicit curriculum, as an SB3 algorithm."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.common.utils import FloatSchedule, update_learning_rate
from stable_baselines3.common.vec_env import VecEnv

from dynaforge.algos.advantages import group_advantages
from dynaforge.algos.buffer import GroupRolloutBuffer, KeptTransitions
from dynaforge.algos.collection import run_jobs, warn_of_unknown_success
from dynaforge.algos.options import check_grpo_options, check_seed, check_total_timesteps, check_whole, scheduled
from dynaforge.algos.outcomes import GroupOutcomes
from dynaforge.algos.policies import CriticFreeCnnPolicy, CriticFreeMultiInputPolicy, CriticFreePolicy
from dynaforge.algos.progress import TimestepProgressBar
from dynaforge.algos.random_state import RandomState
from dynaforge.algos.stopwatch import Stopwatch
from dynaforge.algos.update import UpdateReport, UpdateSettings, update_policy
from dynaforge.files.atomic import atomic_write
from dynaforge.geometry import Array
from dynaforge.sampling.dispatch import EpisodeDispatcher, FinishedEpisode
from dynaforge.sampling.sampler import ConditionSampler, SeedConditionSampler, StratifiedSampler
from dynaforge.sampling.vec_wrappers import WrapperStack


class FrontierGRPO(OnPolicyAlgorithm):
    """Learn from the conditions that are neither won nor lost yet (Eq. 6-9).

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
        n_groups: N, conditions an iteration.
        group_size: K, rollouts of each condition, at least 2.
        n_epochs: Passes over the kept transitions.
        batch_size: Largest minibatch; None is the whole update at once.
        clip_range: How far the probability ratio may fall below 1; float or schedule.
        clip_range_high: How far it may rise above 1; float or schedule. None is `clip_range`.
        group_filter: "mixed_success" (the paper; needs info["is_success"]), "mixed_return", or "none".
        stratified: One condition from each of N strata; False draws all from the whole range.
        condition_sampler: Source of conditions. Default: the env's own `condition_sampler`, else reset seeds.
        scale_advantage: Divide by the deviation of the "group", of the "batch", or "none".
        scale_learning_rate: "failures" multiplies the rate by the share of the iteration's rollouts that failed, so
            that a policy which mostly wins moves little; needs info["is_success"]. Not in the paper: "none".
        loss_agg: Mean over transitions ("step") or over episodes ("episode").
        kl_coef: Weight of KL(old || new), old being the policy at the update's start.
        anchor_coef: Weight of KL(old || new) on groups that succeeded throughout. The filter drops them, so that
            nothing holds the policy there; not in the paper, where it is 0.
        target_kl: Ends an update whose approximate KL exceeds 1.5 times this.
        max_grad_norm: Gradient clipping.
        max_episode_steps: Ends longer episodes; needed for envs that never end.
        timesteps: What `num_timesteps` counts: "active", steps taken inside episodes; "gated", of these only the ones
            whose action had an effect, so that gate modes "skip" and "mask" count alike (an episode without any counts
            as one step, as under "skip"); or "nominal", all envs at every lock step whether idle or not, as SB3 counts.
        resample_max: Rounds of drawing other conditions in place of filtered groups, within an iteration.
        use_sde: Generalised state-dependent exploration; each episode has its own noise matrix.
        sde_sample_freq: Renew all noise matrices every so many steps; -1 is once an episode.
        stats_window_size: Episodes in the means under rollout/.
        tensorboard_log: Folder for TensorBoard, or None.
        policy_kwargs: See `CriticFreePolicy`: net_arch, log_std_init (default log 0.3), learn_std, ...
        verbose: 0 silent, 1 info, 2 debug.
        seed: Of conditions, minibatch order, initial weights and exploration.
        device: "cpu", "cuda" or "auto".

    Attributes:
        optimizer_steps: Steps of the optimizer so far; SB3's `_n_updates` counts epochs.
        transitions_used: Gated transitions of kept groups so far, each counted once an update.
        skipped_updates: Iterations in which no group was kept.
        last_group_success: Success of the last iteration, shape (N, K); None when the env does not tell.
        last_group_returns: Its returns, shape (N, K).
        last_group_strata: Its strata, shape (N,); -1 when drawn from the whole range.
        last_group_conditions: Its conditions; not saved.

    Raises:
        ValueError: An option out of range or unknown, or "mixed_success" on an env that reports no success.
        FloatingPointError: NaN or infinity in observation, reward, ratio or gradient; the weights stay finite.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {
        "MlpPolicy": CriticFreePolicy,
        "CnnPolicy": CriticFreeCnnPolicy,
        "MultiInputPolicy": CriticFreeMultiInputPolicy,
    }
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
        group_filter: str = "mixed_success",
        stratified: bool = True,
        condition_sampler: ConditionSampler | None = None,
        scale_advantage: str = "group",
        scale_learning_rate: str = "none",
        loss_agg: str = "step",
        kl_coef: float = 0.0,
        anchor_coef: float = 0.0,
        target_kl: float | None = None,
        max_grad_norm: float = 0.5,
        max_episode_steps: int | None = None,
        timesteps: str = "active",
        resample_max: int = 0,
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
            gamma=1.0,
            gae_lambda=1.0,
            ent_coef=0.0,
            vf_coef=0.0,
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
        self.scale_advantage, self.scale_learning_rate, self.loss_agg = scale_advantage, scale_learning_rate, loss_agg
        self.kl_coef, self.anchor_coef, self.target_kl = kl_coef, anchor_coef, target_kl
        self.max_episode_steps, self.timesteps, self.resample_max = max_episode_steps, timesteps, resample_max

        # Made here and saved: a resumed run goes on with the stream instead of starting it again.
        streams = np.random.SeedSequence(seed).spawn(2)
        self.condition_rng, self.minibatch_rng = (np.random.default_rng(stream) for stream in streams)
        self.optimizer_steps = self.transitions_used = self.skipped_updates = 0
        self.last_group_success: NDArray[np.bool_] | None = None
        self.last_group_returns: Array | None = None
        self.last_group_strata: NDArray[np.int64] | None = None
        self.last_group_conditions: tuple[Any, ...] = ()
        self._saved_state: RandomState | None = None  # of a checkpoint, until training goes on
        self._iteration_start: RandomState | None = None
        self._dispatcher: EpisodeDispatcher | None = None
        self._conditions: ConditionSampler | None = None
        self._outcomes: GroupOutcomes | None = None
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        if not hasattr(self, "observation_space"):
            raise ValueError("FrontierGRPO needs an env to build its policy: pass an env id, an env or a VecEnv.")
        check_seed(self.seed)
        check_grpo_options(self)
        self.n_steps = self.n_groups * self.group_size
        super()._setup_model()
        high = self.clip_range if self.clip_range_high is None else self.clip_range_high
        self.clip_range, self.clip_range_high = FloatSchedule(self.clip_range), FloatSchedule(high)

    def _maybe_recommend_cpu(self, mlp_class_name: str = "CriticFreePolicy") -> None:
        super()._maybe_recommend_cpu(mlp_class_name)

    def _update_current_progress_remaining(self, num_timesteps: int, total_timesteps: int) -> None:
        """Keep progress at 0 or above: whole iterations overshoot the total, where no schedule is defined."""
        super()._update_current_progress_remaining(num_timesteps, total_timesteps)
        self._current_progress_remaining = max(0.0, self._current_progress_remaining)

    def _init_callback(self, callback: MaybeCallback, progress_bar: bool = False) -> BaseCallback:
        plain = super()._init_callback(callback, progress_bar=False)
        if not progress_bar:
            return plain
        both = CallbackList([plain, TimestepProgressBar()])
        both.init_callback(self)
        return both

    def learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int = 1,
        tb_log_name: str = "FrontierGRPO",
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> Self:
        """Train for at least `total_timesteps`, in whole iterations; arguments as in SB3.

        Raises:
            ValueError: `total_timesteps` below 1, NaN or infinite, or `log_interval` below 1.
            TypeError: Either is no number.
        """
        check_total_timesteps(total_timesteps)
        if log_interval is not None:
            check_whole("log_interval", log_interval, 1, "None logs nothing")
        return super().learn(total_timesteps, callback, log_interval, tb_log_name, reset_num_timesteps, progress_bar)

    def _setup_learn(
        self, total_timesteps: int, callback: MaybeCallback = None, reset_num_timesteps: bool = True, *args: Any
    ) -> tuple[int, BaseCallback]:
        if self.env is None:
            raise ValueError("This model has no env to learn in: call `set_env(env)`, or load it with `env=`.")
        self._dispatcher = EpisodeDispatcher(self.env, max_episode_steps=self.max_episode_steps)
        if not reset_num_timesteps and self._last_obs is None:
            # Below the wrappers: a resumed run must not count these observations in VecNormalize.
            self._last_obs = WrapperStack(self.env).base.reset()  # type: ignore[assignment]
        if self._saved_state is not None:
            self._saved_state.restore_normalisation(self.get_vec_normalize_env())
        prepared = super()._setup_learn(total_timesteps, callback, reset_num_timesteps, *args)
        if self._saved_state is not None and not reset_num_timesteps:
            self._saved_state.restore_torch(self.device)
        self._saved_state = None
        self._conditions = self._find_conditions(self.env)
        return prepared

    def _find_conditions(self, env: VecEnv) -> ConditionSampler:
        if self.condition_sampler is not None:
            return self.condition_sampler
        if env.has_attr("condition_sampler"):
            return env.get_attr("condition_sampler", indices=[0])[0]
        return SeedConditionSampler()

    def collect_rollouts(self, env: VecEnv, callback: BaseCallback, rollout_buffer: Any, n_rollout_steps: int) -> bool:
        """Run the N*K episodes of an iteration; `n_rollout_steps` plays no part.

        Returns:
            False when a callback stopped training.
        """
        assert self._conditions is not None
        assert self._dispatcher is not None
        self.policy.set_training_mode(False)
        rollout_buffer.reset()
        self._iteration_start = self._random_state()
        if self.use_sde:
            self.policy.reset_noise(env.num_envs)
        callback.on_rollout_start()
        sampler = StratifiedSampler(self.n_groups, self.group_size, stratified=self.stratified)
        episodes: dict[int, FinishedEpisode] = {}
        with Stopwatch() as watch, self._dispatcher.lent():
            groups = fresh = sampler.draw(self._conditions, self.condition_rng)
            for attempt in range(1 + self.resample_max):
                goes_on = run_jobs(
                    self,
                    sampler.jobs(fresh),
                    episodes,
                    dispatcher=self._dispatcher,
                    env=env,
                    callback=callback,
                    rollout_buffer=rollout_buffer,
                )
                if not goes_on:
                    return False
                kept = GroupOutcomes.of(fresh, episodes, self.group_size).kept(self.group_filter)
                strata = [group.stratum for group, keep in zip(fresh, kept, strict=True) if not keep]
                if attempt == self.resample_max or not strata:
                    break
                fresh = sampler.draw(self._conditions, self.condition_rng, strata=strata, first_index=len(groups))
                groups = groups + fresh
        self.logger.record("frontier/idle_share", self._dispatcher.idle_share)
        rollout_buffer.finish()
        self._outcomes = GroupOutcomes.of(groups, episodes, self.group_size)
        self._note_iteration(GroupOutcomes.of(groups[: self.n_groups], episodes, self.group_size))
        warn_of_unknown_success(self._outcomes, self)
        self.logger.record("frontier/groups_run", len(groups))
        watch.log(self.logger, "collect")
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    def _note_iteration(self, outcomes: GroupOutcomes) -> None:
        """Keep and log the outcomes of the N conditions drawn first: replacements would bias success by stratum."""
        self.last_group_success, self.last_group_returns = outcomes.success, outcomes.returns
        self.last_group_strata, self.last_group_conditions = outcomes.strata, outcomes.conditions
        self.logger.record("frontier/share_kept", float(outcomes.kept(self.group_filter).mean()))
        outcomes.log(self.logger)

    def train(self) -> None:
        """Update the policy on the kept groups; without any, change nothing but the counters."""
        assert self._outcomes is not None
        with Stopwatch() as watch:
            keep = self._outcomes.kept(self.group_filter)
            advantages = np.zeros_like(self._outcomes.returns)
            advantages[keep] = group_advantages(self._outcomes.returns[keep], scale=self.scale_advantage)
            kept = self.rollout_buffer.keep(keep, advantages, loss_agg=self.loss_agg)
            if len(kept):
                self.policy.set_training_mode(True)
                self._set_learning_rate()
                settings = self._settings()
                report = update_policy(
                    self.policy, kept, settings, rng=self.minibatch_rng, anchored=self._anchored(keep)
                )
                self._log_update(report)
            else:
                self.skipped_updates += 1
        self.transitions_used += len(kept)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/optimizer_steps", self.optimizer_steps)
        self.logger.record("frontier/transitions_used", self.transitions_used)
        self.logger.record("frontier/share_transitions_used", len(kept) / self.rollout_buffer.size())
        self.logger.record("frontier/skipped_updates", self.skipped_updates)
        watch.log(self.logger, "optimize")
        self._iteration_start = None

    def _set_learning_rate(self) -> None:
        """Set the scheduled rate, times the share of failures where the option asks for it."""
        rate = scheduled("learning_rate", self.lr_schedule, self._current_progress_remaining)
        if self.scale_learning_rate == "failures" and self.last_group_success is not None:
            rate *= 1.0 - float(self.last_group_success.mean())
        update_learning_rate(self.policy.optimizer, rate)
        self.logger.record("train/learning_rate", rate)

    def _anchored(self, keep: NDArray[np.bool_]) -> KeptTransitions | None:
        """Return the transitions of the groups that were dropped because they succeeded throughout."""
        outcomes = self._outcomes
        if not self.anchor_coef or outcomes is None or outcomes.success is None:
            return None
        return self.rollout_buffer.keep(outcomes.success.all(axis=1) & ~keep, np.zeros_like(outcomes.returns))

    def _settings(self) -> UpdateSettings:
        progress = self._current_progress_remaining
        return UpdateSettings(
            n_epochs=self.n_epochs,
            batch_size=self.batch_size,
            clip_low=scheduled("clip_range", self.clip_range, progress),
            clip_high=scheduled("clip_range_high", self.clip_range_high, progress),
            kl_coef=self.kl_coef,
            anchor_coef=self.anchor_coef,
            target_kl=self.target_kl,
            max_grad_norm=self.max_grad_norm,
        )

    def _log_update(self, report: UpdateReport) -> None:
        self._n_updates += report.n_epochs
        self.optimizer_steps += report.optimizer_steps
        self.logger.record("train/loss", report.loss)
        self.logger.record("train/policy_gradient_loss", report.policy_gradient_loss)
        self.logger.record("train/approx_kl", report.approx_kl)
        self.logger.record("train/clip_fraction", report.clip_fraction)
        if hasattr(self.policy, "log_std"):
            self.logger.record("train/std", th.exp(self.policy.log_std).mean().item())

    def save(
        self,
        path: str | Path | io.BufferedIOBase,
        exclude: Iterable[str] | None = None,
        include: Iterable[str] | None = None,
    ) -> None:
        """Save as SB3 does, but so that a kill leaves either the old file or the new one.

        Random states are saved too, and VecNormalize's statistics of observations, which the next `learn` of the loaded
        model gives to its env. Inside an iteration (a callback's checkpoint) they and `num_timesteps` are those
        of its start: a resumed run repeats the iteration that was cut short, and so goes on bit for bit.
        """
        with self._as_of_iteration_start():
            if not isinstance(path, (str, Path)):
                super().save(path, exclude, include)
                return
            target = Path(path) if Path(path).suffix else Path(f"{path}.zip")
            target.parent.mkdir(parents=True, exist_ok=True)
            whole = io.BytesIO()
            super().save(whole, exclude, include)
            atomic_write(target, whole.getvalue())

    def _excluded_save_params(self) -> list[str]:
        transient = ["_dispatcher", "_conditions", "_outcomes", "_iteration_start", "last_group_conditions"]
        return super()._excluded_save_params() + transient

    def _random_state(self) -> RandomState:
        streams = (self.condition_rng, self.minibatch_rng)
        return RandomState.of(streams, self.device, self.num_timesteps, self.get_vec_normalize_env())

    @contextmanager
    def _as_of_iteration_start(self) -> Iterator[None]:
        now, before = self._random_state(), self._saved_state
        state = self._iteration_start or before or now
        streams = (self.condition_rng, self.minibatch_rng)
        state.restore_generators(streams)
        self.num_timesteps, self._saved_state = state.num_timesteps, state
        try:
            yield
        finally:
            now.restore_generators(streams)
            self.num_timesteps, self._saved_state = now.num_timesteps, before
