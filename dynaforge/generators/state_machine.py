"""The rival of DynamicVLA: a state machine that chases an object by prediction, grasps it blindly, and tries again.

States, times, thresholds and prediction are those of the collector that its authors released; docs/rivals.md says what
is adapted to this robot, and why.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from dynaforge.demos import Episode
from dynaforge.envs.task_env import TaskEnv
from dynaforge.generators.generator import episode_of
from dynaforge.generators.recording import Recorder
from dynaforge.generators.state_machine_sight import Sight, Skill, raised, skill_for
from dynaforge.geometry import Array, Pose, one_line
from dynaforge.sim import Condition, HandTarget, SceneState
from dynaforge.sim.robot import HAND_WIDTH
from dynaforge.tasks import Task
from dynaforge.tasks.targets import DOWN_ALONG_Y

TURNED = math.radians(15.0)  # yaw between hand and grasp
OUTSIDE = 5  # control steps outside its container that tell that an object was not placed
DESCENT = 0.63  # seconds in which the hand comes down by the offset, at 0.25 m/s at most
FINAL = Pose(DOWN_ALONG_Y, np.array((0.3, 0.0, 0.3)))


class State(StrEnum):
    """States of the machine."""

    INIT = "init"
    RESET = "reset"
    ABOVE = "above"
    APPROACH = "approach"
    GRASP = "grasp"
    LIFT = "lift"
    ABOVE_TARGET = "above target"
    PLACE = "place"
    TO_TARGET = "to target"


WAIT: Mapping[State, float] = {
    State.INIT: 0.48,
    State.RESET: 0.08,
    State.ABOVE: 0.40,
    State.APPROACH: 0.72,
    State.GRASP: 0.72,
    State.LIFT: 0.20,
    State.ABOVE_TARGET: 0.40,
    State.PLACE: 0.40,
    State.TO_TARGET: 0.0,
}
"""Seconds before each state goes on."""
CLOSED = (State.GRASP, State.LIFT, State.ABOVE_TARGET)
"""States with a closed hand; TO_TARGET is one, too, if the object is only lifted."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Memory:
    """What the machine knows from earlier control steps.

    Attributes:
        state: Its state.
        entered: When it entered this state, seconds.
        initial: The pose of the hand at the start, `T_world_ee`.
        command: The last command.
        turned: Rotation of the hand since the first step of APPROACH, shape (3, 3); None outside that state.
        outside: For how many control steps a released object has been outside its container.
    """

    state: State
    entered: float
    initial: Pose
    command: HandTarget
    turned: Array | None = None
    outside: int = 0

    __repr__ = one_line


class StateMachine:
    """The transition table, as a function of what is sensed, the time, and what it remembers.

    | state | hand | gripper | goes on |
    |---|---|---|---|
    | INIT | initial pose | open | t >= .48 and reachable: ABOVE |
    | RESET | grasp + offset; initial pose if unreachable | open | t >= .08 and reachable: ABOVE |
    | ABOVE | grasp + offset | open | unreachable: RESET; t >= .40, above, yaw error < 15 degrees: APPROACH |
    | APPROACH | grasp, turned as at the first step | open | t >= .72: GRASP |
    | GRASP | last command | closed | t >= .72: LIFT |
    | LIFT | object + offset | closed | hand-object > .10: RESET; t >= .20: ABOVE_TARGET (lifts only: TO_TARGET) |
    | ABOVE_TARGET | container + 2 offsets | closed | hand-object > .10: RESET; t >= .40 and above: PLACE |
    | PLACE | container + offset | open | t >= .40: TO_TARGET |
    | TO_TARGET | final pose | closed, after PLACE open | hand-object > .10, after PLACE 5 steps outside: RESET |

    t: seconds in the state. Grasp: where the object will be in 0.23 s at constant velocity, 8 mm below its middle.
    Offset: 0.10 m upward. Reachable: the grasp is less than 0.75 m from the base. Above: the hand is within 0.01 m of
    the object in x and y if it is slower than 0.05 m/s, else within 0.11 m in z; for a container, of the place where
    the hand opens.

    Args:
        skill: What it is told of the task.
    """

    def __init__(self, skill: Skill) -> None:
        self.skill = skill

    def start(self, scene: SceneState) -> Memory:
        """Return what it knows at the start of an episode, whose scene is as sensed."""
        return Memory(state=State.INIT, entered=0.0, initial=scene.ee, command=HandTarget(scene.ee, HAND_WIDTH))

    def step(self, scene: SceneState, time: float, memory: Memory) -> tuple[HandTarget, Memory]:
        """Return the command for the coming control step, and what is known after it.

        Args:
            scene: The scene as sensed.
            time: Seconds since the start of the episode.
            memory: What was known before.
        """
        sight, places, state = Sight(self.skill, scene), self.skill.container is not None, memory.state
        closed = state in CLOSED or (state is State.TO_TARGET and not places)
        pose = _aim(sight, time, memory)
        command = HandTarget(pose, self.skill.closed if closed else HAND_WIDTH)
        outside = memory.outside + 1 if places and state is State.TO_TARGET and not sight.placed else 0
        following = _following(sight, time, memory, failed=outside >= OUTSIDE if places else sight.lost)
        memory = replace(memory, command=command)
        if following is not state:
            return command, replace(memory, state=following, entered=time, turned=None, outside=0)
        return command, replace(memory, turned=pose.rotation if state is State.APPROACH else None, outside=outside)


