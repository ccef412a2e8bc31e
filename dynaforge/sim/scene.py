"""The PyBullet scene: robot, table, free bodies and fixtures, reset exactly and stepped at the control rate."""

from __future__ import annotations

import contextlib
from functools import partial

import numpy as np

from dynaforge.geometry import Array
from dynaforge.sim.bullet import connect, free_link, joints_and_links, load_asset, plain_urdf, pose_of, stiffen
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.checks import check_flag, check_kind
from dynaforge.sim.condition import Condition
from dynaforge.sim.fixture import Fixture
from dynaforge.sim.robot import RobotDescription, franka
from dynaforge.sim.spec import Launch, Placement, SceneSpec
from dynaforge.sim.state import BodyState, SceneState

POSITION_GAIN = 0.3
VELOCITY_GAIN = 1.0
FINGER_SPEED_MARGIN = 0.995  # the gear between the fingers adds up to 0.2 % to the motor's own limit
MAX_JOINT_SPEED = 1000.0  # rad/s, of free joints such as wheels
PARKING_HEIGHT = 5.0  # metres: bodies wait here, out of contact, in the saved state
PARKED_STEPS = 2  # substeps at each reset, the second to see that the list of pairs is empty
# Collision group and mask, the latter two as Bullet gives them at loading.
WITH_NOTHING, FREE, BOLTED = (0, 0), (1, -1), (2, -3)


