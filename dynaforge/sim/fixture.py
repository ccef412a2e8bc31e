"""A fixture in physics: bolted down, its joints moved by motors and springs."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from dynaforge.sim.bullet import free_link, joints_and_links, load_asset, pose_of, stiffen
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.spec import Drive, FixtureSpec, Placement
from dynaforge.sim.state import BodyState

STANDING = Drive()


class Fixture:
    """One fixture of a scene with all its variants loaded; a placement chooses the one that is used.

    Joints are moved by motors, never set: at each control step their speeds are those that reach the drive's position
    at its end.

    Args:
        client: The physics client.
        spec: The description of the fixture.
        flags: Flags of Bullet's `loadURDF`.
        waiting_at: Where the variants wait that are not used, metres.
    """

    def __init__(self, client: Any, spec: FixtureSpec, *, flags: int, waiting_at: tuple[float, float, float]) -> None:
        self.spec = spec
        self._client = client
        # Looking a function up in the client costs a third of the time of a short call.
        self._joint_state, self._link_state = client.getJointState, client.getLinkState
        self._move = partial(client.setJointMotorControl2, controlMode=p.VELOCITY_CONTROL)
        x, y, z = waiting_at
        self.variants = [
            load_asset(client, urdf, flags=flags, fixed=True, position=(x, y, z + k))
            for k, urdf in enumerate(spec.urdfs)
        ]
        self._joints, self._links = [], []
        for body in self.variants:
            joints, links = joints_and_links(client, body)
            self._joints.append(joints)
            self._links.append(links[spec.link])
            self._configure(body, joints)
        self.place(None)

    def _configure(self, body: int, joints: dict[str, int]) -> None:
        client, spec = self._client, self.spec
        for link in range(-1, client.getNumJoints(body)):
            free_link(
                client,
                body,
                link,
                lateral_friction=spec.lateral_friction,
                rolling_friction=spec.rolling_friction,
                spinning_friction=0.0,
            )
        stiffen(client, body)
        self._efforts = {name: client.getJointInfo(body, index)[10] for name, index in joints.items()}
        if spec.spring is not None:
            client.setJointMotorControl2(
                body,
                joints[spec.spring.joint],
                p.POSITION_CONTROL,
                targetPosition=0.0,
                positionGain=0.2,
                velocityGain=1.0,
                force=spec.spring.force,
            )

    def place(self, placement: Placement | None) -> None:
        """Put one variant where a condition places it; None leaves all of them waiting."""
        variant = placement.variant if placement is not None else 0
        self.body, self._link = self.variants[variant], self._links[variant]
        self._still: BodyState | None = None
        joints = self._joints[variant]
        self._spring_joint = joints[self.spec.spring.joint] if self.spec.spring is not None else None
        drives = placement.drives if placement is not None else {}
        self._motors = [(joints[name], drives.get(name, STANDING), self._efforts[name]) for name in self.spec.driven]
        # Bullet solves all bodies together, so that a running motor of a waiting variant would change the others' bits.
        for body, its_joints in zip(self.variants, self._joints, strict=True):
            for name in self.spec.driven:
                self._client.setJointMotorControl2(
                    body, its_joints[name], p.VELOCITY_CONTROL, targetVelocity=0.0, force=self._efforts[name]
                )
        if placement is None:
            return
        w, x, y, z = placement.pose.quat_wxyz.tolist()
        self._client.resetBasePositionAndOrientation(self.body, placement.pose.position.tolist(), (x, y, z, w))
        for joint, drive, _ in self._motors:
            self._client.resetJointState(self.body, joint, drive.start, drive.speed(0.0))

    def drive(self, time: float, dt: float) -> None:
        """Command the speeds that bring every driven joint within `dt` seconds to its position at `time`."""
        self.command(self.due(time, dt))

    def due(self, time: float, dt: float) -> list[float]:
        """Return the speeds of `drive`, rad/s or m/s, in the order of `FixtureSpec.driven`."""
        state = self._joint_state
        return [(drive.position(time) - state(self.body, joint)[0]) / dt for joint, drive, _ in self._motors]

    def command(self, speeds: list[float]) -> None:
        """Command the speeds of the motors, rad/s or m/s, in the order of `FixtureSpec.driven`."""
        for (joint, _, effort), speed in zip(self._motors, speeds, strict=True):
            self._move(self.body, joint, targetVelocity=speed, force=effort)

    def observe(self) -> BodyState:
        """Return pose and velocities of the tracked link; where nothing can move it, the same state every time."""
        if self._still is not None:
            return self._still
        if self._link == -1:
            pose = pose_of(*self._client.getBasePositionAndOrientation(self.body))
            self._still = BodyState(pose, np.zeros(3), np.zeros(3))
            return self._still
        link = self._link_state(self.body, self._link, computeLinkVelocity=1, computeForwardKinematics=1)
        return BodyState(pose_of(link[4], link[5]), np.array(link[6]), np.array(link[7]))

    @property
    def tracked(self) -> dict[int, int]:
        """Index of the tracked link of each variant, by the index of its body; -1 is the root link."""
        return dict(zip(self.variants, self._links, strict=True))

    @property
    def pressed(self) -> float:
        """How far its spring is pressed in, metres; 0 without a spring."""
        if self._spring_joint is None:
            return 0.0
        return -float(self._joint_state(self.body, self._spring_joint)[0])
