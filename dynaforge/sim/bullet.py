"""PyBullet without the lines it prints to the terminal on import and at every connection."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim.spec import asset_path, check_urdf

__all__ = ["connect", "joints_and_links", "load_asset", "pose_of", "pybullet"]


@contextlib.contextmanager
def _silent_terminal() -> Iterator[None]:
    """Point stdout and stderr of the whole process elsewhere: Bullet prints from C, below Python's streams."""
    sys.stdout.flush()
    kept = [os.dup(fd) for fd in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for fd in (1, 2):
            os.dup2(nowhere, fd)
        yield
    finally:
        for fd, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, fd)
            os.close(copy)
        os.close(nowhere)


with _silent_terminal():
    import pybullet
    from pybullet_utils.bullet_client import BulletClient


STIFFNESS, DAMPING = 1e6, 2000.0  # N/m, N s/m


def connect(*, gui: bool = False) -> Any:
    """Open a physics client of its own, with Bullet's window or without."""
    with _silent_terminal():
        return BulletClient(connection_mode=pybullet.GUI if gui else pybullet.DIRECT)


def joints_and_links(client: Any, body: int) -> tuple[dict[str, int], dict[str, int]]:
    """Return Bullet's index of every joint and of every link of a body by name; the root link is -1."""
    joints, links = {}, {client.getBodyInfo(body)[0].decode(): -1}
    for i in range(client.getNumJoints(body)):
        info = client.getJointInfo(body, i)
        joints[info[1].decode()] = links[info[12].decode()] = i
    return joints, links


def free_link(
    client: Any, body: int, link: int, *, lateral_friction: float, rolling_friction: float, spinning_friction: float
) -> None:
    """Set a link's friction coefficients, and take away Bullet's damping of its motion."""
    client.changeDynamics(
        body, link, lateralFriction=lateral_friction, rollingFriction=rolling_friction,
        spinningFriction=spinning_friction, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0,
    )  # fmt: skip


def stiffen(client: Any, body: int) -> None:
    """Make the surface of a body stiff: all that an arm may press an object against.

    Otherwise objects sink up to 20 mm in: the solver ends before it has held up so much heavier an arm.
    """
    for link in range(-1, client.getNumJoints(body)):
        client.changeDynamics(body, link, contactStiffness=STIFFNESS, contactDamping=DAMPING)


@contextlib.contextmanager
def plain_urdf(urdf: Path) -> Iterator[Path]:
    """Write a copy of the robot's URDF whose links look as they collide; it is there while the context lasts."""
    meshes = urdf.parent / "meshes" / "collision"
    text = re.sub(r'"package://meshes/\w+/(\w+\.obj)"', rf'"{meshes}/\1"', urdf.read_text())
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / urdf.name
        plain.write_text(text)
        yield plain


def pose_of(position: tuple[float, ...], quat_xyzw: tuple[float, ...]) -> Pose:
    """Turn what Bullet says of a frame into a pose."""
    return Pose(np.array(pybullet.getMatrixFromQuaternion(quat_xyzw)).reshape(3, 3), np.array(position))


def load_asset(client: Any, name: str, *, flags: int, fixed: bool, position: tuple[float, float, float]) -> int:
    """Load a URDF below `assets/` and keep it awake for good.

    Raises:
        FileNotFoundError: No such asset.
        ValueError: It cannot be loaded, or its root link's inertial frame is not its own: Bullet places bodies by it.
    """
    path = asset_path(name)
    check_urdf(path)
    try:
        body: int = client.loadURDF(
            str(path), position, useFixedBase=fixed, flags=flags | pybullet.URDF_USE_INERTIA_FROM_FILE
        )
    except pybullet.error as error:
        raise ValueError(f"PyBullet cannot load {path}: it must be a URDF with one root link.") from error
    if any(client.getDynamicsInfo(body, -1)[3]):
        raise ValueError(f"{path}: the inertial origin of the root link must be 0 0 0.")
    client.changeDynamics(body, -1, activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING)
    return body
