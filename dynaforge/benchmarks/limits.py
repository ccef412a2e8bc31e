"""Figures of limits: finger speed in physics, and the trajectories of the global planner."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from dynaforge.benchmarks.episodes import bench_conditions, run_planner_only
from dynaforge.benchmarks.figure import Figure, tracked
from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.world import World
from dynaforge.geometry import Array, JointState, JointTrajectory, Pose, matrix_from_rotvec
from dynaforge.planning import ArmKinematics, CollisionModel, GlobalPlanner, LocalPlanner, Obstacle, PlanFailure
from dynaforge.sim import SimScene
from dynaforge.sim.robot import RobotDescription
from dynaforge.tasks import Task
from dynaforge.tasks.targets import DOWN_ALONG_X

COLLISION_CHECK_SPACING = 0.004  # radians of the fastest joint; the planner itself checks every 0.015
ROUNDING = 1e-9
STROKE_SECONDS = 1.2  # a full stroke, 40 mm per finger at 50 mm/s, takes 0.8 s
OBSTACLES = (
    Obstacle("post", "cylinder", (0.04, 0.5), Pose(np.eye(3), np.array((0.45, 0.22, 0.25)))),
    Obstacle("shelf", "box", (0.3, 0.3, 0.03), Pose(np.eye(3), np.array((0.5, -0.3, 0.4)))),
)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitUse:
    """How close a trajectory comes to the limits; 1 is the limit.

    Attributes:
        position: Radians beyond a joint position limit; negative inside.
        velocity: Largest share of a velocity limit, which depends on position, over samples and over differences of
            positions, whose limit is that of the middle between them.
        acceleration: Largest share of an acceleration limit, over samples and over differences of velocities.
        collisions: Configurations in collision in the dense check.
        started_in_collision: Whether it began in collision; `collisions` then counts from the first free configuration.
    """

    position: float
    velocity: float
    acceleration: float
    collisions: int
    started_in_collision: bool

    @property
    def inside(self) -> bool:
        """Whether every limit is kept and nothing collides."""
        kept = self.position <= ROUNDING and max(self.velocity, self.acceleration) <= 1.0 + ROUNDING
        return kept and self.collisions == 0


def limit_use(trajectory: JointTrajectory, robot: RobotDescription, collision: CollisionModel) -> LimitUse:
    """Check a trajectory as the arm is commanded along it: on straight lines between its samples.

    Args:
        trajectory: The trajectory.
        robot: The limits.
        collision: What it may collide with.
    """
    q, dq, ddq, dt = trajectory.q, trajectory.dq, trajectory.ddq, trajectory.dt
    slopes, changes = np.diff(q, axis=0) / dt, np.diff(dq, axis=0) / dt
    hits = [collision.in_collision(point) for point in _densely_sampled(q)]
    first_free = hits.index(False) if hits[0] and False in hits else 0
    return LimitUse(
        position=float(np.maximum(robot.q_lower - q, q - robot.q_upper).max()),
        velocity=max(_speed_share(q, dq, robot), _speed_share((q[:-1] + q[1:]) / 2, slopes, robot)),
        acceleration=float((np.abs(np.concatenate((ddq, changes))) / robot.ddq_max).max()),
        collisions=sum(hits[first_free:]),
        started_in_collision=hits[0],
    )


def _speed_share(q: Array, dq: Array, robot: RobotDescription) -> float:
    """Return the largest share of the velocity limits at positions q (n, 7) that velocities dq (n, 7) use."""
    lower, upper = robot.speed_limits(q)
    limit = np.where(dq > 0.0, upper, -lower)
    return float((np.abs(dq) / np.maximum(limit, ROUNDING)).max(initial=0.0))


def _densely_sampled(q: Array) -> Iterator[Array]:
    """Yield configurations on the straight lines between samples, `COLLISION_CHECK_SPACING` apart at most."""
    yield q[0]
    for start, end in pairwise(q):
        n = max(1, math.ceil(float(np.abs(end - start).max()) / COLLISION_CHECK_SPACING))
        yield from start + np.arange(1, n + 1)[:, None] / n * (end - start)


class RecordingPlanner(GlobalPlanner):
    """A global planner that keeps every trajectory it returns."""

    def __init__(self, robot: RobotDescription, collision: CollisionModel, *, dt: float) -> None:
        super().__init__(robot, ArmKinematics(robot), collision, dt=dt)
        self.kept: list[JointTrajectory] = []

    def plan(self, start: JointState, target: Pose, *, rng: np.random.Generator) -> JointTrajectory:
        """Plan as a global planner does, and keep the trajectory.

        Args:
            start: As in `GlobalPlanner.plan`, as are the others.
            target: Pose to reach.
            rng: What the planner draws from.
        """
        self.kept.append(super().plan(start, target, rng=rng))
        return self.kept[-1]


def global_planner(task: Task, *, n: int = 30) -> list[Figure]:
    """Check the global planner's trajectories in episodes, and to random goals with and without obstacles.

    Every other random goal is planned from the middle of the previous motion, that is, from a moving arm.

    Args:
        task: The task.
        n: Number of planner-only episodes, and of random goals in each surrounding.
    """
    world = World(task)
    robot, dt = world.scene.robot, task.scene.control_dt
    planner = RecordingPlanner(robot, CollisionModel(robot), dt=dt)
    executor = PhaseExecutor(task, planner, control_dt=dt)
    for condition in tracked(bench_conditions(task, n), "planner in episodes", total=n):
        run_planner_only(world, executor, condition)
    world.close()
    found = {"episodes": (planner.kept, 0, planner.collision)}
    for name, fixtures in (("bare table", ()), ("furnished table", OBSTACLES)):
        planner = RecordingPlanner(robot, CollisionModel(robot, fixtures=fixtures), dt=dt)
        failures = _random_goals(planner, n, np.random.default_rng(len(fixtures)))
        found[name] = (planner.kept, failures, planner.collision)
    return [_planner_figure(found, robot)]


def _random_goals(planner: RecordingPlanner, n: int, rng: np.random.Generator) -> int:
    """Plan to n random goals, one from another; return for how many there is no plan."""
    start, failures = JointState.at_rest(planner.robot.q_ready), 0
    for k in tracked(range(n), "planner to random goals", total=n):
        position = rng.uniform((0.3, -0.4, 0.05), (0.65, 0.4, 0.5))
        turn = matrix_from_rotvec(np.array((0.0, 0.0, rng.uniform(-np.pi / 2, np.pi / 2))))
        try:
            trajectory = planner.plan(start, Pose(turn @ DOWN_ALONG_X, position), rng=rng)
        except PlanFailure:
            failures += 1
            continue
        start = trajectory[len(trajectory) // 2 if k % 2 else -1]
    return failures


def _planner_figure(
    found: dict[str, tuple[list[JointTrajectory], int, CollisionModel]], robot: RobotDescription
) -> Figure:
    raw: dict[str, Any] = {}
    every: list[LimitUse] = []
    for name, (trajectories, failures, collision) in found.items():
        results = [
            limit_use(t, robot, collision) for t in tracked(trajectories, "dense check", total=len(trajectories))
        ]
        every += results
        raw[name] = {
            "trajectories": len(results),
            "goals_without_plan": failures,
            "outside": sum(not result.inside for result in results),
            "most_position_rad": max((r.position for r in results), default=None),
            "most_velocity_share": max((r.velocity for r in results), default=None),
            "most_acceleration_share": max((r.acceleration for r in results), default=None),
            "colliding": sum(r.collisions > 0 for r in results),
            "started_in_collision": sum(r.started_in_collision for r in results),
        }
    title = "global planner's trajectories"
    if not every:
        return Figure(title=title, target="some", measured="no plan at all", ok=False, raw=raw)
    measured = (
        f"{len(every)} trajectories: nearest position limit {-max(r.position for r in every):.3f} rad away, "
        f"velocity {max(r.velocity for r in every):.3f}, acceleration {max(r.acceleration for r in every):.3f} "
        f"of the limit, {sum(r.collisions > 0 for r in every)} collide"
    )
    ok = all(result.inside for result in every)
    return Figure(title=title, target="inside limits, none collides", measured=measured, ok=ok, raw=raw)
