"""Figures of the hand: the speed of its fingers, and whether they hold their width and stay symmetric."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from dynaforge.benchmarks.episodes import bench_conditions, run_planner_only
from dynaforge.benchmarks.figure import Figure, tracked
from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.world import World
from dynaforge.geometry import Array
from dynaforge.planning import ArmKinematics, LocalPlanner
from dynaforge.sim import SimScene
from dynaforge.sim.probing import at_every_substep, push_fingers
from dynaforge.tasks import Task

STROKE_SECONDS = 1.2  # a full stroke, 40 mm per finger at 50 mm/s, takes 0.8 s
PUSH = 70.0  # newtons; what the Franka Hand holds continuously
PUSHES = ((PUSH, 0.0), (0.0, PUSH), (PUSH, PUSH), (-PUSH, -PUSH))  # on the left and the right finger, outward
WIDTH, SETTLING_STEPS, PUSHED_STEPS = 0.04, 25, 10  # metres, control steps
MAX_MOVED, MAX_ASYMMETRY = 0.5e-3, 1e-3  # metres


def finger_speed(task: Task) -> list[Figure]:
    """Measure the speed of each finger at every substep of full strokes.

    The opening is commanded at once, and ramped as the local planner does. Speed is the larger of the joint velocity
    and the change of joint position per substep.
    """
    spec = task.scene
    scene = SimScene(
        replace(spec, control_dt=spec.physics_dt)
    )  # one control step is one substep, so that every substep is observed
    condition = bench_conditions(task, 1)[0]
    speeds: dict[str, float] = {}
    widths: dict[str, list[float]] = {}
    for name in ("at once", "ramped"):
        scene.reset(condition)
        fastest, ends = 0.0, list[float]()
        for wanted in (0.0, scene.robot.width_max):
            speed, width = _stroke(scene, _openings(scene, task, wanted, ramped=name == "ramped"))
            fastest, ends = max(fastest, speed), [*ends, width]
        speeds[name], widths[name] = fastest, ends
    scene.close()
    limit, full = scene.robot.finger_speed_max, scene.robot.width_max
    travelled = all(closed < 0.05 * full and opened > 0.95 * full for closed, opened in widths.values())
    measured = ", ".join(f"{1e3 * speed:.2f} mm/s {name}" for name, speed in speeds.items())
    return [
        Figure(
            title="finger speed, every substep of close and open",
            target=f"<= {1e3 * limit:.0f} mm/s",
            measured=measured if travelled else f"{measured}; the stroke was not full",
            ok=travelled and max(speeds.values()) <= limit,
            raw={"metres_per_second": speeds, "width_after_close_and_open": widths},
        )
    ]


def _openings(scene: SimScene, task: Task, wanted: float, *, ramped: bool) -> Iterator[float]:
    """Yield the commanded opening, metres, for every substep of a stroke."""
    spec, robot = task.scene, scene.robot
    local = LocalPlanner(robot, ArmKinematics(robot), dt=spec.control_dt)
    local.reset(robot.q_ready, robot.width_max - wanted)
    for _ in range(round(STROKE_SECONDS / spec.control_dt)):
        width = local.to_joints(robot.q_ready, wanted).width if ramped else wanted
        for _ in range(spec.substeps):
            yield width


def _stroke(scene: SimScene, openings: Iterator[float]) -> tuple[float, float]:
    """Command the openings; return the highest speed of a finger (m/s) and the opening at the end (m)."""
    before, _ = scene.fingers()
    fastest, width = 0.0, 0.0
    for opening in openings:
        width = scene.step(scene.robot.q_ready, opening).width
        after, speeds = scene.fingers()
        moved = np.abs(after - before) / scene.spec.physics_dt
        fastest = max(fastest, float(moved.max()), float(np.abs(speeds).max()))
        before = after
    return fastest, width


def hand(task: Task, *, n: int = 10) -> list[Figure]:
    """Push the fingers of a half open hand, and watch them in planner-only episodes.

    Args:
        task: The task.
        n: Number of episodes, spread over the difficulty range.
    """
    moved, apart = _pushed(task)
    in_episodes = _asymmetry(task, n)
    return [
        Figure(
            title=f"finger motion under a push of {PUSH:g} N",
            target=f"<= {1e3 * MAX_MOVED:g} mm",
            measured=f"{1e3 * max(moved):.2f} mm at most, {len(PUSHES)} pushes",
            ok=max(moved) <= MAX_MOVED,
            raw={"newtons": PUSHES, "metres": moved},
        ),
        Figure(
            title="asymmetry of the fingers, every substep",
            target=f"<= {1e3 * MAX_ASYMMETRY:g} mm",
            measured=f"{1e3 * apart:.2f} mm pushed, {1e3 * in_episodes:.2f} mm in {n} planner-only episodes",
            ok=max(apart, in_episodes) <= MAX_ASYMMETRY,
            raw={"pushed_metres": apart, "episodes_metres": in_episodes},
        ),
    ]


def _pushed(task: Task) -> tuple[list[float], float]:
    """Return how far a finger moved under each push, and how far the two were apart at most, metres."""
    scene, condition = SimScene(task.scene), bench_conditions(task, 1)[0]
    moved, apart = [], 0.0
    for push in PUSHES:
        scene.reset(condition)
        for _ in range(SETTLING_STEPS):
            scene.step(scene.robot.q_ready, WIDTH)
        before, _ = scene.fingers()
        with finger_positions(scene, push) as seen:
            for _ in range(PUSHED_STEPS):
                scene.step(scene.robot.q_ready, WIDTH)
        moved.append(float(np.abs(np.array(seen) - before).max()))
        apart = max(apart, float(np.ptp(seen, axis=1).max()))
    scene.close()
    return moved, apart


@contextmanager
def finger_positions(scene: SimScene, push: tuple[float, float] = (0.0, 0.0)) -> Iterator[list[Array]]:
    """Give a list to which the finger positions are added after every substep in the block, metres, shape (2,) each.

    Args:
        scene: The scene.
        push: With what each finger is pushed meanwhile, outward, newtons.
    """
    seen: list[Array] = []
    before = partial(push_fingers, scene, push) if any(push) else lambda: None
    with at_every_substep(scene, before=before, after=lambda: seen.append(scene.fingers()[0])):
        yield seen


def _asymmetry(task: Task, n: int) -> float:
    """Return the greatest difference of the finger positions in n planner-only episodes, metres."""
    world = World(task)
    executor = PhaseExecutor(task, world.planner, control_dt=task.scene.control_dt)
    with finger_positions(world.scene) as seen:
        for condition in tracked(bench_conditions(task, n), "fingers", total=n):
            run_planner_only(world, executor, condition)
    world.close()
    return float(np.ptp(seen, axis=1).max())
