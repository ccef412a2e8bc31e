"""Driving a body of a scene along a prescribed path."""

from __future__ import annotations

from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.bullet_scene import BulletScene
from dynaforge.sim.prescribed import PrescribedMotion

HEAVY = 1000.0  # kg: a push of 100 N moves a body that is driven by 2 micrometres within a substep
GRAVITY = 9.81
NOTHING = (0.0, 0.0, 0.0)


class Driver:
    """Drives a body of a scene that was just reset along its path, substep by substep.

    Meanwhile the body is so heavy that nothing moves it, its weight is carried, and after every substep it is put to
    where its path says with the velocity that leads on; its joints, such as wheels, do not turn. At the end it has its
    own mass again and is at rest; released at a contact, it keeps its velocity.

    Args:
        scene: The scene in Bullet.
        motion: The path.
        dt: Duration of a substep, seconds.

    Attributes:
        seconds: For how long the body has been driven so far; it is 0 for a body that stands.
    """

    def __init__(self, scene: BulletScene, motion: PrescribedMotion, dt: float) -> None:
        self._client, self._robot, self._free = scene.client, scene.robot.body, scene.free[motion.body]
        self._motion, self._dt = motion, dt
        self._done, self._steps = 0, round(motion.duration / dt)
        self._driven, self.seconds = self._steps > 0, 0.0
        if self._driven:
            self._mass = self._client.getDynamicsInfo(self._free.body, -1)[0]
            self._free.weigh(HEAVY)
            self._place()

    def carry(self) -> None:
        """Carry the body's weight during the next substep."""
        if self._driven:
            at = self._motion.position(self.seconds)
            self._client.applyExternalForce(self._free.body, -1, (0.0, 0.0, HEAVY * GRAVITY), at, p.WORLD_FRAME)

    def place(self) -> None:
        """After a substep, put the body where its path says, and leave it to physics if it is time."""
        if not self._driven:
            return
        self._done += 1
        arrived = self._done == self._steps
        self.seconds = self._motion.duration if arrived else self._done * self._dt  # at the end to the bit
        self._place()
        if arrived or (self._motion.release == "contact" and self._touched()):
            self._driven = False
            self._free.weigh(self._mass)

    def _touched(self) -> bool:
        return any(contact[9] > 0.0 for contact in self._client.getContactPoints(self._robot, self._free.body))

    def _place(self) -> None:
        w, x, y, z = self._motion.quat_wxyz
        time, body = self.seconds, self._free.body
        velocity = self._motion.velocity(time, self._dt)
        self._client.resetBasePositionAndOrientation(body, self._motion.position(time), (x, y, z, w))
        self._client.resetBaseVelocity(body, velocity, NOTHING)
