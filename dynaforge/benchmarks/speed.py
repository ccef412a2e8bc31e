"""Figures of speed: exact reset, and control steps per CPU-second against the bare simulator."""

from __future__ import annotations

import time
from contextlib import nullcontext
from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np

from dynaforge.benchmarks.episodes import bench_conditions, run_planner_only, run_zero_residual, state_arrays
from dynaforge.benchmarks.figure import Figure, spread, tracked
from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import ControlStep, World
from dynaforge.geometry import JointState, JointTrajectory, Pose
from dynaforge.planning import ArmKinematics, CollisionModel, GlobalPlanner
from dynaforge.sim import Condition, SceneState, SimScene
from dynaforge.sim.bare import MotorCommands, motor_commands, replay_bare
from dynaforge.sim.probing import blind
from dynaforge.tasks import Task

MAX_RESET_SECONDS = 2e-3
STEPS_BEFORE_RESET = 6
MAX_MEAN_PLAN_SECONDS, MAX_PLAN_SECONDS = 3e-3, 20e-3
# Control steps per CPU-second, whole stack over bare simulator: forces watched and physics varied, or none of this.
MIN_RATIO, MIN_PLAIN_RATIO = 0.70, 0.77


def scene_reset(task: Task, *, rounds: int = 5, n: int = 40) -> list[Figure]:
    """Time `SimScene.reset`, in CPU seconds, after episodes and after a few control steps.

    Args:
        task: The task.
        rounds: Number of rounds.
        n: Resets per round; one in eight follows a whole episode.
    """
    env = ResidualEnv(task)
    scene, robot, conditions = env.world.scene, env.world.scene.robot, bench_conditions(task, n)
    seconds: list[list[float]] = []
    for _ in tracked(range(rounds), "reset", total=rounds):
        seconds.append([])
        for k, condition in enumerate(conditions):
            if k % 8 == 0:
                run_zero_residual(env, condition)
            else:
                for _ in range(STEPS_BEFORE_RESET):
                    scene.step(robot.q_ready, 0.0)
            begin = time.process_time()
            scene.reset(condition)
            seconds[-1].append(time.process_time() - begin)
    env.close()
    flat = [value for values in seconds for value in values]
    longest = max(flat)
    return [
        Figure(
            title="exact SimScene.reset",
            target="<= 2 ms of CPU",
            measured=f"median {1e3 * median(flat):.2f} ms, longest of {len(flat)} {1e3 * longest:.2f} ms",
            ok=longest <= MAX_RESET_SECONDS,
            raw={"cpu_seconds": seconds},
        )
    ]


class TimedPlanner(GlobalPlanner):
    """A global planner that keeps the CPU seconds of every plan, found or not."""

    seconds: list[float]

    def plan(self, start: JointState, target: Pose, *, rng: np.random.Generator) -> JointTrajectory:
        """Plan as a global planner does.

        Args:
            start: As in `GlobalPlanner.plan`, as are the others.
            target: Pose to reach.
            rng: What the planner draws from.
        """
        begin = time.process_time()
        try:
            return super().plan(start, target, rng=rng)
        finally:
            self.seconds.append(time.process_time() - begin)


def global_plans(task: Task, *, n: int = 300) -> list[Figure]:
    """Time the global plans of planner-only episodes, whose conditions are spread over the difficulty range.

    Args:
        task: The task.
        n: Number of plans, and of episodes at most.
    """
    world = World(task)
    robot, dt = world.scene.robot, task.scene.control_dt
    planner = TimedPlanner(robot, ArmKinematics(robot), CollisionModel(robot), dt=dt)
    planner.seconds = []
    executor = PhaseExecutor(task, planner, control_dt=dt)
    for condition in tracked(bench_conditions(task, n), "global plans", total=n):
        if len(planner.seconds) < n:
            run_planner_only(world, executor, condition)
    world.close()
    seconds = planner.seconds[:n] or [0.0]
    mean, worst = sum(seconds) / len(seconds), max(seconds)
    return [
        Figure(
            title="global plan",
            target="mean <= 3 ms, worst <= 20 ms of CPU",
            measured=f"mean {1e3 * mean:.2f} ms, worst of {len(seconds)} {1e3 * worst:.2f} ms",
            ok=mean <= MAX_MEAN_PLAN_SECONDS and worst <= MAX_PLAN_SECONDS,
            raw={"cpu_seconds": seconds},
        )
    ]


