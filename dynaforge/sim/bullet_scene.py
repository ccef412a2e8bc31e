"""A scene in Bullet's indices, which never leave this package: `SimScene` speaks in names."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynaforge.sim.bullet import connect, free_link, joints_and_links, load_asset, plain_urdf, soften_hand, stiffen
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.camera import Visuals
from dynaforge.sim.fixture import Fixture
from dynaforge.sim.hand import couple_fingers
from dynaforge.sim.robot import RobotDescription
from dynaforge.sim.spec import BodySpec, Launch, SceneSpec

MAX_JOINT_SPEED = 1000.0  # rad/s, of free joints such as wheels
PARKING_HEIGHT = 5.0  # metres; in the saved state bodies wait up here, out of contact


@dataclass(frozen=True, slots=True, eq=False)
class BulletRobot:
    """The robot in Bullet.

    Attributes:
        body: Index of the body.
        arm, fingers: Indices of the joints, in the order of the description.
        ee: Index of the link whose frame is the end-effector frame.
    """

    body: int
    arm: list[int]
    fingers: list[int]
    ee: int


@dataclass(frozen=True, slots=True, eq=False)
class FreeBody:
    """A free body in Bullet.

    Attributes:
        client: The physics client.
        body: Index of the body.
        joints: Indices of its joints, which turn without motors, by name.
        inertia_per_kg: Principal moments of inertia of the root link, divided by its mass, m^2.
    """

    client: Any
    body: int
    joints: dict[str, int]
    inertia_per_kg: list[float]

    def launch(self, name: str, launch: Launch, mass: float) -> None:
        """Start the body as a condition says, with a mass of its root link in kilograms.

        Raises:
            ValueError: It turns a joint that the body, whose name is `name`, does not have.
        """
        client = self.client
        w, x, y, z = launch.pose.quat_wxyz.tolist()
        self.weigh(mass)
        client.resetBasePositionAndOrientation(self.body, launch.pose.position.tolist(), (x, y, z, w))
        client.resetBaseVelocity(self.body, launch.velocity.tolist(), launch.angular_velocity.tolist())
        if unknown := [joint for joint in launch.joint_speeds if joint not in self.joints]:
            raise ValueError(f"Body {name!r} has no joints {unknown}; it has {sorted(self.joints)}.")
        for joint, speed in launch.joint_speeds.items():
            client.resetJointState(self.body, self.joints[joint], 0.0, speed)

    def weigh(self, mass: float) -> None:
        """Give the root link a mass in kilograms, and moments of inertia in proportion."""
        inertia = [mass * i for i in self.inertia_per_kg]
        self.client.changeDynamics(self.body, -1, mass=mass, localInertiaDiagonal=inertia)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BulletScene:
    """Everything that `load_scene` loaded.

    Attributes:
        client: The physics client, to which all indices belong.
        robot: The robot.
        table: Index of the table.
        free: Free bodies by name.
        fixtures: Fixtures by name.
    """

    client: Any
    robot: BulletRobot
    table: int
    free: dict[str, FreeBody]
    fixtures: dict[str, Fixture]

    @property
    def bodies(self) -> dict[str, int]:
        """Indices of the bodies in the scene now, by name: robot, table, free bodies, current variants of fixtures."""
        free = {name: free.body for name, free in self.free.items()}
        fixtures = {name: fixture.body for name, fixture in self.fixtures.items()}
        return {"robot": self.robot.body, "table": self.table, **free, **fixtures}


def load_scene(spec: SceneSpec, robot: RobotDescription, *, visuals: Visuals, gui: bool) -> BulletScene:
    """Open a physics world and load robot, table, bodies and fixtures, in this order.

    The order is part of the physics, because the solver processes contacts in that order.

    Args:
        spec: What the scene contains.
        robot: Geometry and limits.
        visuals: Which visual shapes to load, as in `SimScene`.
        gui: Whether to open Bullet's window.
    """
    client = connect(gui=gui)
    # Without this flag Bullet turns a URDF cylinder into a prism of 32 sides, which decelerates at 0.2 m/s^2 rolling.
    flags = p.URDF_USE_IMPLICIT_CYLINDER
    if not (visuals or gui):
        flags |= p.URDF_IGNORE_VISUAL_SHAPES
    client.setPhysicsEngineParameter(
        fixedTimeStep=spec.physics_dt,
        numSolverIterations=spec.solver_iterations,
        deterministicOverlappingPairs=1,
        enableFileCaching=0,
    )
    client.setGravity(0, 0, -9.81)
    with plain_urdf(robot.urdf) if visuals == "plain" else contextlib.nullcontext(robot.urdf) as urdf:
        body = client.loadURDF(str(urdf), useFixedBase=True, flags=flags)
    return BulletScene(
        client=client,
        robot=_prepare_robot(client, body, robot, finger_friction=spec.finger_friction),
        table=_load_table(client, flags=flags),
        free={body.name: _load_body(client, body, k, flags=flags) for k, body in enumerate(spec.bodies)},
        fixtures={
            fixture.name: Fixture(client, fixture, flags=flags, waiting_at=(0.0, -1.0 - k, PARKING_HEIGHT))
            for k, fixture in enumerate(spec.fixtures)
        },
    )


def _prepare_robot(client: Any, body: int, robot: RobotDescription, *, finger_friction: float) -> BulletRobot:
    joints, links = joints_and_links(client, body)
    arm = [joints[name] for name in robot.arm_joints]
    fingers = [joints[name] for name in robot.finger_joints]
    for joint, q in zip(arm, robot.q_ready.tolist(), strict=True):
        client.resetJointState(body, joint, q)
    for joint in fingers:
        client.resetJointState(body, joint, robot.width_max / 2)
        client.changeDynamics(body, joint, lateralFriction=finger_friction, spinningFriction=0.02, rollingFriction=0.0)
    stiffen(client, body)
    soften_hand(client, body, fingers)
    couple_fingers(client, body, fingers)
    client.changeDynamics(body, -1, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING)
    return BulletRobot(body, arm, fingers, links[robot.ee_link])


def _load_table(client: Any, *, flags: int) -> int:
    table = load_asset(client, "table/table.urdf", flags=flags, fixed=True, position=(0.0, 0.0, 0.0))
    client.changeDynamics(table, -1, lateralFriction=0.8, rollingFriction=0.0, spinningFriction=0.0)
    stiffen(client, table)
    return table


def _load_body(client: Any, spec: BodySpec, k: int, *, flags: int) -> FreeBody:
    body = load_asset(client, spec.urdf, flags=flags, fixed=False, position=(0.0, k, PARKING_HEIGHT))
    joints, links = joints_and_links(client, body)
    for link in links.values():
        free_link(
            client,
            body,
            link,
            lateral_friction=spec.lateral_friction,
            rolling_friction=spec.rolling_friction,
            spinning_friction=spec.spinning_friction,
        )
    for joint in joints.values():  # by default Bullet brakes every joint with a motor, and limits it to 100 rad/s
        client.changeDynamics(body, joint, maxJointVelocity=MAX_JOINT_SPEED)
        client.setJointMotorControl2(body, joint, p.VELOCITY_CONTROL, targetVelocity=0.0, force=0.0)
    mass, _, inertia = client.getDynamicsInfo(body, -1)[:3]
    return FreeBody(client, body, joints, (np.array(inertia) / mass).tolist())
