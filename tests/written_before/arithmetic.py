"""Small computations with the libraries below this package, by which one tells whether another machine rounds alike.

Trajectories agree to the bit only where these agree: other processors and other releases of the libraries may round
differently, which is nobody's mistake.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable

import numpy as np


def rigid_bodies() -> bytes:
    """Let a cylinder fall, hit the floor and roll on, in Bullet."""
    import pybullet as p

    client = p.connect(p.DIRECT)
    p.setGravity(0, 0, -9.81, physicsClientId=client)
    floor = p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client)
    shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=0.033, height=0.1, physicsClientId=client)
    p.createMultiBody(0, floor, physicsClientId=client)
    where = {"basePosition": (0, 0, 0.2), "baseOrientation": (0.6, 0.2, 0.1, 0.7), "physicsClientId": client}
    body = p.createMultiBody(0.3, shape, **where)
    p.changeDynamics(body, -1, rollingFriction=0.001, spinningFriction=0.001, physicsClientId=client)
    p.resetBaseVelocity(body, (0.4, 0.1, 0), (1, 2, 3), physicsClientId=client)
    rows = []
    for _ in range(240):
        p.stepSimulation(physicsClientId=client)
        position, rotation = p.getBasePositionAndOrientation(body, physicsClientId=client)
        velocity, spin = p.getBaseVelocity(body, physicsClientId=client)
        rows.append((*position, *rotation, *velocity, *spin))
    p.disconnect(client)
    return np.array(rows).tobytes()


def kinematics() -> bytes:
    """Follow a pose with a six-joint arm by damped least squares, in Pinocchio."""
    import pinocchio as pin

    model = pin.buildSampleModelManipulator()
    data = model.createData()
    frame = model.nframes - 1
    q = np.linspace(0.1, 0.6, model.nq)
    goal = pin.SE3(pin.exp3(np.array((0.3, -0.2, 0.5))), np.array((0.2, 0.1, 0.9)))
    rows = []
    for _ in range(20):
        pin.forwardKinematics(model, data, q)
        pin.updateFramePlacements(model, data)
        error = pin.log6(data.oMf[frame].actInv(goal)).vector
        jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        q = pin.integrate(model, q, jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-3 * np.eye(6), error))
        rows.append(q)
    return np.array(rows).tobytes()


def timing() -> bytes:
    """Time a spline with TOPP-RA, then follow its end with Ruckig."""
    import ruckig
    from toppra import SplineInterpolator
    from toppra.algorithm import TOPPRA
    from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

    waypoints = np.sin(np.arange(21.0).reshape(3, 7))
    limits = [f(np.tile((-2.0, 2.0), (7, 1))) for f in (JointVelocityConstraint, JointAccelerationConstraint)]
    timed = TOPPRA(limits, SplineInterpolator((0.0, 0.5, 1.0), waypoints), gridpoints=np.linspace(0, 1, 31))
    rows = list(timed.compute_trajectory()(np.linspace(0.0, 1.0, 10)))
    otg, now, then = ruckig.Ruckig(7, 1 / 30), ruckig.InputParameter(7), ruckig.OutputParameter(7)
    now.current_position, now.target_position = waypoints[0], waypoints[2]
    now.max_velocity, now.max_acceleration, now.max_jerk = [2.0] * 7, [10.0] * 7, [5000.0] * 7
    for _ in range(20):
        otg.update(now, then)
        then.pass_to_input(now)
        rows.append(np.array(then.new_position))
    return np.array(rows).tobytes()


def numbers() -> bytes:
    """Evaluate a small network, a linear system and elementary functions, in NumPy."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal(64).astype(np.float32)
    for size in (128, 128, 5):
        x = np.tanh(rng.standard_normal((size, len(x))).astype(np.float32) @ x / 8)
    matrix = rng.standard_normal((7, 7))
    solved = np.linalg.solve(matrix, np.arange(7.0))
    values = np.concatenate([f(solved) for f in (np.sin, np.cos, np.arctan, np.exp)])
    return x.tobytes() + solved.tobytes() + values.tobytes() + np.linalg.svd(matrix)[1].tobytes()


def learning() -> bytes:
    """Take a few steps of Adam on a small network, in PyTorch."""
    import torch as th

    generator = th.Generator().manual_seed(0)
    x, y = (th.randn((32, n), generator=generator) for n in (64, 5))
    first, second = (th.nn.Parameter(0.1 * th.randn(shape, generator=generator)) for shape in ((8, 64), (5, 8)))
    optimizer = th.optim.Adam([first, second], lr=1e-2)
    for _ in range(5):
        loss = (th.tanh(x @ first.T) @ second.T - y).exp().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return first.detach().numpy().tobytes() + second.detach().numpy().tobytes()


PHYSICS: tuple[Callable[[], bytes], ...] = (rigid_bodies, kinematics, timing, numbers)
TRAINING = (*PHYSICS, learning)


def fingerprints(computations: tuple[Callable[[], bytes], ...]) -> dict[str, str]:
    """Return a hash of the result of each computation, by its name."""
    return {compute.__name__: hashlib.sha256(compute()).hexdigest()[:16] for compute in computations}
