"""Learn a small network from demonstrations, and measure it in the task's env.

    dynaforge collect --task can --policy runs/can-1/policy.safetensors --demos 200
    python results/small_imitator.py data/can
    dynaforge evaluate --task can --learner results/small_imitator.py:load --seeds 1 --attempts 60

The network maps one control step to the joint targets of the next 16, of which 4 are executed before it is asked
again. If it predicted one step at a time, it would copy how slowly the hand starts to move, and never start.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch as th
from numpy.typing import NDArray
from safetensors.torch import load_file, save_file
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from tqdm import trange

from dynaforge import ActionLayout, DemonstrationDataset, read_frames

PREDICTED, EXECUTED = 16, 4  # control steps
HIDDEN = 512
WEIGHTS = Path("runs/small-imitator")


def network_input(observation: Mapping[str, NDArray[np.float32]], step: float) -> NDArray[np.float32]:
    """Return what the network sees: robot, objects, where each of them is from the hand, and the time."""
    hand = observation["ee_position"]
    offsets = [value - hand for name, value in sorted(observation.items()) if name.endswith("_position")]
    measured = [observation[name] for name in ("state", "dq", "object_state")]
    return np.concatenate([*measured, *offsets, [step / 100]])


def network(n_inputs: int, n_outputs: int) -> nn.Sequential:
    """Make three hidden layers between two fixed ones, which scale inputs and outputs."""
    hidden = [layer for _ in range(2) for layer in (nn.Linear(HIDDEN, HIDDEN), nn.SiLU())]
    scale_in, scale_out = nn.Linear(n_inputs, n_inputs), nn.Linear(n_outputs, n_outputs)
    for fixed in (scale_in, scale_out):
        fixed.requires_grad_(False)
    return nn.Sequential(
        scale_in, nn.Linear(n_inputs, HIDDEN), nn.SiLU(), *hidden, nn.Linear(HIDDEN, n_outputs), scale_out
    )


def samples(folder: Path) -> tuple[th.Tensor, th.Tensor]:
    """Return inputs and outputs of every control step: what is seen, and where the joints go from where they are."""
    inputs, outputs = [], []
    for frames in read_frames(DemonstrationDataset(folder), fps=30, actions="joint"):
        columns = frames.robot | frames.objects | {"state": frames.state, "object_state": frames.object_state}
        for k in range(len(frames)):
            inputs.append(network_input({name: column[k] for name, column in columns.items()}, k))
            chunk = frames.actions[np.minimum(np.arange(k, k + PREDICTED), len(frames) - 1)].copy()
            chunk[:, :7] -= frames.robot["q"][k]
            outputs.append(chunk.ravel())
    return th.tensor(np.array(inputs), dtype=th.float32), th.tensor(np.array(outputs), dtype=th.float32)


def train(folder: Path, updates: int, seed: int) -> nn.Module:
    """Fit the network to the demonstrations, and return the moving average of its weights."""
    th.set_num_threads(1)
    th.manual_seed(seed)
    inputs, outputs = samples(folder)
    net = network(inputs.shape[1], outputs.shape[1])
    with th.no_grad():
        for layer, data, inverse in ((net[0], inputs, True), (net[-1], outputs, False)):
            std, mean = data.std(0) + 1e-3, data.mean(0)
            layer.weight.copy_(th.diag(1 / std if inverse else std))
            layer.bias.copy_(-mean / std if inverse else mean)
    optimizer = th.optim.AdamW([p for p in net.parameters() if p.requires_grad], lr=2e-3, weight_decay=1e-4)
    schedule = th.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, updates)
    average = AveragedModel(net, multi_avg_fn=get_ema_multi_avg_fn(0.995))
    std = outputs.std(0) + 1e-3
    for _ in (bar := trange(updates)):
        rows = th.randint(len(inputs), (256,))
        loss = (((net(inputs[rows]) - outputs[rows]) / std) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        average.update_parameters(net)
        bar.set_postfix_str(f"loss {loss.item():.4f}", refresh=False)
    return average.module


class SmallImitator:
    """A policy for `--learner`, in the terms of an export with joint actions."""

    layout = ActionLayout("joint")

    def __init__(self, weights: Path) -> None:
        state = load_file(weights)
        self.net = network(len(state["0.bias"]), len(next(reversed(state.values()))))
        self.net.load_state_dict(state)

    def reset(self) -> None:
        """Forget the last episode."""
        self.step, self.chunk = 0, np.empty((0, 8))

    def __call__(self, observation: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        """Return the joint targets and the width of this control step, shape (8,)."""
        if not len(self.chunk):
            with th.no_grad():
                predicted = self.net(th.tensor(network_input(observation, self.step), dtype=th.float32))
            self.chunk = predicted.numpy().reshape(PREDICTED, 8)[:EXECUTED]
            self.chunk[:, :7] += observation["q"]
        self.step += 1
        action, self.chunk = self.chunk[0], self.chunk[1:]
        return action


def load(task: str) -> SmallImitator:
    """Load the network that was trained for a task."""
    return SmallImitator(WEIGHTS / f"{task}.safetensors")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="a dataset of `dynaforge collect`")
    parser.add_argument("--updates", type=int, default=6000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    trained = train(options.folder, options.updates, options.seed)
    WEIGHTS.mkdir(parents=True, exist_ok=True)
    save_file(trained.state_dict(), WEIGHTS / f"{DemonstrationDataset(options.folder).task}.safetensors")
