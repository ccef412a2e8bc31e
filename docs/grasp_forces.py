"""Measure and draw the contact force on the robot during one grasp of the planner.

    python docs/grasp_forces.py measure docs/forces/now.csv physics=fixed    # the package as it is now
    python docs/grasp_forces.py draw docs/forces                             # before.csv and now.csv -> grasp.svg

`before.csv` is from the same script run in a checkout of commit 130d055, without `physics=fixed`, which it does not
know: its motors push with all the torque that the robot has, and nothing stops it. The can is the 34th of the stream
`val`, block 0, with 8 strata. Of the first ten slow cans there, nine are grasped before and now, and this one has the
median ratio of peak forces.
"""

from __future__ import annotations

import csv
import sys
from itertools import islice
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import dynaforge  # noqa: F401  (registers the envs)

INDEX, STRATA = 33, 8
HEADER = ("time, s", "net contact force, N")
THRESHOLDS = {"contact": 100, "standard": 40, "strict": 20}  # newtons
SUBSTEPS = 8  # in a control step of Can


def net_force(contacts: list[tuple[Any, ...]]) -> float:
    """Return the norm of the sum of Bullet's contact forces on a body, newtons."""
    forces = [c[9] * np.array(c[7]) + c[10] * np.array(c[11]) + c[12] * np.array(c[13]) for c in contacts]
    return float(np.linalg.norm(np.sum(forces, axis=0)))


def measure(out: Path, **env_kwargs: Any) -> None:
    """Write the net contact force on the robot at every substep of the planner's grasp.

    Args:
        out: The file, CSV.
        **env_kwargs: Further arguments of the env.
    """
    env: Any = gymnasium.make("DynaForge/Can-v0", gate_mode="mask", **env_kwargs).unwrapped
    scene = env.world.scene
    bullet, step = getattr(scene, "_bullet", None), scene._step_physics
    client, body = (bullet.client, bullet.robot.body) if bullet else (scene.client, scene.robot_id)
    forces: list[float] = []

    def step_and_measure() -> None:
        step()
        forces.append(net_force(client.getContactPoints(body)))

    scene._step_physics = step_and_measure
    stream = env.condition_sampler.stream("val", n_strata=STRATA)
    env.reset(options={"condition": next(islice(stream, INDEX, None))})
    forces.clear()  # of the substeps that made the reset
    done = False
    while not done:
        _, _, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    dt = env.task.scene.physics_dt
    env.close()
    if not info["is_success"]:
        raise SystemExit(f"The planner does not grasp this can: {info['failure']}.")
    with out.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEADER)
        rows.writerows((f"{(k + 1) * dt:.4f}", f"{force:.2f}") for k, force in enumerate(forces))
    print(f"{out}: success after {len(forces)} substeps, at most {max(forces):.0f} N")


def draw(folder: Path) -> None:
    """Draw the forces in before.csv and now.csv of a folder as grasp.svg beside them."""
    import matplotlib.pyplot as plt

    plt.rcParams |= {"svg.hashsalt": "grasp", "font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    figure, axes = plt.subplots(figsize=(7.0, 3.4), layout="constrained")
    begin, end = np.inf, 0.0
    for name, colour in (("before", "tab:red"), ("now", "tab:blue")):
        time, force = np.loadtxt(folder / f"{name}.csv", delimiter=",", skiprows=1).T
        touching = time[force > 5.0]
        begin, end = min(begin, touching[0]), max(end, touching[-1])
        axes.plot(time, force, color=colour, linewidth=0.6, alpha=0.7)
        means = force.reshape(-1, SUBSTEPS).mean(axis=1)
        label = f"{name}: peak {force.max():.0f} N, {means.max():.0f} N as mean of a control step"
        axes.step(time[SUBSTEPS - 1 :: SUBSTEPS], means, color=colour, label=label)
    axes.set(xlim=(begin - 0.1, end), ylim=(0, None), xlabel="time since launch, s", ylabel=HEADER[1])
    for name, force in THRESHOLDS.items():
        axes.axhline(force, color="0.4", linewidth=0.7, linestyle="--")
        axes.annotate(f"{name}, {force} N", (end, force), ha="right", va="bottom", color="0.3", fontsize=7.5)
    axes.legend(frameon=False)
    figure.savefig(folder / "grasp.svg", metadata={"Date": None})


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["measure", out, *pairs]:
            measure(Path(out), **dict(pair.split("=", 1) for pair in pairs))
        case ["draw", folder]:
            draw(Path(folder))
        case _:
            raise SystemExit(__doc__)
