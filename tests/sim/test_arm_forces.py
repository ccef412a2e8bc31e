"""The arm tracks freely and yields in contact; contact forces are seen at every substep and set off the reflex."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from dynaforge.envs.world import World
from dynaforge.geometry import Pose
from dynaforge.sim import HandTarget, SceneState, franka
from dynaforge.sim.arm_dynamics import ArmDynamics
from dynaforge.sim.arm_motors import ArmMotors
from dynaforge.sim.force_watch import ForceWatch
from dynaforge.sim.reflex import THRESHOLDS, thresholds
from dynaforge.sim.scene import SimScene
from dynaforge.tasks import get_task
from dynaforge.tasks.targets import DOWN_ALONG_Y

FASTEST = max(itertools.islice(get_task("can").conditions.stream("val"), 50), key=lambda c: c.difficulty)


@pytest.fixture(scope="module")
def world() -> World:
    return World(get_task("can"))


def go(world: World, *position: float, width: float = 0.0, steps: int = 1) -> SceneState:
    for _ in range(steps):
        reference = world.local.track(HandTarget(Pose(DOWN_ALONG_Y, np.array(position)), width))
        state = world.scene.step(reference.joints.q, reference.width)
    return state


def test_model_of_the_arm_agrees_with_bullet(world: World) -> None:
    robot, bullet, rng = world.scene.robot, world.scene._bullet, np.random.default_rng(0)
    half_open = [robot.width_max / 4] * 2
    dynamics = ArmDynamics(robot)
    for _ in range(20):
        q = rng.uniform(robot.q_lower, robot.q_upper)
        dq, ddq = rng.uniform(-2, 2, 7), rng.uniform(-10, 10, 7)
        expected = bullet.client.calculateInverseDynamics(
            bullet.robot.body, [*q, *half_open], [*dq, 0.0, 0.0], [*ddq, 0.0, 0.0]
        )
        np.testing.assert_allclose(dynamics.torque(q, dq, ddq), expected[:7], atol=1e-6)


def test_free_tracking_is_within_two_millimetres_of_the_reference(world: World) -> None:
    world.reset(FASTEST)
    rng, errors = np.random.default_rng(0), []
    for k in range(120):
        if k % 40 == 0:
            start, velocity = (0.45, -0.2, 0.35) + rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.5, 0.5, 3) * (1, 1, 0.2)
        reference = world.local.track(HandTarget(Pose(DOWN_ALONG_Y, start + velocity * (k % 40) / 30), 0.08))
        state = world.scene.step(reference.joints.q, reference.width)
        wanted = world.kinematics.forward(reference.joints.q).position
        errors.append(np.linalg.norm(wanted - state.ee.position))
    assert max(errors) < 0.002
    assert np.mean(errors) < 0.001


@pytest.mark.parametrize(("x", "y"), [(0.35, -0.25), (0.45, 0.0), (0.6, -0.1)])
def test_hand_past_contact_presses_with_at_most_80_newtons(world: World, x: float, y: float) -> None:
    world.reset(FASTEST)
    go(world, x, y, 0.06, steps=45)
    for depth in np.linspace(0.0, 0.025, 15):  # on the way down; the fingertips are 7 mm below the hand's frame
        go(world, x, y, 0.03 - 0.023 * depth / 0.025)
    for depth in np.linspace(0.0, 0.025, 15):
        go(world, x, y, 0.007 - depth)
    forces = [np.linalg.norm(go(world, x, y, -0.018).loads.force) for _ in range(20)]
    assert np.mean(forces) > 1.0
    assert max(forces) < 80.0


def test_contact_force_at_rest_is_upward_and_its_torques_are_those_of_the_jacobian(world: World) -> None:
    world.reset(FASTEST)
    go(world, 0.5, -0.1, 0.03, steps=45)
    state = go(world, 0.5, -0.1, 0.0, steps=45)
    loads = state.loads
    assert loads.force[2] > 5.0
    expected = world.scene._arm.dynamics.jacobian(state.q)[:3].T @ loads.force
    np.testing.assert_allclose(loads.torque, expected, atol=0.1 * np.abs(loads.torque).max())


def test_free_motion_carries_no_load(world: World) -> None:
    world.reset(FASTEST)
    go(world, 0.4, 0.0, 0.3, steps=10)
    assert world.scene.loads.peak_force == 0.0


def loads_of(*newtons: float, reflex: str | float = "contact") -> ForceWatch:
    """Return a watch that saw these forces, straight up at the origin, one per control step of a single substep."""
    watch = ForceWatch(ArmDynamics(franka()), thresholds(reflex))  # type: ignore[arg-type]
    zero, up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    for force in newtons:
        watch.see([(0, 0, 1, 0, -1, zero, zero, up, 0.0, force, 0.0, zero, 0.0, zero)] if force else [])
        watch.end_step(franka().q_ready, np.zeros(3))
    return watch


def test_reflex_acts_on_two_control_steps_in_a_row() -> None:
    assert not loads_of(300.0, 0.0, 300.0, 99.0, 300.0).tripped
    assert loads_of(0.0, 101.0, 101.0).tripped
    assert not loads_of(101.0, 101.0, reflex="off").tripped
    assert loads_of(61.0, 61.0, reflex=60).tripped
    assert not loads_of(59.0, 59.0, reflex=60).tripped


def test_one_run_tells_what_every_threshold_would_have_done() -> None:
    loads = loads_of(10.0, 30.0, 50.0, 10.0, reflex="off").loads
    assert loads.peak_force == 50.0
    assert loads.force == 40.0
    for name in ("contact", "standard", "strict"):
        assert (getattr(loads, name) > 1.0) == loads_of(10.0, 30.0, 50.0, 10.0, reflex=name).tripped
    assert loads.contact == pytest.approx(0.3)
    assert loads.strict >= 1.5


@pytest.mark.parametrize("reflex", ["soft", 0, -5.0, float("nan"), None, True])
def test_a_threshold_that_is_no_name_or_number_is_refused_before_physics(reflex: object) -> None:
    with pytest.raises(ValueError, match="reflex"):
        SimScene(get_task("can").scene, reflex=reflex)  # type: ignore[arg-type]


def test_named_thresholds_descend() -> None:
    levels = [THRESHOLDS[name] for name in ("off", "contact", "standard", "strict")]
    for harder, softer in itertools.pairwise(levels):
        assert harder.force > softer.force
        assert harder.moment > softer.moment
        assert (harder.torque > softer.torque).all()


def test_the_robot_is_the_first_body_of_its_contacts(world: World) -> None:
    # Who reads contacts relies on it, and on this: among all contacts are those that Bullet reports of the robot.
    scene = world.scene
    world.reset(FASTEST)
    for _ in range(80):
        go(world, 0.5, 0.1, 0.005)
        found = scene._contacts.all()
        ours = [contact for contact in found if contact[1] == scene._bullet.robot.body]
        assert ours == list(scene._contacts.of_robot())
        assert all(contact[2] != scene._bullet.robot.body for contact in found)
        if ours:
            return
    raise AssertionError("the hand never came to the table")


def test_constant_acceleration_is_followed_exactly(world: World) -> None:
    robot, dt, n = world.scene.robot, 1 / 30, 8
    motors = ArmMotors(world.scene._bullet.client, 0, list(range(7)), robot, substeps=n, control_dt=dt)
    a, h = np.linspace(-2.0, 2.0, 7), dt / n
    for k in range(1, 4):
        commands = motors.plan(robot.q_ready + 0.5 * a * (k * dt) ** 2)
    since = (k - 1) * dt + h * np.arange(n)[:, None]
    np.testing.assert_allclose([c.q for c in commands], robot.q_ready + 0.5 * a * since**2, atol=1e-12)
    np.testing.assert_allclose([c.dq for c in commands], a * (since + h), atol=1e-12)
    expected = [motors.dynamics.torque(robot.q_ready + 0.5 * a * t**2, a * t, a) for t in (since + h / 2)[:, 0]]
    np.testing.assert_allclose([c.torque for c in commands], expected, atol=0.05)
