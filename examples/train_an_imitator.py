"""Train a small policy from point clouds: a pack of demonstrations, a PointNet, and 16 actions at a time.

dynaforge collect --task can --policy runs/can-1/policy.safetensors --demos 200 --out data/can
dynaforge render data/can --no-images --points 256
python examples/train_an_imitator.py data/can      # about four minutes; so few updates seldom win a moving can
dynaforge evaluate --task can --learner examples/train_an_imitator.py:load --observations data/can/observations
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_model, save_model
from torch import nn

from dynaforge import DemonstrationDataset, ObservationFolder, Pack, read_frames

WEIGHTS = Path("runs/imitator.safetensors")
PREDICTED, EXECUTED = 16, 8  # actions at a time, each of 9 numbers


class Imitator(nn.Module):
    def __init__(self) -> None:
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(3, 64), nn.ReLU(), nn.Linear(64, 128))
        self.head = nn.Sequential(nn.Linear(2 * 128 + 15, 256), nn.ReLU(), nn.Linear(256, PREDICTED * 9))

    def predict(self, clouds: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        """Map two clouds, which show how things move, and the robot's state to the next actions."""
        features = self.encoder(clouds).amax(dim=-2).flatten(-2)  # the order of the points does not matter
        return self.head(torch.cat((features, state), dim=-1)).unflatten(-1, (PREDICTED, 9))

    def reset(self) -> None:  # before each episode
        self.clouds, self.planned = [], []

    @torch.no_grad()
    def forward(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        self.clouds = [*self.clouds, observation["points"]][-2:]
        if not self.planned:
            clouds = torch.tensor(np.stack((self.clouds[0], self.clouds[-1])))
            self.planned = list(self.predict(clouds, torch.tensor(observation["state"])).numpy()[:EXECUTED])
        return self.planned.pop(0)


def load(task: str) -> Imitator:
    load_model(policy := Imitator(), WEIGHTS)
    return policy


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="a rendered dataset")
    parser.add_argument("--updates", type=int, default=3000)
    options = parser.parse_args()
    observations = ObservationFolder(options.folder / "observations")
    episodes = read_frames(DemonstrationDataset(options.folder), fps=30, observations=observations)
    pack = Pack.write(options.folder.with_name(f"{options.folder.name}-pack"), episodes)
    policy, rng = Imitator(), np.random.default_rng(0)
    optimizer = torch.optim.Adam(policy.parameters(), lr=1e-3)
    for update in range(options.updates):
        frames = rng.integers(len(pack), size=64)
        clouds, state, actions = (
            torch.tensor(np.stack([pack.window(name, k, before=before, after=after) for k in frames])).float()
            for name, before, after in (("points", 1, 0), ("state", 0, 0), ("action", 0, PREDICTED - 1))
        )
        loss = (policy.predict(clouds, state[:, 0]) - actions).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if update % 100 == 0:
            print(f"update {update}: mean error {loss.item():.4f}", flush=True)
    WEIGHTS.parent.mkdir(exist_ok=True)
    save_model(policy, WEIGHTS)
