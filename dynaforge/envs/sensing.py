"""What planner and policy see with real sensing: the scene as it was, its objects where a tracker takes them to be.

All that is sensed in one control step has the same age, 0 to 2 control steps, joint readings and object poses alike. To
the pose of each object is added an offset that stays for the episode, as the calibration of a camera leaves it, and
noise that is new in every control step, as a tracker's estimate jitters. Velocities are not measured: they are those
of the line through the latest poses. Age, offsets and noise follow from the condition.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from dynaforge.geometry import Array, Pose, matrix_from_rotvec, rotvec_from_matrix
from dynaforge.sim import BodyState, Condition, SceneState
from dynaforge.sim.delays import DelayLine, Delays

# Standard deviations along and about each axis, metres and radians.
POSE_OFFSET = (0.002, math.radians(2.0))
POSE_NOISE = (0.001, math.radians(1.0))
_STREAM = 0x73656E73  # keeps these draws apart from all others that a condition's seed decides

RATE_WEIGHTS = np.array((0.2, 0.3, 0.3, 0.2))
"""Weights of the latest differences of poses, oldest first: the slope of the least-squares line through five values."""


class Sensor:
    """Turns the true scene of every control step into the sensed one.

    Args:
        control_dt: Duration of a control step, seconds.
    """

    def __init__(self, control_dt: float) -> None:
        self._dt = control_dt

    def reset(self, truth: SceneState, condition: Condition) -> SceneState:
        """Return the sensed scene at t = 0.

        The tracker has followed the objects before t = 0, when they moved with the velocities that they then have.

        Args:
            truth: The scene at t = 0.
            condition: Fixes delay, offsets and noise.
        """
        delay, dt = Delays.drawn_by(condition).sensing, self._dt
        self._rng = np.random.default_rng((condition.seed, _STREAM))
        self._tracks = {name: PoseTrack(self._draw(POSE_OFFSET), dt) for name in truth.objects}
        for k in range(len(RATE_WEIGHTS), 0, -1):
            self._sensed(_earlier(truth, (delay + k) * dt))
        self._late = DelayLine([_earlier(truth, k * dt) for k in range(delay, 0, -1)])
        return self.push(truth)

    def push(self, truth: SceneState) -> SceneState:
        """Take in the true scene after a control step and return the sensed one; its time is the present."""
        return replace(self._sensed(self._late.push(truth)), time=truth.time)

    def _sensed(self, measured: SceneState) -> SceneState:
        bodies = measured.objects.items()
        objects = {name: self._tracks[name].push(body.pose, self._draw(POSE_NOISE)) for name, body in bodies}
        return replace(measured, objects=objects)

    def _draw(self, deviations: tuple[float, float]) -> Array:
        drawn: Array = self._rng.standard_normal(6) * np.repeat(deviations, 3)
        return drawn


class PoseTrack:
    """The sensed poses of one body, and the velocities that follow from them.

    Args:
        offset: Error of every pose: translation (m) and rotation vector (rad) in the axes of the world, shape (6,).
        dt: Time between two poses, seconds.
    """

    def __init__(self, offset: Array, dt: float) -> None:
        self._offset, self._dt = offset, dt
        self._last: Pose | None = None
        self._moved: deque[Array] = deque(maxlen=len(RATE_WEIGHTS))
        self._turned: deque[Array] = deque(maxlen=len(RATE_WEIGHTS))

    def push(self, pose: Pose, noise: Array) -> BodyState:
        """Take in a true pose and return the body as sensed.

        Its velocity is that of its origin. Both velocities are 0 until there are enough poses for `RATE_WEIGHTS`. A
        body that turns by more than half a turn from one pose to the next seems to turn the other way.

        Args:
            pose: `T_world_body`.
            noise: Error of this pose only, like the offset.
        """
        error = self._offset + noise
        pose = Pose(matrix_from_rotvec(error[3:]) @ pose.rotation, pose.position + error[:3])
        if self._last is not None:
            self._moved.append(pose.position - self._last.position)
            self._turned.append(rotvec_from_matrix(pose.rotation @ self._last.rotation.T))
        self._last = pose
        return BodyState(pose, self._rate(self._moved), self._rate(self._turned))

    def _rate(self, differences: deque[Array]) -> Array:
        if len(differences) < len(RATE_WEIGHTS):
            return np.zeros(3)
        rate: Array = RATE_WEIGHTS @ np.array(differences) / self._dt
        return rate


def _earlier(state: SceneState, seconds: float) -> SceneState:
    """Return a scene whose objects are where they were, had they always moved with their present velocities."""
    return replace(state, objects={name: _moved_back(body, seconds) for name, body in state.objects.items()})


def _moved_back(body: BodyState, seconds: float) -> BodyState:
    turn = matrix_from_rotvec(-seconds * body.angular_velocity)
    pose = Pose(turn @ body.pose.rotation, body.pose.position - seconds * body.velocity)
    return BodyState(pose, body.velocity, body.angular_velocity)
