"""Flags and hyperparameter files that are refused before rl_zoo3 is imported or anything is made."""

from __future__ import annotations

import argparse
import importlib.util
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from dynaforge.algos.options import LARGEST_SEED
from dynaforge.training.settings import entry_of


def check_flags(script: str, asked: argparse.Namespace, *, named_env: bool) -> None:
    """Refuse numbers out of range, a log folder that is a file, and a training of nothing in particular.

    Args:
        script: The script of rl_zoo3.
        asked: Its flags, read.
        named_env: Whether the env was given.

    Raises:
        ValueError: Names the flag.
    """
    if script == "train" and not named_env:
        raise ValueError("name an env, as in: dynaforge train --algo frontier_grpo --env DynaForge/Can-v0")
    n = asked.n_timesteps
    if n is not None and n != -1 and n < 1:  # -1 is rl_zoo3's word for "as the hyperparameters say"
        raise ValueError(f"-n is {n}; it must be at least 1. Leave it out for the steps that the hyperparameters say")
    if asked.seed is not None and not -1 <= asked.seed <= LARGEST_SEED:  # and here for "draw one"
        raise ValueError(f"--seed is {asked.seed}; it must be from 0 to {LARGEST_SEED}, or -1 to have one drawn")
    if asked.folder is not None and Path(asked.folder).exists() and not Path(asked.folder).is_dir():
        raise ValueError(f"-f {asked.folder} is a file; name a folder")
    agent = asked.trained_agent
    if agent and not (agent.endswith(".zip") and Path(agent).is_file() and zipfile.is_zipfile(agent)):
        what = "is no checkpoint of Stable-Baselines3" if Path(agent).exists() else "does not exist"
        raise ValueError(f"-i {agent} {what}; name the .zip of a trained model")


def check_configuration(conf: str, env: str) -> None:
    """Refuse a file of hyperparameters that rl_zoo3 cannot read, or that lists nothing for the env.

    Files and packages in Python are code: they are left to rl_zoo3, which runs them.

    Raises:
        ValueError: Names the file and what is wrong.
    """
    path = Path(conf)
    if conf.endswith((".yml", ".yaml", ".py")):
        if not path.is_file():
            raise ValueError(f"no hyperparameter file {conf!r}; leave -conf out for the installed one")
        if conf.endswith(".py"):
            return
        try:
            listed = yaml.safe_load(path.read_text(encoding="utf-8"))
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ValueError(f"-conf {conf} is no YAML: {error}") from error
        _check_entry(conf, listed, env)
        return
    try:
        found = importlib.util.find_spec(conf) is not None and not path.is_dir()
    except (ImportError, ValueError):
        found = False
    if not found:
        what = "is a folder" if path.is_dir() else "is neither a file that ends in .yml or .py nor a package"
        raise ValueError(f"-conf {conf} {what}; leave -conf out for the installed file")


def _check_entry(conf: str, listed: Any, env: str) -> None:
    if not isinstance(listed, dict):
        raise ValueError(f"-conf {conf} holds {type(listed).__name__}, expected hyperparameters by env id")
    name = entry_of(listed, env)
    if name is None:
        known = ", ".join(map(str, listed)) or "nothing"
        raise ValueError(f"-conf {conf} lists {known}, and neither {env} nor a default")
    entry = listed[name]
    if not isinstance(entry, dict) or not all(isinstance(key, str) for key in entry):
        raise ValueError(f"-conf {conf}: {name} holds {type(entry).__name__}, expected hyperparameters by name")
    for key in ("n_timesteps", "policy"):
        if key not in entry:
            raise ValueError(f"-conf {conf}: {name} lacks {key}")


def check_schedules(hyperparameters: Mapping[str, Any]) -> None:
    """Refuse a rate or a clip range that is neither a number in range nor "lin_NUMBER".

    Raises:
        ValueError: Names the hyperparameter.
    """
    for name in ("learning_rate", "clip_range", "clip_range_high"):
        value = hyperparameters.get(name)
        if not isinstance(value, str | int | float):
            continue
        try:
            number = float(value.removeprefix("lin_") if isinstance(value, str) else value)
            good = 0.0 <= number < float("inf") and (not isinstance(value, str) or value.startswith("lin_"))
        except ValueError:
            good = False
        if not good:
            raise ValueError(f"{name} is {value!r}; write a number, or lin_NUMBER for one that falls to 0 over the run")
