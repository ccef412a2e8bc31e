"""Figures of limits: joint speeds in episodes, and the trajectories of the global planner."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from dynaforge.benchmarks.episodes import bench_conditions, run_planner_only, run_seeded, run_zero_residual
from dynaforge.benchmarks.figure import Figure, tracked
from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import World
from dynaforge.geometry import Array, JointState, JointTrajectory, Pose, matrix_from_rotvec
from dynaforge.planning import ArmKinematics, CollisionModel, GlobalPlanner, Obstacle, PlanFailure
from dynaforge.sim.robot import RobotDescription
from dynaforge.tasks import Task
from dynaforge.tasks.targets import DOWN_ALONG_X

COLLISION_CHECK_SPACING = 0.004  # radians of the fastest joint; the planner itself checks every 0.015
ROUNDING = 1e-9
OBSTACLES = (
    Obstacle("post", "cylinder", (0.04, 0.5), Pose(np.eye(3), np.array((0.45, 0.22, 0.25)))),
    Obstacle("shelf", "box", (0.3, 0.3, 0.03), Pose(np.eye(3), np.array((0.5, -0.3, 0.4)))),
)


def speed_limits(task: Task, *, n: int = 20) -> list[Figure]:
    """Check every joint reference of episodes against the speed limits, which depend on position.

    Each condition is run with residual 0 and with random residuals. The velocity of a reference is checked where the
    reference is, and the mean velocity of a control step at the middle of it.

    Args:
        task: The task.
        n: Number of conditions, spread over the difficulty range.
    """
    env = ResidualEnv(task)
    robot, dt = env.world.scene.robot, task.scene.control_dt
    runs = {"residual 0": run_zero_residual, "random residuals": run_seeded}
    shares: dict[str, list[float]] = {name: [] for name in runs}
    for condition in tracked(bench_conditions(task, n), "speed limits", total=n):
        for name, run in runs.items():
            joints = [JointState.at_rest(robot.q_ready)]
            with env.world.listening(lambda step, kept=joints: kept.append(step.reference.joints)):  # type: ignore[misc]
                run(env, condition)
            q, dq = np.array([state.q for state in joints]), np.array([state.dq for state in joints])
            shares[name] += reference_shares(q, dq, robot, dt=dt).tolist()
    env.close()
    every = np.concatenate(list(shares.values()))
    over = int((every > 1.0 + ROUNDING).sum())
    return [
        Figure(
            title="control steps beyond the joint speed limits",
            target="0 %",
            measured=f"{100 * over / len(every):.2g} % of {len(every)}; fastest {every.max():.4f} of the limit",
            ok=not over,
            raw={name: {"control_steps": len(part), "most_share": max(part)} for name, part in shares.items()},
        )
    ]


def reference_shares(q: Array, dq: Array, robot: RobotDescription, *, dt: float) -> Array:
    """Return the largest share of a speed limit that a joint uses in each control step, shape (n,).

    Args:
        q: Joint positions at the beginning and at the end of each step, radians, shape (n + 1, 7).
        dq: Joint velocities there, rad/s, shape (n + 1, 7).
        robot: The limits.
        dt: Duration of a control step, seconds.
    """
    mean = robot.speed_limits.share((q[:-1] + q[1:]) / 2, np.diff(q, axis=0) / dt)
    return np.maximum(mean, robot.speed_limits.share(q[1:], dq[1:]))


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
    shares, changes = reference_shares(q, dq, robot, dt=dt), np.diff(dq, axis=0) / dt
    hits = [collision.in_collision(point) for point in _densely_sampled(q)]
    first_free = hits.index(False) if hits[0] and False in hits else 0
    return LimitUse(
        position=float(np.maximum(robot.q_lower - q, q - robot.q_upper).max()),
        velocity=float(max(robot.speed_limits.share(q[:1], dq[:1]).max(), shares.max(initial=0.0))),
        acceleration=float((np.abs(np.concatenate((ddq, changes))) / robot.ddq_max).max()),
        collisions=sum(hits[first_free:]),
        started_in_collision=hits[0],
    )


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