def _aim(sight: Sight, time: float, memory: Memory) -> Pose:
    """Return where the hand should be, `T_world_ee`."""
    match memory.state:
        case State.INIT:
            return memory.initial
        case State.RESET if not sight.reachable:
            return memory.initial
        case State.RESET | State.ABOVE:
            return raised(sight.grasp)
        case State.APPROACH:
            pose = raised(sight.grasp, _left_to_descend(time - memory.entered))
            return pose if memory.turned is None else Pose(memory.turned, pose.position)
        case State.GRASP:
            return memory.command.pose
        case State.LIFT:
            return raised(Pose(memory.command.pose.rotation, sight.object.pose.position))
        case State.ABOVE_TARGET:
            return raised(sight.place)
        case State.PLACE:
            return sight.place
        case State.TO_TARGET:
            return FINAL


def _following(sight: Sight, time: float, memory: Memory, *, failed: bool) -> State:
    """Return the state of the next control step; `failed` tells whether the object is not where it was taken."""
    state = memory.state
    waited = time - memory.entered >= WAIT[state] - 1e-9
    match state:
        case State.INIT | State.RESET if waited and sight.reachable:
            return State.ABOVE
        case State.ABOVE if not sight.reachable:
            return State.RESET
        case State.ABOVE if waited and sight.above_object and sight.yaw_error < TURNED:
            return State.APPROACH
        case State.APPROACH if waited:
            return State.GRASP
        case State.GRASP if waited:
            return State.LIFT
        case State.LIFT | State.ABOVE_TARGET if sight.lost:
            return State.RESET
        case State.LIFT if waited:
            return State.TO_TARGET if sight.skill.container is None else State.ABOVE_TARGET
        case State.ABOVE_TARGET if waited and sight.above_container:
            return State.PLACE
        case State.PLACE if waited:
            return State.TO_TARGET
        case State.TO_TARGET if failed:
            return State.RESET
    return state


def _left_to_descend(t: float) -> float:
    """Return which share of the offset is left after t seconds of a descent from rest to rest."""
    return 0.5 + 0.5 * math.cos(math.pi * min(t / DESCENT, 1.0))


class StateMachineGenerator:
    """Attempts conditions with the state machine of DynamicVLA's collector, without the planner.

    An attempt is one episode: the machine tries again within it as often as time allows. The time is the task's limit,
    the same for every generator: the collector's own, 10 s to lift and 12 s to place, belongs to its environment and
    not to its controller, and would leave it less time than others to place.

    Args:
        task: What it attempts.

    Raises:
        ValueError: It has no skill for this task.
    """

    name = "state_machine"

    def __init__(self, task: Task) -> None:
        self.machine = StateMachine(skill_for(task))

    def make_env(self, task: Task) -> TaskEnv:
        """Return a new env for it to act in, which takes poses and widths of the hand."""
        return TaskEnv(task, rotation="quat_wxyz")

    def attempt(self, env: TaskEnv, condition: Condition) -> Episode:
        """Run one episode and record it."""
        world, dt = env.world, env.task.scene.control_dt
        recorder = Recorder(env.task, world.kinematics)
        with world.listening(recorder):
            env.reset(options={"condition": condition})
            memory, step = self.machine.start(world.sensed), 0
            while env.outcome is None:
                command, memory = self.machine.step(world.sensed, step * dt, memory)
                env.step(command.flat().astype(np.float32))
                step += 1
        return episode_of(env, recorder, env.outcome, condition, generator=self.name, policy_hash="")
