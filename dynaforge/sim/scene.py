"""The PyBullet scene: robot, table and free bodies, reset exactly and stepped at the control rate."""

from __future__ import annotations

import contextlib
from functools import partial

import numpy as np

from dynaforge.geometry import Array, Pose
from dynaforge.sim.bullet import connect
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.condition import Condition
from dynaforge.sim.robot import RobotDescription, franka
from dynaforge.sim.spec import SceneSpec, asset_path, check_urdf
from dynaforge.sim.state import BodyState, SceneState

POSITION_GAIN = 0.3
VELOCITY_GAIN = 1.0
FINGER_SPEED_MARGIN = 0.995  # the gear between the fingers adds up to 0.2 % to the motor's own limit
PARKING_HEIGHT = 5.0  # metres: bodies wait here, out of contact, in the saved state
PARKED_STEPS = 10  # substeps at each reset; two were just enough for one object, one was not


class SimScene:
    """One physics world that runs episode after episode.

    Same condition and same references give the same bits, whatever was simulated before in this process: each reset
    restores a state saved with nothing in contact (a plain teleport would keep Bullet's contact caches alive).

    Args:
        spec: What the scene holds.
        robot: Geometry and limits; the Franka by default.
        visuals: Load visual shapes, which rendering needs and training does not.
        gui: Open Bullet's window.
    """

    def __init__(
        self, spec: SceneSpec, *, robot: RobotDescription | None = None, visuals: bool = False, gui: bool = False
    ) -> None:
        self.spec = spec
        self.robot = robot or franka()
        self.client = connect(gui=gui)
        self._open = True
        # Without this flag Bullet turns a URDF cylinder into a 32-gon, which loses 0.2 m/s a second when it rolls.
        self._flags = p.URDF_USE_IMPLICIT_CYLINDER
        if not (visuals or gui):
            self._flags |= p.URDF_IGNORE_VISUAL_SHAPES
        self._configure_physics()
        self._load_robot()
        self._load_bodies()
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

    def _load_robot(self) -> None:
        client, robot = self.client, self.robot
        self.robot_id = client.loadURDF(str(robot.urdf), useFixedBase=True, flags=self._flags)
        joints, links = {}, {}
        for i in range(client.getNumJoints(self.robot_id)):
            info = client.getJointInfo(self.robot_id, i)
            joints[info[1].decode()] = links[info[12].decode()] = i
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
        # PyBullet ignores <mimic>: without this gear the fingers drift apart under load.
        gear = client.createConstraint(
            self.robot_id, self._fingers[0], self.robot_id, self._fingers[1], p.JOINT_GEAR, [0, 1, 0], [0] * 3, [0] * 3
        )
        client.changeConstraint(gear, gearRatio=-1, erp=0.1, maxForce=50)
        client.changeDynamics(self.robot_id, -1, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING)

    def _load_bodies(self) -> None:
        client = self.client
        self.table_id = client.loadURDF(str(asset_path("table/table.urdf")), useFixedBase=True, flags=self._flags)
        client.changeDynamics(self.table_id, -1, lateralFriction=0.8, rollingFriction=0.0, spinningFriction=0.0)
        self.body_ids: dict[str, int] = {}
        self._inertia_per_kg: dict[str, list[float]] = {}
        for k, body in enumerate(self.spec.bodies):
            path = asset_path(body.urdf)
            check_urdf(path)
            try:
                index = client.loadURDF(
                    str(path), [0.0, k, PARKING_HEIGHT], flags=self._flags | p.URDF_USE_INERTIA_FROM_FILE
                )
            except p.error as error:
                raise ValueError(f"PyBullet cannot load {path}: it must be a URDF with one root link.") from error
            client.changeDynamics(
                index,
                -1,
                lateralFriction=body.lateral_friction,
                rollingFriction=body.rolling_friction,
                spinningFriction=body.spinning_friction,
                linearDamping=0.0,
                angularDamping=0.0,
                activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING,
            )
            mass, _, inertia = client.getDynamicsInfo(index, -1)[:3]
            self._inertia_per_kg[body.name] = (np.array(inertia) / mass).tolist()
            self.body_ids[body.name] = index

    def _bind_hot_calls(self) -> None:
        # BulletClient looks every call up anew: a third of the cost of the short ones.
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

    # ---------------------------------------------------------------- episode

    def reset(self, condition: Condition) -> SceneState:
        """Put the world at t = 0 of this condition: robot at the ready pose, nothing moving but what it launches."""
        client = self.client
        client.restoreState(self._saved)
        # Steps with the bodies parked drop the pairs once in contact, whose caches would live on. Bullet looks at one
        # or a few of its pairs a step, so it takes several to have looked at all of them.
        for _ in range(PARKED_STEPS):
            self._step_physics()
        client.restoreState(self._saved)
        for name, launch in self.spec.launch(condition).items():
            body = self.body_ids[name]
            w, x, y, z = launch.pose.quat_wxyz.tolist()
            inertia = [launch.mass * i for i in self._inertia_per_kg[name]]
            client.changeDynamics(body, -1, mass=launch.mass, localInertiaDiagonal=inertia)
            client.resetBasePositionAndOrientation(body, launch.pose.position.tolist(), (x, y, z, w))
            client.resetBaseVelocity(body, launch.velocity.tolist(), launch.angular_velocity.tolist())
        self._time = 0.0
        self._q_reference = self.robot.q_ready
        return self.observe()

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
        for q in path.tolist():
            self._command_arm(targetPositions=q, targetVelocities=velocity)
            self._step_physics()
        self._q_reference = q_reference
        self._time += self.spec.control_dt
        return self.observe()

    def observe(self) -> SceneState:
        """Snapshot the scene."""
        joints = self._joint_states()
        link = self._ee_state()
        left, right = self._fingers
        objects, touching, on_table = {}, {}, {}
        for name, body in self.body_ids.items():
            velocity, angular = self._body_twist(body)
            objects[name] = BodyState(_pose(*self._body_pose(body)), np.array(velocity), np.array(angular))
            links = [contact[3] for contact in self._contacts(self.robot_id, body)]
            touching[name] = (left in links, right in links)
            on_table[name] = bool(self._contacts(body, self.table_id))
        return SceneState(
            time=self._time,
            q=np.array([joint[0] for joint in joints[:7]]),
            dq=np.array([joint[1] for joint in joints[:7]]),
            ee=_pose(link[4], link[5]),
            width=joints[7][0] + joints[8][0],
            objects=objects,
            touching=touching,
            on_table=on_table,
        )

    def close(self) -> None:
        """Disconnect from physics; legal twice."""
        if self._open:
            self._open = False
            with contextlib.suppress(p.error):
                self.client.disconnect()


def _pose(position: tuple[float, ...], quat_xyzw: tuple[float, ...]) -> Pose:
    return Pose(np.array(p.getMatrixFromQuaternion(quat_xyzw)).reshape(3, 3), np.array(position))
