"""Passes observations through a stack of VecEnv wrappers when only some rows are in an episode.

The wrappers of Stable-Baselines3 treat all rows of a step alike. When envs idle, VecNormalize would count their
repeated observations and VecMonitor their steps. So the innermost VecEnv is stepped directly, and what each wrapper
does to observations is applied here, to live rows only.
"""

from __future__ import annotations

import warnings
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import (
    VecCheckNan,
    VecEnv,
    VecEnvWrapper,
    VecExtractDictObs,
    VecMonitor,
    VecNormalize,
    VecTransposeImage,
    VecVideoRecorder,
)

Observations = np.ndarray[Any, Any] | dict[str, np.ndarray[Any, Any]]
Rows = NDArray[np.intp]


def take_rows(obs: Observations, rows: Any) -> Observations:
    """Return the given rows of a batch of observations."""
    return {key: part[rows] for key, part in obs.items()} if isinstance(obs, dict) else obs[rows]


def put_rows(obs: Observations, rows: Any, values: Observations) -> None:
    """Write rows into a batch of observations, in place.

    Args:
        obs: The batch.
        rows: Index of one row, or indices of several.
        values: What to write, one row or several.
    """
    if isinstance(obs, dict):
        for key, part in obs.items():
            part[rows] = cast(dict[str, Any], values)[key]
    else:
        obs[rows] = values


class WrapperStack:
    """The wrappers around a VecEnv, applied row by row.

    VecNormalize counts the observations that a policy acts on: no idle rows, no terminal observations. Its reward
    normalisation is left out, since it would give equal successes unequal returns.

    Args:
        env: A VecEnv, wrapped or not. Known wrappers are VecNormalize, VecTransposeImage, VecExtractDictObs,
            VecMonitor, VecCheckNan and VecVideoRecorder.

    Raises:
        ValueError: A wrapper whose effect on observations is not known.
    """

    def __init__(self, env: VecEnv) -> None:
        self.wrappers: list[VecEnvWrapper] = []  # innermost first
        while isinstance(env, VecEnvWrapper):
            self.wrappers.insert(0, env)
            env = env.venv
        self.base: VecEnv = env
        known = (VecNormalize, VecTransposeImage, VecExtractDictObs, VecMonitor, VecCheckNan, VecVideoRecorder)
        for wrapper in self.wrappers:
            if not isinstance(wrapper, known):
                raise ValueError(
                    f"Whole-episode sampling cannot step through {type(wrapper).__name__}: it may keep state that idle "
                    f"envs would disturb. Known are {', '.join(k.__name__ for k in known)}; for anything else use a "
                    "gymnasium wrapper around the single env (`wrapper_class` of make_vec_env)."
                )
            if isinstance(wrapper, VecNormalize) and wrapper.norm_reward:
                warnings.warn(
                    "VecNormalize(norm_reward=True) is ignored: equal episodes of a group must earn equal returns. "
                    "Pass norm_reward=False.",
                    UserWarning,
                    stacklevel=3,
                )

    def observe(self, raw: Observations, counted: Rows) -> Observations:
        """Turn the innermost observations into those a policy sees.

        Args:
            raw: Observations of the innermost VecEnv, one row per env.
            counted: Rows that VecNormalize counts in its statistics.
        """
        obs = raw
        for wrapper in self.wrappers:
            if isinstance(wrapper, VecNormalize):
                wrapper.old_obs = obs
                if wrapper.training and wrapper.norm_obs and len(counted):
                    _count(wrapper, take_rows(obs, counted))
            obs = _transform(wrapper, obs)
        return obs

    def peek(self, raw: Observations) -> Observations:
        """Transform a single observation, for instance a terminal one, without counting it."""
        for wrapper in self.wrappers:
            raw = _transform(wrapper, raw)
        return raw

    def film(self) -> None:
        """Let every VecVideoRecorder count a step and record its frame."""
        for wrapper in self.wrappers:
            if isinstance(wrapper, VecVideoRecorder):
                venv, wrapper.venv = wrapper.venv, cast(VecEnv, _SteppedAlready)
                try:
                    wrapper.step_wait()
                finally:
                    wrapper.venv = venv

    def report_episode(self, episode: dict[str, Any], info: dict[str, Any]) -> None:
        """Record a finished episode in every VecMonitor; one that was cut off may lack some of the info keywords."""
        for wrapper in self.wrappers:
            if isinstance(wrapper, VecMonitor):
                wrapper.episode_count += 1
                if wrapper.results_writer:
                    extra = {
                        key: info.get(key, False if key == "is_success" else None) for key in wrapper.info_keywords
                    }
                    wrapper.results_writer.write_row(episode | extra)


class _SteppedAlready:
    """Replaces the VecEnv below a recorder, since the innermost one has been stepped already."""

    @staticmethod
    def step_wait() -> tuple[None, None, None, None]:
        return None, None, None, None


def _transform(wrapper: VecEnvWrapper, obs: Observations) -> Observations:
    if isinstance(wrapper, VecNormalize):
        return wrapper.normalize_obs(obs)
    if isinstance(wrapper, VecTransposeImage):
        return wrapper.transpose_observations(obs)
    if isinstance(wrapper, VecExtractDictObs):
        return cast(Observations, cast(dict[str, Any], obs)[wrapper.key])
    return obs


def _count(wrapper: VecNormalize, rows: Observations) -> None:
    if isinstance(rows, dict):
        for key, statistics in cast(dict[str, Any], wrapper.obs_rms).items():
            statistics.update(rows[key])
    else:
        wrapper.obs_rms.update(rows)
