"""Eq. 5 of the paper, all of it: the planner's action, corrected by the policy, projected onto the robot's limits.

The equation, evaluated at every control step:

    a = project(a_plan + m * scale * a_res)

Its symbols, and where each of them is computed:

    a_plan    the planner's target for the hand: a pose and an opening (`PlannedAction.target`)
    a_res     the policy's action, one number in [-1, 1] per dimension, the same for all control steps of a decision
    scale     metres and radians per unit, the phase's share included (`ResidualScale.physical`)
    frame     the axes of a_res: the heading frame of the phase's object, with which the residual turns at every
              control step, or the world (`ResidualScale.physical`)
    m         the gate, 1 or 0: whether the running phase lets the residual act (`gated`)
    +         positions and widths add; the rotation vector turns the hand in place (`requested_target`)
    project   the hand above the table and above what lies below in this phase (`PlannedAction.lowest`), an opening
              that the hand has, and of what then remains the nearest joint motion within position, velocity,
              acceleration and jerk limits (`project`)
"""

from __future__ import annotations

import numpy as np

from dynaforge.envs.executor import PhaseExecutor, PlannedAction
from dynaforge.geometry import Array
from dynaforge.planning import JointReference, LocalPlanner
from dynaforge.sim import HandTarget
from dynaforge.tasks import Frame, ResidualSpec

RESOLUTION = 2.0**-24  # of an action, that of a float32 near 1: so a recorded residual tells its action to the bit


class ResidualScale:
    """Scale and frame of Eq. 5: turns the policy's action into metres and radians along the axes of the world.

    Dimensions of scale 0 are switched off: an action has no number for them.

    Args:
        spec: The task's scales and frame.

    Attributes:
        frame: "target" or "world".
        size: Size of an action.
    """

    def __init__(self, spec: ResidualSpec) -> None:
        self.frame: Frame = spec.frame
        scales = np.array(spec.scales)
        self._active = np.flatnonzero(scales)
        self._scales = scales[self._active]
        self.size = len(self._active)

    def read(self, action: Array) -> Array:
        """Return a_res of Eq. 5: the action within [-1, 1] and in multiples of `RESOLUTION`, shape (size,)."""
        rounded: Array = np.round(action.clip(-1.0, 1.0) / RESOLUTION) * RESOLUTION
        return rounded + 0.0  # no -0.0, whose bits are others

    def physical(self, action: Array, executor: PhaseExecutor) -> Array:
        """Return scale * a_res of Eq. 5 in the axes of the world, shape (7,): metres, radians, metres of width.

        An action that is kept turns with its frame, so this is evaluated anew at every control step.

        Args:
            action: a_res, shape (size,).
            executor: The running program, which knows the phase's share of the scales and the heading of its object.
        """
        residual = np.zeros(7)
        residual[self._active] = executor.phase.residual_share * self._scales * action
        if self.frame == "target":
            rotation = executor.frame.rotation
            residual[:3] = rotation @ residual[:3]
            residual[3:6] = rotation @ residual[3:6]
        return residual

    def nearest_action(self, residual: Array, executor: PhaseExecutor) -> Array:
        """Return the action whose physical residual is nearest to a given one now, shape (size,).

        Args:
            residual: A residual such as `physical` returns, shape (7,).
            executor: As for `physical`.
        """
        local = residual.copy()
        if self.frame == "target":
            to_frame = executor.frame.rotation  # row vectors: v_frame = v_world @ R_world_frame
            local[:3] = residual[:3] @ to_frame
            local[3:6] = residual[3:6] @ to_frame
        bound = executor.phase.residual_share * self._scales
        return self.read(local[self._active] / bound)


def gated(residual: Array | None, planned: PlannedAction) -> Array | None:
    """Return m * scale * a_res of Eq. 5: the physical residual while the gate is open, None while it is closed."""
    return residual if planned.gate else None


def requested_target(planned: PlannedAction, residual: Array | None) -> HandTarget:
    """Return the sum of Eq. 5, the target requested of the hand before it is projected.

    Args:
        planned: a_plan.
        residual: The residual that `gated` returns, shape (7,); None leaves the plan as it is.
    """
    return planned.target if residual is None else planned.target.corrected(residual)


def project(requested: HandTarget, planned: PlannedAction, local: LocalPlanner) -> JointReference:
    """Return the projection of Eq. 5: the joint reference nearest to a requested target that the limits allow.

    A sample of a global plan is within all limits already, so it is followed as it is; the gate is closed in its phase.

    Args:
        requested: The target that `requested_target` returns.
        planned: a_plan; in a global phase it contains the sample.
        local: The local planner, which moves the joint reference.
    """
    if planned.sample is not None:
        return local.follow(planned.sample, requested.width)
    return local.track(requested.within_reach(local.robot, lowest=planned.lowest))
