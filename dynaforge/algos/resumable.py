"""SB3's on-policy algorithm with what makes a saved model resume bit for bit."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.type_aliases import MaybeCallback

from dynaforge.algos.options import check_learn_arguments
from dynaforge.algos.progress import TimestepProgressBar
from dynaforge.algos.random_state import RandomState
from dynaforge.files.atomic import atomic_write
from dynaforge.sampling.frontier_strata import StratumRecord
from dynaforge.sampling.vec_wrappers import WrapperStack


class ResumableAlgorithm(OnPolicyAlgorithm):
    """An on-policy algorithm of whole iterations, which can be saved at any moment and resumes as if never stopped.

    Attributes:
        condition_rng: Generator that conditions are drawn from.
        minibatch_rng: Generator that minibatches are shuffled with.
        noise_entropy: Number from which noise by job is seeded; of the seed, or random without one.
        stratum_record: Success of each stratum; None where strata are drawn without regard to it.
    """

    noise_entropy: int
    stratum_record: StratumRecord | None
    condition_rng: np.random.Generator
    minibatch_rng: np.random.Generator

    def _seed_generators(self, seed: int | None) -> None:
        # They are saved with the model: a resumed run continues its streams instead of repeating them. There are
        # two, so that the conditions drawn do not depend on how many minibatches were shuffled.
        root = np.random.SeedSequence(seed)
        streams = root.spawn(2)
        self.noise_entropy = int(root.entropy)  # type: ignore[arg-type]
        self.condition_rng, self.minibatch_rng = (np.random.default_rng(stream) for stream in streams)
        self._iteration_start: RandomState | None = None
        self._saved_state: RandomState | None = None  # of the file this model was loaded from, until `learn`

    def _begin_iteration(self) -> None:
        self._iteration_start = RandomState.of(self)

    def _end_iteration(self) -> None:
        self._iteration_start = None

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
        tb_log_name: str | None = None,
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> Self:
        """Train for at least `total_timesteps`, in whole iterations; arguments as in SB3.

        Without `tb_log_name`, TensorBoard shows the run under the name of the class.

        Raises:
            ValueError: `total_timesteps` below 1, NaN or infinite, or `log_interval` below 1.
            TypeError: Either is no number.
        """
        check_learn_arguments(total_timesteps, log_interval)
        name = type(self).__name__ if tb_log_name is None else tb_log_name
        return super().learn(total_timesteps, callback, log_interval, name, reset_num_timesteps, progress_bar)

    def _setup_learn(
        self, total_timesteps: int, callback: MaybeCallback = None, reset_num_timesteps: bool = True, *args: Any
    ) -> tuple[int, BaseCallback]:
        assert self.env is not None
        if not reset_num_timesteps and self._last_obs is None:
            # Reset below the wrappers: a resumed run must not count these observations in VecNormalize.
            self._last_obs = WrapperStack(self.env).base.reset()  # type: ignore[assignment]
        if self._saved_state is not None:
            self._saved_state.restore_normalisation(self.get_vec_normalize_env())
        prepared = super()._setup_learn(total_timesteps, callback, reset_num_timesteps, *args)
        if self._saved_state is not None and not reset_num_timesteps:
            self._saved_state.restore_torch(self.device)  # last: SB3 draws from torch's generator meanwhile
        self._saved_state = None
        return prepared

    def save(
        self,
        path: str | Path | io.BufferedIOBase,
        exclude: Iterable[str] | None = None,
        include: Iterable[str] | None = None,
    ) -> None:
        """Save as SB3 does, but so that a kill leaves either the old file or the new one; arguments as in SB3.

        Random states are saved too, and VecNormalize's statistics of observations, which the next `learn` of the loaded
        model gives to its env. Inside an iteration (a callback's checkpoint) they and `num_timesteps` are those
        of its start: a resumed run repeats the iteration that was cut short, and so ends bit for bit the same.
        """
        with self.as_of_iteration_start():
            if not isinstance(path, (str, Path)):
                super().save(path, exclude, include)
                return
            target = Path(path) if Path(path).suffix else Path(f"{path}.zip")
            target.parent.mkdir(parents=True, exist_ok=True)
            archive = io.BytesIO()
            super().save(archive, exclude, include)
            atomic_write(target, archive.getvalue())

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "_iteration_start"]

    @contextmanager
    def as_of_iteration_start(self) -> Iterator[RandomState]:
        """Set random streams and step count back to the start of the iteration under way, for a block that saves."""
        now, before = RandomState.of(self), self._saved_state
        state = self._iteration_start or before or now
        state.restore_generators(self)
        self._saved_state = state
        try:
            yield state
        finally:
            now.restore_generators(self)
            self._saved_state = before

    def resume_from(self, state: RandomState) -> None:
        """Continue from a state that `as_of_iteration_start` gave: the generators now, the rest at the next `learn`."""
        state.restore_generators(self)
        self._saved_state = state
