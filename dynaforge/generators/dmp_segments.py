"""The segments of a source demonstration: what each moves relative to, and the poses of that in a scene."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from dynaforge.demos import Episode
from dynaforge.generators.dmp import MIN_SAMPLES
from dynaforge.geometry import (
    Array,
    Pose,
    matrix_from_quat,
    matrix_from_rotvec,
    one_line,
    rotation_z,
    rotvec_from_matrix,
)
from dynaforge.sim import BodyState
from dynaforge.tasks import Phase, Task
from dynaforge.tasks.targets import DOWN_ALONG_X, Catching, Grip, Pressing, Raised
from dynaforge.tasks.view import HEADING_SPEED, heading_frame, yaw

Turns = Literal["none", "half", "quarter", "all"]
"""The turns about the vertical that leave a grasp of an object as good as it was."""
_TURNS: Mapping[Turns, tuple[float, ...]] = {
    "none": (0.0,),
    "half": (0.0, math.pi),
    "quarter": (0.0, math.pi / 2, math.pi, -math.pi / 2),
}


@dataclass(frozen=True, slots=True)
class Reference:
    """What the hand moves relative to in a segment.

    Attributes:
        name: The body or fixture; "" where the hand only rises from where it is.
        turns: The symmetry of its grasp. "half": its frame is the heading frame; "quarter": its own yaw counts.
        beside: A body whose offset to the side, as the segment begins, moves the frame; "" for none.
        sinks: Whether it yields to the hand, as a button does; its frame stays as high as where the segment begins.
    """

    name: str
    turns: Turns = "all"
    beside: str = ""
    sinks: bool = False

    @staticmethod
    def of(phase: Phase) -> Reference:
        """Return the reference of a phase, as its target names it."""
        target = phase.target
        if isinstance(target, Raised):
            return Reference("")
        if isinstance(target, Catching):  # the hand waits at the fixture, not where the object still is
            return Reference(target.fixture, "none", target.object)
        grip = getattr(target, "grip", Grip.KEPT)
        turns: Turns = "quarter" if grip is Grip.FACES else "all" if grip is Grip.KEPT else "half"
        return Reference(target.object, turns, sinks=isinstance(target, Pressing))


class ReferenceFrames:
    """Follows the frame `T_world_object` of a reference, which changes from segment to segment.

    A frame is upright unless its reference has no symmetry, so that the hand does not roll along with what it grasps.
    """

    def __init__(self) -> None:
        self._headings: dict[str, Pose] = {}
        self._bodies: Mapping[str, BodyState] = {}
        self._reference, self._aside, self._height = Reference(""), 0.0, 0.0

    def push(self, bodies: Mapping[str, BodyState]) -> None:
        """Take in the bodies of a scene, once for each control step."""
        self._bodies = bodies
        for name, body in bodies.items():
            before = self._headings.get(name)
            if before is None and np.linalg.norm(body.velocity[:2]) <= HEADING_SPEED:
                self._headings[name] = Pose(rotation_z(_yaw_at_rest(body.pose)), body.pose.position)
            else:
                self._headings[name] = heading_frame(body, before)

    def enter(self, reference: Reference) -> None:
        """Follow another reference from the latest scene on."""
        self._reference, self._aside = reference, 0.0
        if reference.sinks:
            self._height = float(self._bodies[reference.name].pose.position[2])
        if reference.beside:
            beside = self._bodies[reference.beside].pose.position
            self._aside = float(self._bodies[reference.name].pose.inverse().apply(beside)[1])

    def frame(self) -> Pose:
        """Return the frame of the reference in the latest scene."""
        name, turns = self._reference.name, self._reference.turns
        pose = self._bodies[name].pose
        if turns == "half":
            return self._headings[name]
        if turns == "quarter":
            return Pose(rotation_z(yaw(pose)), pose.position)
        if self._reference.sinks:
            return Pose(np.eye(3), np.array((*pose.position[:2], self._height)))
        if turns == "all":
            return Pose(np.eye(3), pose.position)
        return Pose(pose.rotation, pose.position + self._aside * pose.rotation[:, 1])


def _yaw_at_rest(pose: Pose) -> float:
    """Return the heading of a body that does not move: across its z axis if it lies on its side, else its own yaw."""
    x, y, z = pose.rotation[:, 2].tolist()
    return math.atan2(y, x) + math.pi / 2 if abs(z) < 0.5 else yaw(pose)


def nearest_turn(frame: Pose, pose: Pose, turns: Turns, rotation: Array) -> Pose:
    """Return `T_world_hand`, of those that the symmetry of a grasp makes equal the one nearest to a rotation.

    Args:
        frame: `T_world_object`.
        pose: `T_object_hand`.
        turns: The turns that may be chosen from: about the axis of the hand, which keep it on its side of the object,
            but for "all", which are about the vertical through the object and take along what the hand holds.
        rotation: What its rotation shall be near to, world frame, shape (3, 3).
    """
    goal = frame @ pose
    if turns == "all":  # the turn by which the trace of the relative rotation is greatest
        between = goal.rotation @ rotation.T
        angle = math.atan2(between[0, 1] - between[1, 0], between[0, 0] + between[1, 1])
        return Pose(rotation_z(angle) @ frame.rotation, frame.position) @ pose
    candidates = (goal.rotation @ rotation_z(angle) for angle in _TURNS[turns])
    return Pose(max(candidates, key=lambda candidate: float(np.vdot(candidate, rotation))), goal.position)


def six_of(pose: Pose, near: Array | None = None) -> Array:
    """Return position (m) and rotation vector from the hand that points straight down (rad), shape (6,).

    Args:
        pose: Pose of the hand.
        near: Six such numbers; of the rotation vectors that differ by whole turns, the nearest to theirs is returned.
            None for the shortest.
    """
    rotvec = rotvec_from_matrix(pose.rotation @ DOWN_ALONG_X.T)
    angle = float(np.linalg.norm(rotvec))
    if near is not None and angle > 1e-9:
        turn = rotvec * (2.0 * math.pi / angle)
        candidates = (rotvec, rotvec - turn, rotvec + turn)
        rotvec = min(candidates, key=lambda candidate: float(np.linalg.norm(candidate - near[3:])))
    return np.concatenate((pose.position, rotvec))


def pose_of(six: Array) -> Pose:
    """Return the pose of the hand that six numbers of `six_of` stand for."""
    return Pose(matrix_from_rotvec(six[3:]) @ DOWN_ALONG_X, six[:3].copy())


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """One subtask of the source demonstration.

    Attributes:
        phases: Names of its phases.
        reference: What the hand moves relative to.
        path: The commanded hand at every control step, as `six_of` returns it, shape (T, 6).
        widths: The commanded opening at every control step, metres, shape (T,).
        T_object_hand: The hand at the end, in the frame of the reference; None where the hand only rises.
    """

    phases: tuple[str, ...]
    reference: Reference
    path: Array
    widths: Array
    T_object_hand: Pose | None

    __repr__ = one_line


def subtasks(phases: Sequence[Phase]) -> list[list[int]]:
    """Group the phases of a program into subtasks: every phase is one, but for those in which the fingers move.

    These belong to what led there, if it has the same reference: otherwise a primitive would begin with the object
    between the fingers, and its goal would follow the hand that pushes the object.

    Returns:
        The indices of the phases of each subtask.
    """
    groups = [[0]]
    for k, (before, phase) in enumerate(pairwise(phases), start=1):
        if phase.width == before.width or Reference.of(phase) != Reference.of(before):
            groups.append([])
        groups[-1].append(k)
    return groups


def segments_of(episode: Episode, task: Task, *, pace: float = 1.0) -> list[Segment]:
    """Cut the recording of a success into segments.

    Args:
        episode: A recording of the planner.
        task: Its task.
        pace: How many times longer everything takes during which the fingers do not move.

    Raises:
        ValueError: The recording does not run through the phases of the task in order.
    """
    steps, phase = episode.steps, np.asarray(episode.steps.get("phase", ()))
    if not len(phase) or (np.diff(phase) < 0).any() or set(phase.tolist()) != set(range(len(task.phases))):
        raise ValueError(
            f"A source demonstration runs through the phases of {task.name!r} in order; this one does not."
        )
    hands, widths = _path(np.asarray(steps["projected_action"])), np.asarray(steps["projected_action"])[:, 7]
    groups = iter(subtasks(task.phases))
    frames, segments, end = ReferenceFrames(), [], -1
    for k in range(len(phase)):
        frames.push(_bodies(episode, task, k))
        if k > end:
            begin, group = k, next(groups)
            end = int(np.flatnonzero(phase == group[-1])[-1])
            reference = Reference.of(task.phases[group[-1]])
            frames.enter(reference)
        if k == end:
            relative = frames.frame().inverse() @ pose_of(hands[k]) if reference.name else None
            names = tuple(task.phases[index].name for index in group)
            path, opening = slowed(hands[begin : k + 1], widths[begin : k + 1], pace)
            segments.append(Segment(names, reference, path, opening, relative))
    return segments


def slowed(path: Array, widths: Array, pace: float) -> tuple[Array, Array]:
    """Return path and openings of a segment with a sample for each control step of a slower motion.

    The fingers take as long as before. There are at least three samples, as a primitive needs them.

    Args:
        path: The path, shape (T, 6).
        widths: The openings, shape (T,).
        pace: How many times longer a step takes during which the fingers do not move.
    """
    times = np.concatenate(((0.0,), np.cumsum(np.where(np.diff(widths) == 0.0, pace, 1.0))))
    samples = np.linspace(0.0, times[-1], max(round(times[-1]) + 1, MIN_SAMPLES))
    columns = [np.interp(samples, times, column) for column in (*path.T, widths)]
    return np.column_stack(columns[:-1]), columns[-1]


def _path(commands: Array) -> Array:
    """Return the commanded hand at every control step, its rotation vectors without jumps, shape (T, 6)."""
    path: list[Array] = []
    for row in commands:
        pose = Pose(matrix_from_quat(row[3:7]), row[:3])
        path.append(six_of(pose, path[-1] if path else None))
    return np.array(path)


def _bodies(episode: Episode, task: Task, k: int) -> dict[str, BodyState]:
    """Return the bodies and fixtures at the beginning of a recorded control step."""
    free = {body.name for body in task.scene.bodies}
    found = {}
    for name in task.scene.names:
        position, quat, velocity, spin = (
            episode.steps[f"{'object' if name in free else 'fixture'}/{name}/{column}"][k]
            for column in ("position", "quat_wxyz", "velocity", "angular_velocity")
        )
        found[name] = BodyState(Pose.from_quat(position, quat), velocity, spin)
    return found
