"""Why slow cans are lost: run shipped results under a wider tolerance along the can's axis, without retraining.

python examples/alignment_tolerance.py --across 0.012 0.03
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from itertools import islice

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Pose
from dynaforge.tasks import get_task
from dynaforge.tasks.view import PhaseView


@dataclass(frozen=True)
class AlignedAlong:
    """The hand is above the can: within `along` metres along its heading and `across` metres along its axis."""

    along: float
    across: float
    height: float = math.inf

    def __call__(self, view: PhaseView, target: Pose) -> bool:
        frame = view.frames["can"]
        x, y, z = (view.state.ee.position - frame.position) @ frame.rotation
        return bool(abs(x) <= self.along and abs(y) <= self.across and z <= self.height)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--across", type=float, nargs="+", default=[0.012, 0.03], help="tolerances to try, metres")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="training seeds under results/can")
    options = parser.parse_args()
    can = get_task("can")
    slow = [c for i, c in enumerate(islice(can.conditions.stream("val", n_strata=8), 400)) if i % 8 < 2]
    for across in options.across:
        phases = list(can.phases)
        phases[1] = replace(phases[1], done=AlignedAlong(0.012, across))
        phases[2] = replace(phases[2], done=AlignedAlong(0.02, max(0.02, across), 0.012))
        env = ResidualEnv(replace(can, phases=tuple(phases)))
        for seed in options.seeds:
            policy = MlpPolicyFile.load(f"results/can/seed-{seed}/policy.safetensors")
            won = [succeeds(env, policy, condition) for condition in slow]
            rates = [sum(won[k::2]) / len(won[k::2]) for k in (0, 1)]
            print(f"across {1000 * across:.0f} mm, seed {seed}: slowest bin {rates[0]:.0%}, next {rates[1]:.0%}")
        env.close()


def succeeds(env: ResidualEnv, policy: MlpPolicyFile, condition: object) -> bool:
    observation, _ = env.reset(options={"condition": condition})
    while True:
        observation, _, done, _, info = env.step(policy(observation))
        if done:
            return bool(info["is_success"])


if __name__ == "__main__":
    main()
