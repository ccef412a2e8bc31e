"""What pushes against the robot: contact forces, seen at every substep, and the reflex that they set off."""

from __future__ import annotations

import numpy as np

from dynaforge.geometry import Array
from dynaforge.sim.arm_dynamics import ArmDynamics
from dynaforge.sim.contacts import Found
from dynaforge.sim.loads import NO_LOADS, Loads, StepLoads
from dynaforge.sim.reflex import NAMED, THRESHOLDS, Thresholds


class ForceWatch:
    """Sums the contact forces on the robot at every substep.

    All contacts count as if they acted on the hand. The robot's filter is modelled by the mean over a control step; its
    reflex acts when the mean exceeds a threshold in two control steps in a row.

    Args:
        dynamics: Gives the Jacobian.
        thresholds: Those of the reflex.

    Attributes:
        tripped: Whether the reflex has stopped the robot.
    """

    def __init__(self, dynamics: ArmDynamics, thresholds: Thresholds) -> None:
        self._dynamics = dynamics
        levels = (*(THRESHOLDS[name] for name in NAMED), thresholds)
        self._levels = np.array([(level.force, level.moment, *level.torque) for level in levels])
        self.reset()

    def reset(self) -> None:
        """Forget the loads of the episode before."""
        self._rows: list[tuple[float, ...]] = []
        self._counts: list[int] = []
        self._before = NO_LOADS
        self._shares_before = self._most_shares = np.zeros(len(self._levels))
        self._peaks = np.zeros(4)
        self.tripped = False

    @property
    def loads(self) -> Loads:
        """The greatest loads of the episode so far."""
        peak_force, force, peak_torque, torque = self._peaks.tolist()
        shares = dict(zip(NAMED, self._most_shares[:-1].tolist(), strict=True))  # the last are those of the reflex
        return Loads(peak_force=peak_force, force=force, peak_torque=peak_torque, torque=torque, **shares)

    def see(self, contacts: Found) -> None:
        """Note the robot's contacts of the substep just made."""
        self._counts.append(len(contacts))
        if contacts:
            # Point, normal and its force, both directions of friction and theirs.
            self._rows += [(*c[5], *c[7], c[9], *c[11], c[10], *c[13], c[12]) for c in contacts]

    def end_step(self, q: Array, origin: Array) -> StepLoads:
        """Return the loads since the last call, a control step ago, and set `tripped` once the reflex acts.

        A call without a substep since the last one changes nothing and returns the same loads.

        Args:
            q: Measured joint positions, radians, shape (7,).
            origin: Origin of the end-effector frame, world frame, metres, shape (3,).
        """
        if not self._counts:
            return self._before
        step, shares = self._sum(q, origin) if self._rows else (NO_LOADS, np.zeros(len(self._levels)))
        self._rows, self._counts = [], []
        if step is NO_LOADS and self._before is NO_LOADS:
            return step
        lasting = np.minimum(shares, self._shares_before)
        self.tripped = self.tripped or bool(lasting[-1] > 1.0)
        force = float(np.linalg.norm(step.force + self._before.force)) / 2.0
        torque = float(np.abs(step.torque + self._before.torque).max()) / 2.0
        self._peaks = np.maximum(self._peaks, (step.peak_force, force, step.peak_torque, torque))
        self._most_shares = np.maximum(self._most_shares, lasting)
        self._before, self._shares_before = step, shares
        return step

    def _sum(self, q: Array, origin: Array) -> tuple[StepLoads, Array]:
        """Return the loads of the control step, and their shares of the thresholds."""
        rows = np.array(self._rows)
        forces = rows[:, 6:7] * rows[:, 3:6] + rows[:, 10:11] * rows[:, 7:10] + rows[:, 14:] * rows[:, 11:14]
        wrenches = np.zeros((len(self._counts), 6))
        substep = np.repeat(np.arange(len(self._counts)), self._counts)
        np.add.at(wrenches, substep, np.hstack((forces, _cross(rows[:, :3] - origin, forces))))
        torques = wrenches @ self._dynamics.jacobian(q)
        mean, torque = wrenches.mean(axis=0), torques.mean(axis=0)
        step = StepLoads(
            mean[:3], torque, float(np.linalg.norm(wrenches[:, :3], axis=1).max()), float(np.abs(torques).max())
        )
        loads = np.concatenate(((np.linalg.norm(mean[:3]), np.linalg.norm(mean[3:])), np.abs(torque)))
        return step, (loads / self._levels).max(axis=1)


def _cross(a: Array, b: Array) -> Array:
    """Return the cross products of rows, shape (n, 3); np.cross takes three times as long on a few of them."""
    after, before = [1, 2, 0], [2, 0, 1]
    product: Array = a[:, after] * b[:, before] - a[:, before] * b[:, after]
    return product