@dataclass(frozen=True, slots=True, eq=False)
class RecordedCommands:
    """The motor commands of one planner-only episode, for the bare simulator.

    Attributes:
        condition: The condition.
        commands: Commands of each control step.
        end: The measured state at the end.
    """

    condition: Condition
    commands: list[MotorCommands]
    end: SceneState


def control_rate(task: Task, *, rounds: int = 5, n: int = 30, plain: bool = False) -> list[Figure]:
    """Compare whole planner-only episodes, planning and reset included, with the bare simulator.

    The bare simulator calls stepSimulation and one array motor call per substep, and replays the very same episodes:
    joint targets and speeds of fixtures are computed beforehand, and resets are not timed. The opening is commanded
    where it changes, since nothing would be gripped otherwise, and fixtures once per control step, since objects stand
    on them. Both must simulate the same contacts: a replay that does not end in the recorded state bit for bit fails
    the figure.

    Args:
        task: The task.
        rounds: Number of rounds; the whole stack and the bare simulator take turns in each.
        n: Number of conditions, spread over the difficulty range.
        plain: Whether no forces are watched, no reflex acts and physics is fixed.
    """
    if plain:
        task = task.under(reflex="off", physics="fixed")
    env = ResidualEnv(task, share_prefix=False)  # each condition is simulated once
    with blind(env.world.scene) if plain else nullcontext():
        whole, bare, raw = _rates(env, rounds=rounds, n=n)
    env.close()
    ratios, least = [b / w for b, w in zip(bare, whole, strict=True)], MIN_PLAIN_RATIO if plain else MIN_RATIO
    measured = (
        f"{spread(ratios)}: {1 / median(whole):.0f} against {1 / median(bare):.0f} per CPU-second, "
        f"{n} episodes, {rounds} rounds"
    )
    if astray := raw["replays_astray"]:
        measured += f"; {astray} replays left the recorded trajectory"
    return [
        Figure(
            title="control steps per CPU-second over bare simulator" + (", nothing watched or varied" if plain else ""),
            target=f">= {least:.2f}",
            measured=measured,
            ok=median(ratios) >= least and not astray,
            raw=raw | {"ratio": ratios},
        )
    ]


def _rates(env: ResidualEnv, *, rounds: int, n: int) -> tuple[list[float], list[float], dict[str, Any]]:
    """Return CPU seconds per control step in each round, of whole episodes and of the bare simulator, and raw data."""
    recordings = [_record(env, condition) for condition in bench_conditions(env.task, n)]
    steps = sum(len(recording.commands) for recording in recordings)
    whole, bare, astray = list[float](), list[float](), 0
    for _ in tracked(range(rounds), "control steps", total=rounds):
        begin = time.process_time()
        for recording in recordings:
            run_zero_residual(env, recording.condition)
        whole.append((time.process_time() - begin) / steps)
        replays = [_replay(env.world.scene, recording) for recording in recordings]
        bare.append(sum(seconds for seconds, _ in replays) / steps)
        astray += sum(not exact for _, exact in replays)
    raw: dict[str, Any] = {"whole_cpu_seconds_per_step": whole, "bare_cpu_seconds_per_step": bare}
    return whole, bare, raw | {"episodes": n, "control_steps": steps, "replays_astray": astray}


def _record(env: ResidualEnv, condition: Condition) -> RecordedCommands:
    steps: list[ControlStep] = []
    with env.world.listening(steps.append):
        run_zero_residual(env, condition)
    references = [(step.reference.joints.q, step.reference.width) for step in steps]
    gates = [step.planned is not None and step.planned.gate for step in steps]
    first_gate = gates.index(True) if any(gates) else None
    commands = motor_commands(env.world.scene, condition, references, first_gate=first_gate)
    return RecordedCommands(condition, commands, steps[-1].after)


def _replay(scene: SimScene, recording: RecordedCommands) -> tuple[float, bool]:
    """Replay an episode bare; return CPU seconds, and whether it ended in the recorded state bit for bit."""
    seconds, end = replay_bare(scene, recording.condition, recording.commands)
    # Index 4 is time and width; the bare simulator keeps no time.
    pairs = list(zip(state_arrays(end), state_arrays(recording.end), strict=True))
    return seconds, all(np.array_equal(a, b) for i, (a, b) in enumerate(pairs) if i != 4)
