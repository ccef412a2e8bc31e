"""The options of FrontierGRPO: the values that each may have, and checks with messages for the user."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any, Literal, get_args

GroupFilter = Literal["mixed_success", "margin", "mixed_return", "none"]
AdvantageScale = Literal["group", "batch", "learnability", "none"]
StratumWeights = Literal["equal", "frontier"]
RateScale = Literal["none", "failures"]
LossAggregation = Literal["step", "episode"]
Exploration = Literal["stream", "job"]
TimestepCount = Literal["active", "gated", "nominal"]

CHOICES = {
    "group_filter": GroupFilter,
    "stratum_weights": StratumWeights,
    "scale_advantage": AdvantageScale,
    "scale_learning_rate": RateScale,
    "loss_agg": LossAggregation,
    "exploration": Exploration,
    "timesteps": TimestepCount,
}
LARGEST_SEED = 2**32 - 1  # of numpy's global generator, which Stable-Baselines3 seeds

# Option, smallest value, why. Those in OPTIONAL may also be None.
WHOLE_NUMBERS = (
    ("group_size", 2, "a lone rollout has nothing to be compared with"),
    ("n_groups", 1, "an update needs a condition"),
    ("n_epochs", 1, "an update passes over its transitions at least once"),
    ("resample_max", 0, "it is a number of rounds"),
    ("batch_size", 1, "use None for the whole update at once"),
    ("max_episode_steps", 1, "use None for no cap"),
    ("sde_sample_freq", -1, "-1 is once an episode"),
    ("_stats_window_size", 1, "means are taken over that many episodes"),
)
WEIGHTS = ("kl_coef", "anchor_coef", "rim_coef")
OPTIONAL = ("batch_size", "max_episode_steps")


def check_choice(name: str, given: object) -> None:
    """Refuse a value that an option of `CHOICES` does not have.

    Raises:
        ValueError: Names what was given, the valid names, and the closest of them.
    """
    valid: Sequence[str] = get_args(CHOICES[name])
    if given in valid:
        return
    close = difflib.get_close_matches(str(given), valid, n=1, cutoff=0.5)
    hint = f" Did you mean {close[0]!r}?" if close else ""
    raise ValueError(f"Unknown {name} {given!r}.{hint} Valid are {', '.join(map(repr, valid))}.")


def check_whole(name: str, given: object, least: int, why: str) -> None:
    """Refuse what is no whole number, or too small.

    Args:
        name: The option.
        given: Its value.
        least: Its smallest value.
        why: Why it may not be smaller, for the message.

    Raises:
        TypeError: No whole number.
        ValueError: Too small. Both name the option, the value and what is expected.
    """
    if not isinstance(given, Integral) or isinstance(given, bool):
        raise TypeError(f"{name} is {given!r}, but must be a whole number of at least {least}: {why}.")
    if int(given) < least:
        raise ValueError(f"{name} is {given}, but must be at least {least}: {why}.")


def check_number(name: str, given: object, *, above: float | None = None, finite: bool = True) -> None:
    """Refuse what is no number, NaN, negative, or not above a bound.

    Args:
        name: The option.
        given: Its value.
        above: Bound that it must exceed; None allows 0.
        finite: Whether infinity is refused.

    Raises:
        TypeError: No number.
        ValueError: Out of range. Both name the option, the value and what is expected.
    """
    expected = "at least 0" if above is None else f"above {above:g}"
    if not isinstance(given, Real) or isinstance(given, bool):
        raise TypeError(f"{name} is {given!r}, but must be a number {expected}.")
    value = float(given)
    if math.isnan(value) or (finite and math.isinf(value)) or value < 0.0 or (above is not None and value <= above):
        raise ValueError(f"{name} is {given}, but must be {'a finite number ' if finite else ''}{expected}.")


def check_schedule(name: str, given: object, *, above: float | None = None) -> None:
    """Refuse what is neither a number in range nor a function of the remaining progress.

    Args:
        name: The option.
        given: Its value.
        above: Bound that a number must exceed; None allows 0.

    Raises:
        TypeError: Neither.
        ValueError: A number out of range.
    """
    if callable(given):
        return
    if not isinstance(given, Real):
        raise TypeError(f"{name} is {given!r}, but must be a number or a function of the remaining progress, 1 to 0.")
    check_number(name, given, above=above, finite=above is None)


def scheduled(name: str, schedule: Any, progress: float) -> float:
    """Evaluate a schedule.

    Args:
        name: The option, for the message.
        schedule: Function of the remaining progress.
        progress: Remaining progress, from 1 at the start to 0 at the end.

    Raises:
        ValueError: NaN, infinity or a negative number.
    """
    value = float(schedule(progress))
    if not math.isfinite(value) or value < 0.0:
        raise ValueError(
            f"The schedule of {name} gives {value} at remaining progress {progress:g}; expected 0 or more."
        )
    return value


def check_seed(seed: object, name: str = "seed") -> None:
    """Refuse a seed that numpy's global generator, which Stable-Baselines3 seeds, does not take.

    Raises:
        TypeError: No whole number.
        ValueError: Negative or too large.
    """
    if seed is None:
        return
    if not isinstance(seed, Integral) or isinstance(seed, bool):
        raise TypeError(f"{name} is {seed!r}, but must be a whole number from 0 to {LARGEST_SEED}, or None.")
    if not 0 <= int(seed) <= LARGEST_SEED:
        raise ValueError(f"{name} is {seed}, but must be from 0 to {LARGEST_SEED} (2**32 - 1).")


def check_total_timesteps(given: object) -> None:
    """Refuse to train for no time or without end.

    Raises:
        TypeError: No number.
        ValueError: Below 1, NaN or infinite.
    """
    if not isinstance(given, Real) or isinstance(given, bool):
        raise TypeError(f"total_timesteps is {given!r}, but must be a number of at least 1.")
    if not 1 <= float(given) < math.inf:
        raise ValueError(f"total_timesteps is {given}, but must be a finite number of at least 1.")


def check_learn_arguments(total_timesteps: object, log_interval: object) -> None:
    """Check what `FrontierGRPO.learn` is given.

    Raises:
        ValueError: `total_timesteps` below 1, NaN or infinite, or `log_interval` below 1.
        TypeError: Either is no number; `log_interval` may be None.
    """
    check_total_timesteps(total_timesteps)
    if log_interval is not None:
        check_whole("log_interval", log_interval, 1, "None logs nothing")


def check_grpo_options(model: Any) -> None:
    """Check the options of a FrontierGRPO model before anything is built from them.

    Raises:
        ValueError: Names the option, what was given and what is expected.
        TypeError: Likewise, for a value of the wrong type.
    """
    check_seed(model.seed)
    for name in CHOICES:
        check_choice(name, getattr(model, name))
    for name, least, why in WHOLE_NUMBERS:
        value = getattr(model, name)
        if value is not None or name not in OPTIONAL:
            check_whole(name.removeprefix("_"), value, least, why)
    if model.group_filter == "margin":
        check_whole("group_size", model.group_size, 4, "group_filter='margin' needs two successes and two failures")
    for name in WEIGHTS:
        check_number(name, getattr(model, name))
    check_number("max_grad_norm", model.max_grad_norm, above=0.0, finite=False)  # infinity never clips
    for name in ("target_kl", "desired_kl"):
        if getattr(model, name) is not None:
            check_number(name, getattr(model, name), above=0.0)
    check_schedule("learning_rate", model.learning_rate)
    check_schedule("clip_range", model.clip_range, above=0.0)  # at 0 the policy could not move
    if model.clip_range_high is not None:
        check_schedule("clip_range_high", model.clip_range_high, above=0.0)
    for name in ("stratified", "use_sde"):
        if not isinstance(getattr(model, name), bool):
            raise TypeError(f"{name} is {getattr(model, name)!r}, but must be True or False.")
    if model.stratum_weights == "frontier" and not model.stratified:
        raise ValueError("stratum_weights='frontier' draws from strata, and stratified=False leaves none.")
    sampler = model.condition_sampler
    if sampler is not None and not (hasattr(sampler, "draw") and hasattr(sampler, "reset_kwargs")):
        raise TypeError(
            f"condition_sampler is {sampler!r}, but must have `draw` and `reset_kwargs`; None takes the env's."
        )
