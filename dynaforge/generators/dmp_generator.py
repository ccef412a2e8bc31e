"""DynaMimicGen: one demonstration at rest, turned into movement primitives whose goals follow the objects."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Episode
from dynaforge.envs.task_env import TaskEnv
from dynaforge.generators.dmp import MovementPrimitive
from dynaforge.generators.dmp_segments import ReferenceFrames, nearest_turn, pose_of, segments_of, six_of
from dynaforge.generators.dmp_source import speeds
from dynaforge.generators.generator import episode_of
from dynaforge.generators.recording import Recorder
from dynaforge.geometry import Array, Pose, matrix_from_rotvec, rotvec_from_matrix
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_flag, check_kind, check_number
from dynaforge.tasks import Task
from dynaforge.tasks.digest import digest_in_any_setting

PACE = 2.0


class DmpGenerator:
    """Attempts conditions by the movement primitives of one source demonstration; `docs/rivals.md` explains it.

    It acts in a `TaskEnv`, one step of a primitive each control step, and always as long as the source. The goal of a
    segment is where the source's hand ended with respect to the object, composed with where the object is sensed now.
    The opening of the fingers is the source's at the same time. After the source's last step the hand keeps its last
    command until the env ends the episode.

    Args:
        source: The source demonstration, as `record_source` or `read_source` returns it.
        task: The task that it is of.
        pace: How many times longer the source takes wherever the fingers do not move, if all its objects were at rest.
            The time of objects that move by themselves is not changed.
        update_place_goal: Whether goals are updated after the grasp too. The released code does not do this: there
            the segments after the grasp end where the source's did.
        absolute_rotation: Whether each component of a goal's rotation vector is replaced by its absolute value, as in
            the released code.

    Raises:
        ValueError: The source does not run through the phases of the task in order.
    """

    name = "dmp"

    def __init__(
        self,
        source: Episode,
        task: Task,
        *,
        pace: float = PACE,
        update_place_goal: bool = True,
        absolute_rotation: bool = False,
    ) -> None:
        check_kind("source", source, Episode)
        check_kind("task", task, Task)
        check_number("pace", pace, least=1.0)
        check_flag("update_place_goal", update_place_goal)
        check_flag("absolute_rotation", absolute_rotation)
        resting = not any(source.condition.values[name] for name in speeds(task))
        self.segments = segments_of(source, task, pace=pace if resting else 1.0)
        self.update_place_goal = update_place_goal
        self.absolute_rotation = absolute_rotation
        options = f"{source.content_hash()} {pace} {update_place_goal} {absolute_rotation}"
        self.policy_hash = hashlib.sha256(options.encode()).hexdigest()[:16]
        self._definition = digest_in_any_setting(task)

    def make_env(self, task: Task) -> TaskEnv:
        """Return a new env for it to act in.

        Raises:
            ValueError: The source is of another definition of the task.
        """
        if digest_in_any_setting(task) != self._definition:
            raise ValueError(f"The source demonstration of generator dmp is of another definition of {task.name!r}.")
        return TaskEnv(task, rotation="quat_wxyz")

    def attempt(self, env: TaskEnv, condition: Condition) -> Episode:
        """Run one episode and record it."""
        recorder = Recorder(env.task, env.world.kinematics)
        with env.world.listening(recorder):
            env.reset(options={"condition": condition})
            commands = self._commands(env)
            done = False
            while not done:
                _, _, done, _, _ = env.step(next(commands))
        assert env.outcome is not None
        return episode_of(env, recorder, env.outcome, condition, generator=self.name, policy_hash=self.policy_hash)

    def _commands(self, env: TaskEnv) -> Iterator[NDArray[np.float32]]:
        """Yield the action of each control step from what is sensed when it is asked for, and then the last one."""
        frames = ReferenceFrames()
        six = self.segments[0].path[0]
        for index, segment in enumerate(self.segments):
            primitive, start = MovementPrimitive(segment.path), six
            primitive.restart(start)
            for step, width in enumerate(segment.widths):
                frames.push(env.world.sensed.objects)
                if step == 0:
                    frames.enter(segment.reference)
                    goal = six
                goal = self._goal(index, frames, start, near=goal)
                six = primitive.step(goal)
                pose = pose_of(six)
                action = np.concatenate((pose.position, pose.quat_wxyz, (width,))).astype(np.float32)
                yield action
        while True:
            yield action

    def _goal(self, index: int, frames: ReferenceFrames, start: Array, *, near: Array) -> Array:
        """Return the goal of a segment in the latest scene, shape (6,)."""
        segment = self.segments[index]
        if segment.reference.name != self.segments[0].reference.name and not self.update_place_goal:
            goal = pose_of(segment.path[-1])
        elif segment.T_object_hand is None:  # the hand rises from where it is, by as much as in the source
            risen: Array = start + segment.path[-1] - segment.path[0]
            return risen
        else:
            turns = segment.reference.turns
            goal = nearest_turn(frames.frame(), segment.T_object_hand, turns, pose_of(near).rotation)
        if self.absolute_rotation:
            goal = Pose(matrix_from_rotvec(np.abs(rotvec_from_matrix(goal.rotation))), goal.position)
        return six_of(goal, near)
