"""The PyBullet scene: robot, table, free bodies and fixtures, reset exactly and stepped at the control rate."""

from __future__ import annotations

from functools import partial
from operator import gt
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from dynaforge.geometry import Array, Pose
from dynaforge.sim.arm_motors import ArmMotors
from dynaforge.sim.bullet import pose_of
from dynaforge.sim.bullet_scene import load_scene
from dynaforge.sim.camera import Camera, Image, Visuals, take_image, take_picture
from dynaforge.sim.checks import check_flag, check_kind
from dynaforge.sim.condition import Condition
from dynaforge.sim.contacts import ContactReader, Found, overlaps
from dynaforge.sim.driver import Driver
from dynaforge.sim.exact_restore import ExactRestore
from dynaforge.sim.force_watch import ForceWatch
from dynaforge.sim.hand import HAND_DELAY, Hand, HandState
from dynaforge.sim.loads import Loads
from dynaforge.sim.prescribed import PrescribedMotion
from dynaforge.sim.reflex import ReflexName, thresholds
from dynaforge.sim.robot import RobotDescription, franka
from dynaforge.sim.shapes import LinkName, VisualShape, link_poses, visual_shapes
from dynaforge.sim.snapshot import Memory, put_back, remember
from dynaforge.sim.spec import Placement, SceneSpec
from dynaforge.sim.state import BodyState, SceneState
from dynaforge.sim.surfaces import Surfaces


