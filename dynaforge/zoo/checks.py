"""Checks of flags and hyperparameter files, before rl_zoo3 is imported or anything is created."""

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


def check_flags(script: str, options: argparse.Namespace, *, named_env: bool) -> None:
    """Refuse numbers out of range, a log folder that is a file, and training without a named env.

    Args:
        script: The script of rl_zoo3.
        options: Its parsed flags.
        named_env: Whether an env was named.

    Raises:
        ValueError: A flag is wrong; the message names it.
    """
    if script == "train" and not named_env:
        raise ValueError("name an env, as in: dynaforge train --algo frontier_grpo --env DynaForge/Can-v0")
    n = options.n_timesteps
    if n is not None and n != -1 and n < 1:  # -1 means "as the hyperparameters say" in rl_zoo3
        raise ValueError(f"-n is {n}; it must be at least 1. Leave it out for the steps that the hyperparameters say")
    if options.seed is not None and not -1 <= options.seed <= LARGEST_SEED:  # and here "draw one"
        raise ValueError(f"--seed is {options.seed}; it must be from 0 to {LARGEST_SEED}, or -1 to have one drawn")
    if options.folder is not None and Path(options.folder).exists() and not Path(options.folder).is_dir():
        raise ValueError(f"-f {options.folder} is a file; name a folder")
    agent = options.trained_agent
    if agent and not (agent.endswith(".zip") and Path(agent).is_file() and zipfile.is_zipfile(agent)):
        problem = "is no checkpoint of Stable-Baselines3" if Path(agent).exists() else "does not exist"
        raise ValueError(f"-i {agent} {problem}; name the .zip of a trained model")


def check_configuration(conf: str, env: str) -> None:
    """Refuse a file of hyperparameters that rl_zoo3 cannot read, or that lists nothing for the env.

    Python files and packages are left to rl_zoo3, which runs them.

    Raises:
        ValueError: The file cannot be used; the message names it and says why.
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
        problem = "is a folder" if path.is_dir() else "is neither a file that ends in .yml or .py nor a package"
        raise ValueError(f"-conf {conf} {problem}; leave -conf out for the installed file")


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
        ValueError: A hyperparameter is wrong; the message names it.
    """
    for name in ("learning_rate", "clip_range", "clip_range_high"):
        value = hyperparameters.get(name)
        if not isinstance(value, str | int | float):
            continue
        try:
            number = float(value.removeprefix("lin_") if isinstance(value, str) else value)
            valid = 0.0 <= number < float("inf") and (not isinstance(value, str) or value.startswith("lin_"))
        except ValueError:
            valid = False
        if not valid:
            raise ValueError(f"{name} is {value!r}; write a number, or lin_NUMBER for one that falls to 0 over the run")
