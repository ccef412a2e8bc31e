"""Forward and inverse kinematics of the arm on Pinocchio."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dposv  # type: ignore[import-untyped, unused-ignore]

from dynaforge.geometry import Array, Pose, one_line
from dynaforge.planning.franka_ik import franka_configurations
from dynaforge.sim.robot import ELBOW, RobotDescription

POSITION_TOLERANCE = 1e-4  # metres
ROTATION_TOLERANCE = 1e-3  # radians
MIN_DAMPING = 1e-6
DAMPING_PER_ERROR = 0.02  # damping grows with the squared error: long steps near the target, careful ones far from it
MAX_ERROR_STEP = 0.25  # metres and radians: a longer twist is followed in parts, because the Jacobian is local
LAST_JOINT_ANGLES = 59  # of the grid over its range, 0.1 rad apart
READY_PULL = 0.02  # share of the way to the ready pose taken in the null space, once per solve

_ONES = np.ones((3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class IkResult:
    """Result of solving the inverse kinematics.

    Attributes:
        q: Joint positions inside the limits, radians, shape (7,).
        position_error: Distance between the reached and the wanted end-effector position, metres.
        rotation_error: Angle between the reached and the wanted orientation, radians.
        converged: Whether both errors are within tolerance (0.1 mm, 1 mrad).
    """

    q: Array
    position_error: float
    rotation_error: float
    converged: bool

    __repr__ = one_line


@lru_cache(maxsize=4)
def load_model(urdf: Path, arm_joints: tuple[str, ...], width_max: float) -> tuple[Any, Any]:
    """Load the arm, with its fingers locked open, as a Pinocchio model and its collision geometry; cached.

    Args:
        urdf: The robot's URDF.
        arm_joints: Names of the joints that stay movable.
        width_max: Opening at which the fingers are locked, metres.
    """
    full = pin.buildModelFromUrdf(str(urdf))
    geometry = pin.buildGeomFromUrdf(full, str(urdf), pin.GeometryType.COLLISION, package_dirs=[str(urdf.parent)])
    locked = [name for name in full.names[1:] if name not in arm_joints]
    q = pin.neutral(full)
    for name in locked:
        q[full.joints[full.getJointId(name)].idx_q] = width_max / 2
    model, geometry = pin.buildReducedModel(full, geometry, [full.getJointId(name) for name in locked], q)
    return model, geometry


class ArmKinematics:
    """Forward kinematics, Jacobian and inverse kinematics of the arm.

    The end-effector frame is the robot's `ee_link`; the base frame is the world frame.

    Args:
        robot: Geometry and joint limits.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self.robot = robot
        self._model, _ = load_model(robot.urdf, robot.arm_joints, robot.width_max)
        self._data = self._model.createData()
        self._frame = self._model.getFrameId(robot.ee_link)
        self._gram = np.empty((6, 6))  # symmetric, so its transpose has the column order that LAPACK expects
        self._gram_diagonal = self._gram.reshape(-1)[::7]

    def forward(self, q: Array) -> Pose:
        """Return `T_world_ee` at joint positions q, radians, shape (7,)."""
        placement = self._place(q)
        return Pose(placement.rotation.copy(), placement.translation.copy())

    def jacobian(self, q: Array) -> Array:
        """Return the end effector's Jacobian in world axes, shape (6, 7): linear rows (m/rad), then angular ones."""
        jacobian: Array = pin.computeFrameJacobian(
            self._model, self._data, q, self._frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        return jacobian

    def solve(
        self,
        target: Pose,
        q_seed: Array,
        *,
        max_iterations: int = 3,
        position_tolerance: float = POSITION_TOLERANCE,
        rotation_tolerance: float = ROTATION_TOLERANCE,
    ) -> IkResult:
        """Bring the end effector to a target by warm-started damped least squares.

        Each step solves (J J^T + lambda I) y = e for the twist e to the target in the end-effector frame, moves by
        J^T y and clamps to the joint limits. The first step also drifts toward the ready pose in the null space. If the
        target is out of reach, the result is the clamped configuration with the least error found: the projection of
        Eq. 5.

        Args:
            target: Wanted `T_world_ee`.
            q_seed: Configuration to start from, radians, shape (7,); it is clamped to the limits.
            max_iterations: Largest number of steps.
            position_tolerance: Position error at which the solver has converged, metres.
            rotation_tolerance: Rotation error at which the solver has converged, radians.

        Raises:
            ValueError: Target or seed is not finite.
        """
        lower, upper = self.robot.q_lower, self.robot.q_upper
        q = np.minimum(np.maximum(q_seed, lower), upper)
        goal = pin.SE3(target.rotation, target.position)
        twist, position_error, rotation_error = self._error(q, goal)
        _require_finite(target, q_seed, position_error + rotation_error)
        best = (q, position_error, rotation_error)
        for iteration in range(max_iterations):
            if position_error <= position_tolerance and rotation_error <= rotation_tolerance:
                break
            q = q + self._step(q, twist, position_error + rotation_error, pull=iteration == 0)
            np.minimum(np.maximum(q, lower, out=q), upper, out=q)
            twist, position_error, rotation_error = self._error(q, goal)
            if position_error + rotation_error < best[1] + best[2]:
                best = (q, position_error, rotation_error)
        q, position_error, rotation_error = best
        converged = position_error <= position_tolerance and rotation_error <= rotation_tolerance
        return IkResult(q, position_error, rotation_error, converged)

    def solve_at_elbow(
        self, target: Pose, elbow: float, q_seed: Array, *, max_iterations: int, tolerance: float = 1e-6
    ) -> Array:
        """Bring the end effector to a target, and the third joint to an angle that determines the seventh freedom.

        The pose has priority: the elbow is turned in the null space, as far as the limits allow.

        Args:
            target: Wanted `T_world_ee`.
            elbow: Wanted angle of the third joint, radians.
            q_seed: Configuration to start from, radians, shape (7,); it is clamped to the limits.
            max_iterations: Largest number of steps.
            tolerance: Error of pose (metres and radians) and elbow (radians) at which the solver has converged.

        Returns:
            Joint positions inside the limits, radians, shape (7,): of the configurations found, the one nearest to the
            elbow among those that reach the pose; if none does, the one nearest to the pose.

        Raises:
            ValueError: Target or seed is not finite.
        """
        lower, upper = self.robot.q_lower, self.robot.q_upper
        goal = pin.SE3(target.rotation, target.position)
        q, best, least = np.clip(q_seed, lower, upper), q_seed, (math.inf, math.inf)
        for _ in range(max_iterations + 1):
            twist, *errors = self._error(q, goal)
            _require_finite(target, q_seed, sum(errors))
            rank = (0.0 if max(errors) <= tolerance else sum(errors), abs(elbow - float(q[ELBOW])))
            if rank < least:
                best, least = q, rank
            if max(rank) <= tolerance:
                break
            step = self._step(q, twist, sum(errors), pull=False)
            q = np.clip(q + step + self._elbow_step(q, elbow - q[ELBOW] - step[ELBOW]), lower, upper)
        return best

    def solve_cold(
        self,
        target: Pose,
        *,
        q_seed: Array,
        valid: Callable[[Array], bool] = lambda q: True,
        max_iterations: int = 15,
    ) -> IkResult:
        """Find a configuration that reaches a target: near a seed, or else near the seed and the ready pose.

        The first try is damped least squares from the seed. The second takes every solution in closed form, over a grid
        of angles of the last joint, in the order of its squared distances to the seed and to the ready pose. Nothing
        is drawn.

        Args:
            target: Wanted `T_world_ee`.
            q_seed: The configuration to stay near, radians, shape (7,).
            valid: What else a solution must satisfy, such as being free of collision.
            max_iterations: Largest number of steps from the seed.

        Returns:
            The first converged and valid solution; if none is valid, the first converged one; if none converged, the
            one of least error.
        """
        first = self.solve(target, q_seed, max_iterations=max_iterations)
        if first.converged and valid(first.q):
            return first
        for q in self._in_closed_form(target, (q_seed + self.robot.q_ready) / 2.0):
            result = self.solve(target, q, max_iterations=0)
            if result.converged and valid(q):
                return result
            if result.converged and not first.converged:
                first = result
        return first

    def _in_closed_form(self, target: Pose, near: Array) -> Array:
        """Return solutions over a grid of angles of the last joint, nearest first, shape (m, 7)."""
        lower, upper = self.robot.q_lower, self.robot.q_upper
        ee = self._model.frames[self._frame].placement
        last = pin.SE3(target.rotation, target.position).act(ee.inverse())
        angles = np.linspace(lower[-1], upper[-1], LAST_JOINT_ANGLES)
        found = franka_configurations(Pose(last.rotation, last.translation), angles, lower=lower, upper=upper)
        order: Array = found[np.argsort(np.square(found - near).sum(axis=1), kind="stable")]
        return order

    def _place(self, q: Array) -> Any:
        pin.forwardKinematics(self._model, self._data, q)
        return pin.updateFramePlacement(self._model, self._data, self._frame)

    def _error(self, q: Array, goal: Any) -> tuple[Array, float, float]:
        """Return the twist to the goal in the end-effector frame, and its position (m) and rotation (rad) errors."""
        difference = self._place(q).actInv(goal)
        twist: Array = pin.log6(difference).vector
        x, y, z = difference.translation.tolist()
        *_, a, b, c = twist.tolist()
        return twist, math.sqrt(x * x + y * y + z * z), math.sqrt(a * a + b * b + c * c)

    def _step(self, q: Array, twist: Array, error: float, *, pull: bool) -> Array:
        if error > MAX_ERROR_STEP:
            twist = twist * (MAX_ERROR_STEP / error)
            error = MAX_ERROR_STEP
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._frame)
        np.dot(jacobian, jacobian.T, out=self._gram)
        self._gram_diagonal += MIN_DAMPING + DAMPING_PER_ERROR * error * error
        if not pull:
            step: Array = dposv(self._gram.T, twist)[1] @ jacobian
            return step
        drift = READY_PULL * (self.robot.q_ready - q)
        pulled: Array = dposv(self._gram.T, twist - jacobian @ drift)[1] @ jacobian + drift
        return pulled

    def _elbow_step(self, q: Array, change: float) -> Array:
        """Return the step that turns the elbow and leaves the hand where it is, shape (7,)."""
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._frame)
        null = np.linalg.svd(jacobian)[2][-1]
        turn = float(null[ELBOW])
        step: Array = min(max(change * turn / (turn * turn + MIN_DAMPING), -MAX_ERROR_STEP), MAX_ERROR_STEP) * null
        return step


def _require_finite(target: Pose, q_seed: Array, error: float) -> None:
    entries = float(np.vdot(target.rotation, _ONES))  # a single NaN in the rotation can leave the error finite
    if not math.isfinite(error + entries):
        raise ValueError(
            f"Target position {target.position.tolist()}, rotation {target.rotation.tolist()} and seed "
            f"{q_seed.tolist()} must be finite."
        )