class SimScene:
    """One physics world that runs episode after episode.

    Same condition and same references give the same bits, whatever was simulated before in this process: each reset
    restores a state saved with nothing in contact (a plain teleport would keep Bullet's contact caches alive).

    Args:
        spec: What the scene holds.
        robot: Geometry and limits; the Franka by default.
        visuals: Load visual shapes, which rendering needs and training does not; "plain" draws the robot by its
            collision meshes, 3,400 triangles instead of 100,000, a picture in a fifth of the time.
        gui: Open Bullet's window.

    Raises:
        ValueError: An argument is of the wrong kind.
    """

    def __init__(
        self,
        spec: SceneSpec,
        *,
        robot: RobotDescription | None = None,
        visuals: bool | str = False,
        gui: bool = False,
    ) -> None:
        check_kind("spec", spec, SceneSpec)
        check_kind("robot", robot, (RobotDescription, type(None)))
        check_flag("gui", gui)
        if not isinstance(visuals, str) or visuals != "plain":
            check_flag('visuals, unless it is "plain",', visuals)
        self.spec = spec
        self.robot = robot or franka()
        self._stop_speeds = self.robot.stop_speed * self.robot.dq_max
        self.client = connect(gui=gui)
        # Without this flag Bullet turns a URDF cylinder into a 32-gon, which loses 0.2 m/s a second when it rolls.
        self._flags = p.URDF_USE_IMPLICIT_CYLINDER
        if not (visuals or gui):
            self._flags |= p.URDF_IGNORE_VISUAL_SHAPES
        self._configure_physics()
        self._load_robot(plain=visuals == "plain")
        self._load_bodies()
        self._load_fixtures()
        self._saved = self.client.saveState()
        self._bind_hot_calls()
        n = spec.substeps
        self._substep_shares = np.arange(1, n + 1)[:, None] / n
        self._time = 0.0
        self._q_reference = self.robot.q_ready

    # ---------------------------------------------------------------- construction

    def _configure_physics(self) -> None:
        self.client.setPhysicsEngineParameter(
            fixedTimeStep=self.spec.physics_dt,
            numSolverIterations=self.spec.solver_iterations,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
        )
        self.client.setGravity(0, 0, -9.81)

    def _load_robot(self, *, plain: bool) -> None:
        client, robot = self.client, self.robot
        with plain_urdf(robot.urdf) if plain else contextlib.nullcontext(robot.urdf) as urdf:
            self.robot_id = client.loadURDF(str(urdf), useFixedBase=True, flags=self._flags)
        joints, links = joints_and_links(client, self.robot_id)
        self._arm = [joints[name] for name in robot.arm_joints]
        self._fingers = [joints[name] for name in robot.finger_joints]
        self._ee = links[robot.ee_link]
        self._motor = {
            "bodyUniqueId": self.robot_id,
            "jointIndices": self._arm,
            "controlMode": p.POSITION_CONTROL,
            "forces": robot.effort_max.tolist(),
            "positionGains": [POSITION_GAIN] * 7,
            "velocityGains": [VELOCITY_GAIN] * 7,
        }
        for joint, q in zip(self._arm, robot.q_ready.tolist(), strict=True):
            client.resetJointState(self.robot_id, joint, q)
        for joint in self._fingers:
            client.resetJointState(self.robot_id, joint, robot.width_max / 2)
            client.changeDynamics(
                self.robot_id, joint, lateralFriction=self.spec.finger_friction, spinningFriction=0.02,
                rollingFriction=0.0,
            )  # fmt: skip
        stiffen(client, self.robot_id)
        # PyBullet ignores <mimic>: without this gear the fingers drift apart under load.
        gear = client.createConstraint(
            self.robot_id, self._fingers[0], self.robot_id, self._fingers[1], p.JOINT_GEAR, [0, 1, 0], [0] * 3, [0] * 3
        )
        client.changeConstraint(gear, gearRatio=-1, erp=0.1, maxForce=50)
        client.changeDynamics(self.robot_id, -1, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING)

    def _load_bodies(self) -> None:
        client = self.client
        self.table_id = load_asset(client, "table/table.urdf", flags=self._flags, fixed=True, position=(0.0, 0.0, 0.0))
        client.changeDynamics(self.table_id, -1, lateralFriction=0.8, rollingFriction=0.0, spinningFriction=0.0)
        stiffen(client, self.table_id)
        self.body_ids: dict[str, int] = {}
        self._inertia_per_kg: dict[str, list[float]] = {}
        self._free_joints: dict[str, dict[str, int]] = {}
        for k, body in enumerate(self.spec.bodies):
            index = load_asset(client, body.urdf, flags=self._flags, fixed=False, position=(0.0, k, PARKING_HEIGHT))
            joints, links = joints_and_links(client, index)
            for link in links.values():
                free_link(
                    client, index, link, lateral_friction=body.lateral_friction,
                    rolling_friction=body.rolling_friction, spinning_friction=body.spinning_friction,
                )  # fmt: skip
            for joint in joints.values():  # Bullet gives every joint a motor that holds it, and 100 rad/s at most
                client.changeDynamics(index, joint, maxJointVelocity=MAX_JOINT_SPEED)
                client.setJointMotorControl2(index, joint, p.VELOCITY_CONTROL, targetVelocity=0.0, force=0.0)
            mass, _, inertia = client.getDynamicsInfo(index, -1)[:3]
            self._inertia_per_kg[body.name] = (np.array(inertia) / mass).tolist()
            self.body_ids[body.name] = index
            self._free_joints[body.name] = joints

    def _load_fixtures(self) -> None:
        self.fixtures = {
            spec.name: Fixture(self.client, spec, flags=self._flags, waiting_at=(0.0, -1.0 - k, PARKING_HEIGHT))
            for k, spec in enumerate(self.spec.fixtures)
        }

    def _bind_hot_calls(self) -> None:
        # The client looks every call up anew: a third of the cost of the short ones.
        client = self.client
        self._step_physics = client.stepSimulation
        self._command_arm = partial(client.setJointMotorControlArray, **self._motor)
        self._finger_motors = [
            partial(
                client.setJointMotorControl2, self.robot_id, joint, p.POSITION_CONTROL, force=self.robot.grip_force,
                positionGain=POSITION_GAIN, velocityGain=VELOCITY_GAIN,
                maxVelocity=self.robot.finger_speed_max * FINGER_SPEED_MARGIN,
            )
            for joint in self._fingers
        ]  # fmt: skip
        self._joint_states = partial(client.getJointStates, self.robot_id, self._arm + self._fingers)
        self._ee_state = partial(client.getLinkState, self.robot_id, self._ee, computeForwardKinematics=1)
        self._body_pose = client.getBasePositionAndOrientation
        self._body_twist = client.getBaseVelocity
        self._contacts = client.getContactPoints
        self._register = client.setCollisionFilterGroupMask
        fixtures = [body for fixture in self.fixtures.values() for body in fixture.variants]
        self._colliding = [
            (body, link, BOLTED if body in fixtures or (link == -1 and body not in self.body_ids.values()) else FREE)
            for body in (self.robot_id, self.table_id, *self.body_ids.values(), *fixtures)
            for link in range(-1, client.getNumJoints(body))
        ]

    @property
    def things(self) -> dict[str, int]:
        """Bullet's index of robot, table, bodies and fixtures (of the variants that stand there), by name."""
        fixtures = {name: fixture.body for name, fixture in self.fixtures.items()}
        return {"robot": self.robot_id, "table": self.table_id, **self.body_ids, **fixtures}

    # ---------------------------------------------------------------- episode

    def reset(self, condition: Condition) -> SceneState:
        """Put the world at t = 0 of this condition: robot at the ready pose, nothing moving but what it launches.

        Raises:
            ValueError: The task's `launch` does not say how the condition starts.
        """
        client = self.client
        client.restoreState(self._saved)
        # Bullet's broad phase remembers: pairs once in contact keep their caches, and the place in its list of pairs
        # where it goes on looking for stale ones decides when they go, so which bodies are solved in one group, so the
        # last bits. Steps in which nothing may collide empty the list and set that place back.
        self._let_collide(nothing=True)
        for _ in range(PARKED_STEPS):
            self._step_physics()
        self._let_collide()
        client.restoreState(self._saved)
        for name, start in self.spec.starts(condition).items():
            if isinstance(start, Placement):
                self.fixtures[name].place(start)
            else:
                self._launch(name, start)
        self._time = 0.0
        self._q_reference = self.robot.q_ready
        return self.observe()

    def _let_collide(self, *, nothing: bool = False) -> None:
        """Register all with the broad phase anew, in the order of loading, which the solver works off contacts in.

        It matters: 20 iterations do not converge, and with the robot last the hand loses one peach in ten.
        """
        for body, link, kind in self._colliding:
            self._register(body, link, *(WITH_NOTHING if nothing else kind))

    def _launch(self, name: str, launch: Launch) -> None:
        client, body, joints = self.client, self.body_ids[name], self._free_joints[name]
        w, x, y, z = launch.pose.quat_wxyz.tolist()
        inertia = [launch.mass * i for i in self._inertia_per_kg[name]]
        client.changeDynamics(body, -1, mass=launch.mass, localInertiaDiagonal=inertia)
        client.resetBasePositionAndOrientation(body, launch.pose.position.tolist(), (x, y, z, w))
        client.resetBaseVelocity(body, launch.velocity.tolist(), launch.angular_velocity.tolist())
        if unknown := [joint for joint in launch.joint_speeds if joint not in joints]:
            raise ValueError(f"Body {name!r} has no joints {unknown}; it has {sorted(joints)}.")
        for joint, speed in launch.joint_speeds.items():
            client.resetJointState(body, joints[joint], 0.0, speed)

    def step(self, q_reference: Array, width_reference: float) -> SceneState:
        """Advance one control step toward a joint reference.

        Each substep moves the reference on a straight line and feeds its velocity forward.

        Args:
            q_reference: Joint positions due at the end of the control step, radians, shape (7,).
            width_reference: Opening due at the end of the control step, metres. The finger motors are held to the
                hand's speed limit, whatever is asked.
        """
        start = self._q_reference
        velocity = ((q_reference - start) / self.spec.control_dt).tolist()
        path = start + self._substep_shares * (q_reference - start)
        for command in self._finger_motors:
            command(targetPosition=width_reference / 2)
        for fixture in self.fixtures.values():
            fixture.drive(self._time + self.spec.control_dt, self.spec.control_dt)
        for q in path.tolist():
            self._command_arm(targetPositions=q, targetVelocities=velocity)
            self._step_physics()
        self._q_reference = q_reference
        self._time += self.spec.control_dt
        return self.observe()

    def observe(self) -> SceneState:
        """Snapshot the scene."""
        joints = self._joint_states()
        dq = np.array([joint[1] for joint in joints[:7]])
        link = self._ee_state()
        left, right = self._fingers
        objects, touching, on_table = {}, {}, {}
        for name, body in self.body_ids.items():
            velocity, angular = self._body_twist(body)
            objects[name] = BodyState(pose_of(*self._body_pose(body)), np.array(velocity), np.array(angular))
            links = [contact[3] for contact in self._contacts(self.robot_id, body)]
            touching[name] = (left in links, right in links)
            on_table[name] = bool(self._contacts(body, self.table_id))
        for name, fixture in self.fixtures.items():
            objects[name] = fixture.observe()
            links = fixture.touched_by(self._contacts(self.robot_id, fixture.body))
            touching[name] = (left in links, right in links)
        return SceneState(
            time=self._time,
            q=np.array([joint[0] for joint in joints[:7]]),
            dq=dq,
            ee=pose_of(link[4], link[5]),
            width=joints[7][0] + joints[8][0],
            objects=objects,
            touching=touching,
            on_table=on_table,
            stopped=bool((np.abs(dq) > self._stop_speeds).any()),
            pressed={name: fixture.pressed for name, fixture in self.fixtures.items() if fixture.spec.spring},
        )

    def close(self) -> None:
        """Disconnect from physics; legal twice."""
        self.client.disconnect()
