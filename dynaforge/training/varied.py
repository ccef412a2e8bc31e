"""What `compare --vary` may set, and to which values: what needs no model to be refused."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

from dynaforge.algos.options import WHOLE_NUMBERS, check_number, check_whole

SET_OTHERWISE = {
    "n_timesteps": "what --steps says, for all variants alike",
    "seed": "counted up by --train-seeds",
    "device": "the CPU, one core per run",
    "env": "what --task says",
    "verbose": "no setting of training",
    "tensorboard_log": "no setting of training; the history of each run is stored beside it",
}

WHOLE = {name: (least, why) for name, least, why in WHOLE_NUMBERS} | {
    "n_envs": (1, "episodes run in them"),
    "n_steps": (1, "an update needs a step"),
}
SHARES = ("gamma", "gae_lambda")
NUMBERS = ("learning_rate", "clip_range", "clip_range_high", "ent_coef", "vf_coef", "max_grad_norm", *SHARES)


def check_varied(setting: str, values: Iterable[str]) -> None:
    """Refuse a setting that the command sets itself, and values out of range.

    Raises:
        ValueError: Names --vary, the setting and the value.
    """
    if setting in SET_OTHERWISE:
        raise ValueError(f"--vary: {setting} is {SET_OTHERWISE[setting]}")
    for text in values:
        value = parsed_value(text)
        try:
            if setting in WHOLE and value is not None:
                check_whole(setting, value, *WHOLE[setting])
            elif setting in NUMBERS and value is not None and not str(value).startswith("lin_"):
                check_number(setting, value)
            if setting in SHARES and isinstance(value, int | float) and value > 1:
                raise ValueError(f"{setting} is {value}, but must be at most 1.")
        except (TypeError, ValueError) as error:
            raise ValueError(f"--vary: {error}") from None


def parsed_value(text: str) -> Any:
    """Return what a value of --vary means: JSON where it is some, a word otherwise.

    Raises:
        ValueError: No finite number.
    """
    try:
        parsed = json.loads(text)
    except (json.JSONDecodeError, RecursionError):
        return text
    if isinstance(parsed, float) and not math.isfinite(parsed):
        raise ValueError(f"--vary: {text!r} is no finite number.")
    return parsed
