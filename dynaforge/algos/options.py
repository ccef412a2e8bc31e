"""Checks of what a user passed, worded for the user."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import Any

GROUP_FILTERS = ("mixed_success", "mixed_return", "none")
ADVANTAGE_SCALES = ("group", "batch", "none")
RATE_SCALES = ("none", "failures")
LOSS_AGGREGATIONS = ("step", "episode")
TIMESTEP_COUNTS = ("active", "nominal")


def check_choice(name: str, given: object, valid: Sequence[str]) -> None:
    """Refuse a value that is not among the valid names.

    Raises:
        ValueError: Names what was given, the valid names, and the closest of them.
    """
    if given in valid:
        return
    close = difflib.get_close_matches(str(given), valid, n=1, cutoff=0.5)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    raise ValueError(f"Unknown {name} {given!r}.{hint} Valid are {', '.join(map(repr, valid))}.")


def check_at_least(name: str, given: float, least: float, why: str) -> None:
    """Refuse a number below its least sensible value.

    Raises:
        ValueError: Names the option, the value and the reason.
    """
    if not given >= least:
        raise ValueError(f"{name} is {given}, but must be at least {least}: {why}.")


def check_grpo_options(model: Any) -> None:
    """Check the options of a FrontierGRPO model, before anything is built from them.

    Raises:
        ValueError: Names the option, what was given and what is expected.
    """
    check_choice("group_filter", model.group_filter, GROUP_FILTERS)
    check_choice("scale_advantage", model.scale_advantage, ADVANTAGE_SCALES)
    check_choice("scale_learning_rate", model.scale_learning_rate, RATE_SCALES)
    check_choice("loss_agg", model.loss_agg, LOSS_AGGREGATIONS)
    check_choice("timesteps", model.timesteps, TIMESTEP_COUNTS)
    check_at_least("group_size", model.group_size, 2, "a lone rollout has nothing to be compared with")
    check_at_least("n_groups", model.n_groups, 1, "an update needs a condition")
    check_at_least("n_epochs", model.n_epochs, 1, "an update passes over its transitions at least once")
    check_at_least("resample_max", model.resample_max, 0, "it is a number of rounds")
    check_at_least("kl_coef", model.kl_coef, 0.0, "it is the weight of a penalty")
    check_at_least("anchor_coef", model.anchor_coef, 0.0, "it is the weight of a penalty")
    if model.batch_size is not None:
        check_at_least("batch_size", model.batch_size, 1, "use None for the whole update at once")
    if model.max_episode_steps is not None:
        check_at_least("max_episode_steps", model.max_episode_steps, 1, "use None for no cap")
    if not model.max_grad_norm > 0.0:
        raise ValueError(f"max_grad_norm is {model.max_grad_norm}, but must be above 0; float('inf') never clips.")
    for name in ("clip_range", "clip_range_high"):
        value = getattr(model, name)
        if isinstance(value, int | float) and not value > 0.0:
            raise ValueError(f"{name} is {value}, but must be above 0: the policy could not move.")
