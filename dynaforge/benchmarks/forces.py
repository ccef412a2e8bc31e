"""Figures of forces: what the arm presses with, what planned successes press with, and the reflex."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dynaforge.benchmarks.episodes import bench_conditions, run_planner_only, run_zero_residual
from dynaforge.benchmarks.figure import Figure, spread, tracked
from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import ControlStep, World
from dynaforge.geometry import Array, Pose
from dynaforge.planning import ArmKinematics, LocalPlanner
from dynaforge.sim import Condition, HandTarget, Launch, SceneState, SimScene
from dynaforge.sim.hand_target import TIP
from dynaforge.sim.loads import Loads
from dynaforge.sim.probing import at_every_substep, blind, push_hand
from dynaforge.sim.reflex import THRESHOLDS
from dynaforge.tasks import Task, get_task
from dynaforge.tasks.targets import DOWN_ALONG_Y

MAX_PRESS = 80.0  # newtons, steady
PRESS_DEPTH = 0.025  # metres past the contact
PRESSED_AT = ((0.35, -0.25), (0.45, 0.0), (0.6, -0.1))  # x and y on the table, metres
APPROACH_STEPS, PRESS_STEPS, HELD_STEPS, STEADY_STEPS = 45, 15, 30, 10  # of those held, the last are steady
MAX_WATCHING_SHARE = 0.09  # of the CPU time: 0.70 instead of 0.77 of the bare simulator's control steps
STOPPED_AT, BORNE = 200.0, 50.0  # newtons that must stop the robot, and that must not
PUSHED_STEPS = 10  # control steps


class PressingHand:
    """A closed hand over an empty table, which a target moves up and down.

    Args:
        task: Gives the lengths of substep and control step.
        x: Where on the table, metres.
        y: Where on the table, metres.
    """

    def __init__(self, task: Task, x: float, y: float) -> None:
        can = get_task("can")
        away = Launch(Pose(np.eye(3), np.array((50.0, 0.0, 1.0))), np.zeros(3), np.zeros(3), mass=1.0)
        spec = replace(
            can.scene,
            launch=lambda condition: dict.fromkeys(can.scene.names, away),
            physics_dt=task.scene.physics_dt,
            control_dt=task.scene.control_dt,
        )
        self.scene = SimScene(spec)
        self._x, self._y = x, y
        robot = self.scene.robot
        self._local = LocalPlanner(robot, ArmKinematics(robot), dt=spec.control_dt)
        self.scene.reset(replace(bench_conditions(can, 1)[0], hidden={}))
        self._local.reset(robot.q_ready, robot.width_max)

    def move(self, height: float) -> SceneState:
        """Move for one control step toward a height of the fingertips above the table, metres."""
        target = Pose(DOWN_ALONG_Y, np.array((self._x, self._y, height + TIP)))
        reference = self._local.track(HandTarget(target, 0.0))
        return self.scene.step(reference.joints.q, reference.width)

    def go(self, heights: Iterable[float]) -> list[SceneState]:
        """Move toward one height after another, metres."""
        return [self.move(height) for height in heights]

    def touch_down(self) -> list[SceneState]:
        """Put the fingertips on the table, and return what was seen on the way down."""
        return self.go([*[0.05] * APPROACH_STEPS, *np.linspace(0.023, 0.0, PRESS_STEPS).tolist()])


@contextmanager
def _pressing_hand(task: Task, x: float, y: float) -> Iterator[PressingHand]:
    hand = PressingHand(task, x, y)
    try:
        yield hand
    finally:
        hand.scene.close()


def peak_force(task: Task, *, n: int = 40) -> list[Figure]:
    """Measure with what the arm presses when it is held back, and with what the planner's successes press.

    Args:
        task: The task.
        n: Number of planner-only episodes.
    """
    return [_pressing(task), _planned(task, n)]


def _pressing(task: Task) -> Figure:
    """Command a closed hand 2.5 cm into the table, at three places, and measure with what it presses."""
    steady, peaks = [], []
    for x, y in PRESSED_AT:
        with _pressing_hand(task, x, y) as hand:
            states = [*hand.touch_down(), *hand.go(np.linspace(0.0, -PRESS_DEPTH, PRESS_STEPS).tolist())]
            states += hand.go([-PRESS_DEPTH] * HELD_STEPS)
        steady.append(max(float(np.linalg.norm(state.loads.force)) for state in states[-STEADY_STEPS:]))
        peaks.append(max(state.loads.peak_force for state in states))
    return Figure(
        title="force 2.5 cm past a rigid contact",
        target=f"<= {MAX_PRESS:g} N steady",
        measured=f"{spread(steady, digits=0)} N steady at {len(steady)} places; peak of a substep {max(peaks):.0f} N",
        ok=min(steady) > 0.0 and max(steady) <= MAX_PRESS,
        raw={"places": PRESSED_AT, "steady_newtons": steady, "peak_newtons": peaks},
    )


def _planned(task: Task, n: int) -> Figure:
    """Run the planner without a reflex, so that what it presses with is seen to the end."""
    task = task.under(reflex="off")
    world, loads = World(task), list[Loads]()
    executor = PhaseExecutor(task, world.planner, control_dt=task.scene.control_dt)
    for condition in tracked(bench_conditions(task, n), "forces", total=n):
        if run_planner_only(world, executor, condition).success:
            loads.append(world.scene.loads)
    world.close()
    limit = THRESHOLDS["contact"].force
    lasting, peaks = [load.force for load in loads], [load.peak_force for load in loads]
    measured = f"{len(loads)} successes of {n}"
    if loads:
        p50, p90 = np.percentile(peaks, (50, 90))
        measured += (
            f": at most {max(lasting):.0f} N over two control steps; "
            f"peak of a substep median {p50:.0f}, 90 % {p90:.0f}, greatest {max(peaks):.0f} N"
        )
    return Figure(
        title="forces of planner-only successes",
        target=f"<= {limit:g} N over two control steps",
        measured=measured,
        ok=max(lasting, default=0.0) <= limit,
        raw={"episodes": n, "lasting_newtons": lasting, "peak_newtons": peaks},
    )


def reflex(task: Task, *, rounds: int = 5, n: int = 10) -> list[Figure]:
    """Measure what watching forces costs, and whether the reflex stops a robot that is pressed.

    Args:
        task: The task.
        rounds: Number of rounds of the cost.
        n: Number of episodes in each.
    """
    return [_watching(task, rounds=rounds, n=n), _stopping(task)]


def _watching(task: Task, *, rounds: int, n: int) -> Figure:
    """Compare the scene with one that watches no forces on the same joint references, and both with whole episodes."""
    env = ResidualEnv(task)
    scene, conditions = env.world.scene, bench_conditions(task, n)
    recordings = [(condition, _references(env, condition)) for condition in conditions]
    shares = []
    for _ in tracked(range(rounds), "watching forces", total=rounds):
        whole = watching = 0.0
        for condition, references in recordings:  # take turns, so that whatever else runs slows all of them
            whole += _cpu_seconds(partial(run_zero_residual, env, condition))
            watching += _cpu_seconds(partial(_simulate, scene, condition, references))
            with blind(scene):
                watching -= _cpu_seconds(partial(_simulate, scene, condition, references))
        shares.append(watching / whole)
    env.close()
    return Figure(
        title="watching forces, CPU share of whole planner-only episodes",
        target=f"<= {MAX_WATCHING_SHARE:g}",
        measured=f"{spread(shares, digits=3)}, {n} episodes, {rounds} rounds",
        ok=float(np.median(shares)) <= MAX_WATCHING_SHARE,
        raw={"shares": shares, "episodes": n},
    )


def _references(env: ResidualEnv, condition: Condition) -> list[tuple[Array, float]]:
    steps: list[ControlStep] = []
    with env.world.listening(steps.append):
        run_zero_residual(env, condition)
    return [(step.reference.joints.q, step.reference.width) for step in steps]


def _simulate(scene: SimScene, condition: Condition, references: list[tuple[Array, float]]) -> None:
    scene.reset(condition)
    for q, width in references:
        scene.step(q, width)


def _cpu_seconds(run: Callable[[], object]) -> float:
    begin = time.process_time()
    run()
    return time.process_time() - begin


@dataclass(frozen=True, slots=True)
class Stop:
    """What happened to a hand that stood on the table and was pushed down.

    Attributes:
        after: Number of control steps until the reflex acted; None if it did not.
        force: Mean force of the table on the hand in the control step in which it acted, or else in the last, newtons.
    """

    after: int | None
    force: float


def _stopping(task: Task) -> Figure:
    stops = {newtons: push_down(task, newtons) for newtons in (STOPPED_AT, BORNE)}
    words = [
        f"{newtons:g} N: " + (f"stopped after {stop.after} control steps" if stop.after else "not stopped")
        for newtons, stop in stops.items()
    ]
    return Figure(
        title="reflex of a hand that is pressed on the table",
        target=f"stops at {STOPPED_AT:g} N, bears {BORNE:g} N",
        measured=", ".join(words),
        ok=stops[STOPPED_AT].after is not None and stops[BORNE].after is None,
        raw={f"{newtons:g} N": {"after": stop.after, "newtons": stop.force} for newtons, stop in stops.items()},
    )


def push_down(task: Task, newtons: float) -> Stop:
    """Push a hand that stands on the table down for `PUSHED_STEPS`.

    Args:
        task: Gives the lengths of substep and control step.
        newtons: The force.
    """
    with _pressing_hand(task, *PRESSED_AT[1]) as hand:
        hand.touch_down()
        hand.go([0.0] * HELD_STEPS)
        with at_every_substep(hand.scene, before=partial(push_hand, hand.scene, np.array((0.0, 0.0, -newtons)))):
            states = hand.go([0.0] * PUSHED_STEPS)
    stopped = [state.overloaded for state in states]
    after = stopped.index(True) + 1 if any(stopped) else None
    return Stop(after, float(np.linalg.norm(states[(after or 0) - 1].loads.force)))
