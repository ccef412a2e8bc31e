"""What `compare --vary` may set, and to which values: the checks that need no model."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import Any

from dynaforge.algos.options import WHOLE_NUMBERS, check_number, check_whole

NOT_VARIED = {
    "n_timesteps": "what --steps says, for all variants alike",
    "seed": "counted up by --train-seeds",
    "device": "the CPU, one core per run",
    "env": "what --task says",
    "verbose": "no setting of training",
    "tensorboard_log": "no setting of training; the history of each run is stored beside it",
}

WHOLE_SETTINGS = {name: (least, why) for name, least, why in WHOLE_NUMBERS} | {
    "n_envs": (1, "episodes run in them"),
    "n_steps": (1, "an update needs a step"),
    "update_ratio": (1, "critics learn from what was collected"),
    "learning_starts": (0, "it is a number of environment steps"),
    "buffer_size": (1, "a batch is drawn from it"),
}
SHARES = ("gamma", "gae_lambda")
NUMBER_SETTINGS = ("learning_rate", "clip_range", "clip_range_high", "ent_coef", "vf_coef", "max_grad_norm", *SHARES)


def check_varied(setting: str, values: Iterable[str]) -> None:
    """Refuse a setting that the command sets itself, and values out of range.

    Args:
        setting: Name of the setting.
        values: Its values as they stand on the command line.

    Raises:
        ValueError: The message names --vary, the setting and the value.
    """
    if setting in NOT_VARIED:
        raise ValueError(f"--vary: {setting} is {NOT_VARIED[setting]}")
    for text in values:
        value = parsed_value(text)
        try:
            if setting in WHOLE_SETTINGS and value is not None:
                check_whole(setting, value, *WHOLE_SETTINGS[setting])
            elif setting in NUMBER_SETTINGS and value is not None and not str(value).startswith("lin_"):
                check_number(setting, value)
            if setting in SHARES and isinstance(value, int | float) and value > 1:
                raise ValueError(f"{setting} is {value}, but must be at most 1.")
        except (TypeError, ValueError) as error:
            raise ValueError(f"--vary: {error}") from None


def parsed_value(text: str) -> Any:
    """Return the value that a text of --vary stands for: its JSON value, or the text itself where it is not JSON.

    Raises:
        ValueError: It is infinite or NaN.
    """
    try:
        parsed = json.loads(text)
    except (json.JSONDecodeError, RecursionError):
        return text
    if isinstance(parsed, float) and not math.isfinite(parsed):
        raise ValueError(f"--vary: {text!r} is no finite number.")
    return parsed