class SimScene:
    """One physics world that runs episode after episode.

    The same condition and the same references give the same bits, whatever was simulated before in this process: each
    reset restores a state that was saved with nothing in contact. Only moving the bodies back would keep Bullet's
    contact caches alive.

    Args:
        spec: What the scene contains.
        robot: Geometry and limits; the Franka by default.
        reflex: The external loads that stop the robot: a name of `THRESHOLDS`, or a force in newtons.
        visuals: Whether to load visual shapes, which rendering needs and training does not. "plain" draws the robot by
            its collision meshes, with 3,400 triangles instead of 100,000: a picture takes a fifth of the time.
        gui: Whether to open Bullet's window.

    Attributes:
        spec: What the scene contains.
        robot: Geometry and limits.
        names: Names of robot, table, bodies and fixtures, in this order.

    Raises:
        ValueError: An argument is of the wrong type.
    """

    def __init__(
        self,
        spec: SceneSpec,
        *,
        robot: RobotDescription | None = None,
        reflex: ReflexName | float = "contact",
        visuals: Visuals = False,
        gui: bool = False,
    ) -> None:
        check_kind("spec", spec, SceneSpec)
        check_kind("robot", robot, (RobotDescription, type(None)))
        check_flag("gui", gui)
        if not isinstance(visuals, str) or visuals != "plain":
            check_flag('visuals, unless it is "plain",', visuals)
        self.spec = spec
        self.robot = robot or franka()
        self._stop_speeds = (self.robot.stop_speed * self.robot.dq_max).tolist()
        self._bullet = load_scene(spec, self.robot, visuals=visuals, gui=gui)
        self.names = tuple(self._bullet.bodies)
        self._surfaces = Surfaces(self._bullet)
        self._restoring = ExactRestore(self._bullet)
        self._saved = self._bullet.client.saveState()
        self._bind_hot_calls()
        client, body, joints = self._bullet.client, self._bullet.robot.body, self._bullet.robot.arm
        self._arm = ArmMotors(client, body, joints, self.robot, substeps=spec.substeps, control_dt=spec.control_dt)
        self._hand = Hand(client, self._bullet.robot, self.robot, substeps=spec.substeps, physics_dt=spec.physics_dt)
        self._watch = ForceWatch(self._arm.dynamics, thresholds(reflex))
        self._time = 0.0
        self._condition: Condition | None = None
        self._driver: Driver | None = None
        self._saved_later: tuple[int, HandState, Memory, float] | None = None

    def _bind_hot_calls(self) -> None:
        # Looking a function up in the client costs a third of the time of a short call.
        client, robot = self._bullet.client, self._bullet.robot
        self._step_physics = client.stepSimulation
        self._joint_states = partial(client.getJointStates, robot.body, robot.arm + robot.fingers)
        self._ee_state = partial(client.getLinkState, robot.body, robot.ee, computeForwardKinematics=1)
        self._body_pose = client.getBasePositionAndOrientation
        self._body_twist = client.getBaseVelocity
        self._contacts = ContactReader(self._bullet)
        self._observed = [(name, body.body) for name, body in self._bullet.free.items()]

    # ---------------------------------------------------------------- episode

    def reset(self, condition: Condition, *, prescribed: PrescribedMotion | None = None) -> SceneState:
        """Put the world at t = 0 of a condition: the robot at its ready pose, and nothing moving but what is launched.

        Args:
            condition: The condition.
            prescribed: A path along which a body is driven in this episode, instead of being moved by physics alone.

        Raises:
            ValueError: The task's `launch` does not return a valid start, or the path is of no body of this scene.
        """
        starts = self.spec.starts(condition)
        starts = starts if prescribed is None else prescribed.starts(starts)
        if condition != self._condition or prescribed is not None:
            self._forget()
        self._condition = condition
        self._restoring.restore(self._saved)
        hidden = condition.hidden
        self._surfaces.apply(hidden)
        self._hand.reset(hidden.get("hand_delay", HAND_DELAY))
        for name, start in starts.items():
            if isinstance(start, Placement):
                self._bullet.fixtures[name].place(start)
            else:
                self._bullet.free[name].launch(name, start, start.mass * hidden.get("mass", 1.0))
        self._arm.reset(hidden.get("joint_gain", 1.0))
        self._watch.reset()
        self._time = 0.0
        self._driver = None if prescribed is None else Driver(self._bullet, prescribed, self.spec.physics_dt)
        return self.observe()

    @property
    def prescribed_until(self) -> float:
        """Seconds since the reset for which the motion of a body has been prescribed."""
        return self._driver.seconds if self._driver is not None else 0.0

    def save(self) -> None:
        """Save the world as it is now, until the next call or a reset to another condition, and go on from there.

        Bullet's contact caches are lost, as at a reset, so that all that follows is the same now and after `restore`.
        What a condition fixes once and for all, such as masses, is not part of it.

        Raises:
            RuntimeError: A motion is prescribed in this episode.
        """
        if self._driver is not None:
            raise RuntimeError("An episode with a prescribed motion cannot be saved: reset it instead.")
        self._forget()
        memory = remember(self._arm, self._watch)
        self._saved_later = (self._bullet.client.saveState(), self._hand.state, memory, self._time)
        self.restore()

    def renew_contacts(self) -> None:
        """Lose Bullet's contact caches: what follows is the same as after `save`, which takes ten times as long."""
        self._restoring.renew_contacts()

    @property
    def saved(self) -> object | None:
        """Stands for the saved world: another object after each `save`, None while nothing is saved."""
        return self._saved_later

    def restore(self) -> None:
        """Go back to the saved world, from which the same references give the same bits every time.

        Raises:
            RuntimeError: None was saved.
        """
        if self._saved_later is None:
            raise RuntimeError("No world is saved: call save() after reset().")
        state, hand, memory, self._time = self._saved_later
        self._restoring.restore(state)
        self._hand.restore(hand)
        put_back(memory)

    def _forget(self) -> None:
        if self._saved_later is not None:  # otherwise Bullet keeps 0.2 MB for each
            self._bullet.client.removeState(self._saved_later[0])
        self._saved_later = None

    def step(self, q_reference: Array, width_reference: float) -> SceneState:
        """Advance one control step toward a joint reference.

        `ArmMotors` says how the arm moves in between.

        Args:
            q_reference: Joint positions to reach at the end of the control step, radians, shape (7,).
            width_reference: Opening that the hand is told to move to, metres. It answers after its dead time, and never
                faster than its speed limit.
        """
        due = self._hand.send(width_reference)
        for fixture in self._bullet.fixtures.values():
            fixture.drive(self._time + self.spec.control_dt, self.spec.control_dt)
        for substep, command in enumerate(self._arm.plan(q_reference)):
            if substep == due:
                self._hand.drive()
            if substep:
                self._watch.see(self._contacts.of_robot())
            self._arm.run(command)
            if self._driver is not None:
                self._driver.carry()
            self._step_physics()
            if self._driver is not None:
                self._driver.place()
        # The snapshot needs the contacts of the last substep too: they are asked once, those without the robot as well.
        found = self._contacts.all()
        self._watch.see([contact for contact in found if contact[1] == self._bullet.robot.body])
        self._time += self.spec.control_dt
        return self._snapshot(found)

    @property
    def loads(self) -> Loads:
        """The greatest external loads on the robot in this episode so far."""
        return self._watch.loads

    def close(self) -> None:
        """Disconnect from physics; safe to call more than once."""
        self._bullet.client.disconnect()

    def __reduce__(self) -> NoReturn:
        # Copying the client, and dropping the copy, would disconnect this scene as well.
        raise TypeError("A scene cannot be copied or pickled: make another, and reset it to the same condition.")

    # ---------------------------------------------------------------- observation

    def observe(self) -> SceneState:
        """Return a snapshot of the scene."""
        return self._snapshot(self._contacts.all())

    def _snapshot(self, found: Found) -> SceneState:
        positions, velocities, *_ = zip(*self._joint_states(), strict=True)
        q, dq = np.array(positions[:7]), np.array(velocities[:7])
        ee = self._ee_pose()
        fixtures = self._bullet.fixtures
        contacts = self._contacts.read(found, ee)
        objects = {}
        for name, body in self._observed:
            velocity, angular = self._body_twist(body)
            objects[name] = BodyState(pose_of(*self._body_pose(body)), np.array(velocity), np.array(angular))
        for name, fixture in fixtures.items():
            objects[name] = fixture.observe()
        return SceneState(
            time=self._time,
            q=q,
            dq=dq,
            ee=ee,
            width=positions[7] + positions[8],
            objects=objects,
            touching={name: contacts.touching(name) for name in objects},
            on_table={name: (name, "table") in contacts.supports for name, _ in self._observed},
            contacts=contacts,
            stopped=any(map(gt, map(abs, velocities), self._stop_speeds)),  # the arm's; the fingers' are left over
            loads=self._watch.end_step(q, ee.position),
            overloaded=self._watch.tripped,
            pressed={name: fixture.pressed for name, fixture in fixtures.items() if fixture.spec.spring},
        )

    def _ee_pose(self) -> Pose:
        link = self._ee_state()
        return pose_of(link[4], link[5])

    def fingers(self) -> tuple[Array, Array]:
        """Return position (m from closed) and speed (m/s) of the left and the right finger now, shape (2,) each."""
        states = self._joint_states()[7:]
        return np.array([joint[0] for joint in states]), np.array([joint[1] for joint in states])

    def overlaps(self) -> dict[tuple[str, str], float]:
        """Return how deeply each pair of bodies overlaps now, metres, by the two names; 0 where they do not.

        Pairs that cannot move relative to each other, such as the table and a fixture, are left out.
        """
        return overlaps(self._bullet)

    def image(self, camera: Camera) -> Image:
        """Return what a camera sees now as datasets store it: colour, depth and segmentation.

        The scene must have been loaded with visuals.
        """
        return take_image(self._bullet, camera, self._ee_pose())

    def picture(self, camera: Camera) -> NDArray[np.uint8]:
        """Return what a camera sees now as films show it: RGB with shadows, shape (H, W, 3); it needs visuals."""
        return take_picture(self._bullet, camera, self._ee_pose())

    def shapes(self) -> list[VisualShape]:
        """Return the visual shapes of everything that is in the scene now.

        The scene must have been loaded with visuals.

        Raises:
            ValueError: A shape is of a kind that viewers cannot draw.
        """
        return visual_shapes(self._bullet)

    def link_poses(self) -> dict[LinkName, Pose]:
        """Return `T_world_link` of every link of everything that is in the scene now."""
        return link_poses(self._bullet)
