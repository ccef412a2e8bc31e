"""Measure and draw the contact force on the robot during one grasp of the planner.

    python docs/grasp_forces.py survey physics=fixed                         # the slow cans to choose from
    python docs/grasp_forces.py measure docs/forces/now.csv physics=fixed    # the package as it is now
    python docs/grasp_forces.py draw docs/forces                             # before.csv and now.csv -> grasp.svg

`before.csv` is from the same script run in a checkout of commit 130d055, without `physics=fixed`, which it does not
know: its motors push with all the torque that the robot has, and nothing stops it. The can is the first of the stream
`val`, block 0, with 8 strata. Of the ten slow cans of the survey, eight were grasped before, seven of these are now,
and of those seven this one has the third-greatest ratio of the peak now to the peak before.
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

INDEX, STRATA = 0, 8
HEADER = ("time, s", "net contact force, N")
THRESHOLDS = {"contact": 100, "standard": 40, "strict": 20}  # newtons
SUBSTEPS = 8  # in a control step of Can


def net_force(contacts: list[tuple[Any, ...]]) -> float:
    """Return the norm of the sum of Bullet's contact forces on a body, newtons."""
    forces = [c[9] * np.array(c[7]) + c[10] * np.array(c[11]) + c[12] * np.array(c[13]) for c in contacts]
    return float(np.linalg.norm(np.sum(forces, axis=0)))


def grasp(index: int, **env_kwargs: Any) -> tuple[bool, list[float], float]:
    """Run the planner on one can of the stream.

    Args:
        index: Its place in the stream.
        **env_kwargs: Further arguments of the env.

    Returns:
        Whether it was grasped, the net contact force on the robot at every substep (N), and a substep's length (s).
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
    env.reset(options={"condition": next(islice(stream, index, None))})
    forces.clear()  # of the substeps that made the reset
    done = False
    while not done:
        _, _, done, _, info = env.step(np.zeros(env.action_space.shape, np.float32))
    env.close()
    return info["is_success"], forces, env.task.scene.physics_dt


def survey(**env_kwargs: Any) -> None:
    """Print how the first ten slow cans of the stream end, those of its two slowest strata, and the peak forces."""
    for index in (k for k in range(5 * STRATA) if k % STRATA < 2):
        success, forces, _ = grasp(index, **env_kwargs)
        print(f"{index:2}: {'grasped' if success else 'missed '}, at most {max(forces):3.0f} N")


def measure(out: Path, **env_kwargs: Any) -> None:
    """Write the net contact force on the robot at every substep of the planner's grasp."""
    success, forces, dt = grasp(INDEX, **env_kwargs)
    if not success:
        raise SystemExit("The planner does not grasp this can.")
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
        case ["survey", *pairs]:
            survey(**dict(pair.split("=", 1) for pair in pairs))
        case ["draw", folder]:
            draw(Path(folder))
        case _:
            raise SystemExit(__doc__)
