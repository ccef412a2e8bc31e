"""Training checkpoints, as files that execute no code: tensors in safetensors, counters in the JSON header.

SB3's own `model.zip` is a pickle. A folder of `dynaforge compare` may come from anybody, so nothing in it is a pickle.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from stable_baselines3.common.base_class import BaseAlgorithm

from dynaforge.algos import FrontierGRPO
from dynaforge.algos.learning import learned_state, restore_learned_state
from dynaforge.algos.random_state import RandomState
from dynaforge.algos.residual_sac import ResidualSAC
from dynaforge.files.atomic import atomic_write

FORMAT = "dynaforge-checkpoint"
COUNTERS = ("num_timesteps", "_n_updates", "iterations", "optimizer_steps", "transitions_used", "skipped_updates")


def save_checkpoint(model: BaseAlgorithm, path: Path) -> None:
    """Write weights, optimizers, replay buffers, counters and random states, whole or not at all."""
    with _as_of_iteration_start(model) as random:
        counters = {name: getattr(model, name) for name in COUNTERS if hasattr(model, name)}
    header = {"format": FORMAT, "counters": counters, "generators": random.generators if random else []}
    tensors = {f"policy.{name}": tensor for name, tensor in model.policy.state_dict().items()}
    for prefix, optimizer in optimizers_of(model).items():
        for index, entries in optimizer.state_dict()["state"].items():
            tensors |= {f"{prefix}.{index}.{name}": tensor for name, tensor in entries.items()}
    tensors |= {f"random.{k}": tensor for k, tensor in enumerate(random.torch if random else ())}
    if isinstance(model, FrontierGRPO):
        tensors |= {f"learned.{name}": th.as_tensor(values) for name, values in learned_state(model).items()}
    if isinstance(model, ResidualSAC):
        tensors |= {f"replay.{name}": th.as_tensor(rows) for name, rows in model.replay_buffer.state().items()}
        if model.log_ent_coef is not None:
            tensors["log_ent_coef"] = model.log_ent_coef
    whole = {name: tensor.detach().cpu().clone().contiguous() for name, tensor in tensors.items()}
    atomic_write(path, save(whole, {"dynaforge": json.dumps(header)}))


def load_checkpoint(model: BaseAlgorithm, path: Path, *, seed: int) -> None:
    """Restore a model, built with the same settings, from a training checkpoint.

    FrontierGRPO then resumes bit for bit; PPO and SAC begin new episodes in place of those that were under way.

    Args:
        model: The model to restore.
        path: The checkpoint.
        seed: Training seed, from which these new episodes draw.

    Raises:
        ValueError: The file is not a training checkpoint, or belongs to another model.
    """
    try:
        with safe_open(str(path), framework="pt") as file:
            header = json.loads((file.metadata() or {})["dynaforge"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - no iterator of its own
        model.policy.load_state_dict(_below("policy", tensors))
        for prefix, optimizer in optimizers_of(model).items():
            _restore_optimizer(optimizer, _below(prefix, tensors))
        for name, count in header["counters"].items():
            if name not in COUNTERS or type(count) is not int:
                raise ValueError(f"{name} is {count!r}")
            setattr(model, name, count)
        if isinstance(model, FrontierGRPO):
            learned = {name: tensor.numpy() for name, tensor in _below("learned", tensors).items()}
            restore_learned_state(model, learned)
        if isinstance(model, ResidualSAC):
            model.replay_buffer.restore({name: rows.numpy() for name, rows in _below("replay", tensors).items()})
            if model.log_ent_coef is not None:
                model.log_ent_coef.data.copy_(tensors["log_ent_coef"])
        torch_states = tuple(_below("random", tensors).values())
        _restore_randomness(model, RandomState(tuple(header["generators"]), torch_states, model.num_timesteps), seed)
    except (SafetensorError, KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise ValueError(
            f"{path} is no checkpoint of this run, or is damaged ({' '.join(str(error).split())[:200]}). "
            "Remove it to train this run from the start."
        ) from error


def optimizers_of(model: BaseAlgorithm) -> dict[str, th.optim.Optimizer]:
    """Return a model's optimizers by name; the first makes a step in every optimizer step that is counted."""
    if not isinstance(model, ResidualSAC):
        return {"optimizer": model.policy.optimizer}
    found = {"critic_optimizer": model.critic.optimizer, "actor_optimizer": model.actor.optimizer}
    return found if model.ent_coef_optimizer is None else found | {"ent_coef_optimizer": model.ent_coef_optimizer}


@contextlib.contextmanager
def _as_of_iteration_start(model: BaseAlgorithm) -> Iterator[RandomState | None]:
    """Put a FrontierGRPO back to the start of the iteration under way, as its `save` does: resuming repeats it."""
    if isinstance(model, FrontierGRPO):
        with model.as_of_iteration_start() as state:
            yield state
    else:
        yield None


def _restore_optimizer(optimizer: th.optim.Optimizer, tensors: dict[str, th.Tensor]) -> None:
    state: dict[int, dict[str, th.Tensor]] = {}
    for name, tensor in tensors.items():
        index, _, entry = name.partition(".")
        state.setdefault(int(index), {})[entry] = tensor
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _restore_randomness(model: BaseAlgorithm, random: RandomState, seed: int) -> None:
    if isinstance(model, FrontierGRPO):
        model.resume_from(random)
        return
    fresh = np.random.SeedSequence((seed, model.num_timesteps)).generate_state(2)
    th.manual_seed(int(fresh[0]))
    np.random.seed(int(fresh[0]))  # noqa: NPY002 - SB3's PPO shuffles its minibatches with it
    if isinstance(model, ResidualSAC):
        model.replay_buffer.rng = np.random.default_rng(int(fresh[0]))
    assert model.env is not None
    model.env.seed(int(fresh[1]) // 2)


def _below(prefix: str, tensors: dict[str, Any]) -> dict[str, th.Tensor]:
    """Return the tensors whose names begin with a prefix and a dot, by the rest of their names."""
    start = f"{prefix}."
    return {name.removeprefix(start): tensor for name, tensor in tensors.items() if name.startswith(start)}
