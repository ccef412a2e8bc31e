"""PyBullet without the lines that it prints to the terminal, and small functions on its bodies and links."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim.spec import asset_path, check_urdf

__all__ = ["connect", "joints_and_links", "load_asset", "pose_of", "pybullet"]

STDERR = 2  # its file descriptor


@contextlib.contextmanager
def _silent_stderr() -> Iterator[None]:
    """Redirect the file descriptor of stderr to nowhere: when imported, Bullet prints from C, below Python's streams.

    It is used only for that import, which Python runs once per process, so that no two threads are ever in here. A
    process without stderr needs no redirection. (Replacing C's own `stderr` instead would not do: a libstdc++ that is
    loaded meanwhile would keep the replacement for good.)
    """
    try:
        kept = os.dup(STDERR)
    except OSError:
        yield
        return
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, STDERR)
        os.close(nowhere)
        yield
    finally:
        os.dup2(kept, STDERR)
        os.close(kept)


with _silent_stderr():
    import pybullet


STIFFNESS, DAMPING = 1e6, 2000.0  # N/m, N s/m
HAND_STIFFNESS, HAND_DAMPING = 3e4, 300.0  # N/m, N s/m: pads, gears and joints, one after the other


class Client:
    """A physics world of its own, with every function of `pybullet` bound to it; it ends with the object.

    pybullet_utils has a similar class, which however passes an empty string of options, so that Bullet prints its
    arguments.

    Args:
        mode: `pybullet.DIRECT` or `pybullet.GUI`.

    Raises:
        RuntimeError: There are too many worlds in this process.
    """

    def __init__(self, mode: int) -> None:
        self._id = -1
        self._owner = os.getpid()
        self._id = pybullet.connect(mode)
        if self._id < 0:
            raise RuntimeError(
                "Bullet cannot open another world in this process; close envs that are no longer needed."
            )

    def __getattr__(self, name: str) -> Any:
        return functools.partial(getattr(pybullet, name), physicsClientId=self._id)

    def disconnect(self) -> None:
        """Close the world; safe to call more than once."""
        world, self._id = self._id, -1
        if world >= 0 and os.getpid() == self._owner:  # a forked copy must not close it
            with contextlib.suppress(pybullet.error):
                pybullet.disconnect(physicsClientId=world)

    def __del__(self) -> None:
        self.disconnect()


def connect(*, gui: bool = False) -> Client:
    """Open a new physics world, with Bullet's window or without.

    Raises:
        OSError: The window needs a display and there is none. Bullet itself would end the process.
    """
    if gui and (problem := missing_display()):
        raise OSError(
            f"render_mode='human' opens a window, but {problem}. On a machine without a screen use "
            "render_mode='rgb_array', or start Python under `xvfb-run`."
        )
    return Client(pybullet.GUI if gui else pybullet.DIRECT)


def missing_display() -> str:
    """Return why Bullet cannot open a window here; "" if it can."""
    if sys.platform != "linux":
        return ""
    display = os.environ.get("DISPLAY")
    if not display:
        return "there is no display: the variable DISPLAY is not set"
    try:
        x11 = ctypes.CDLL("libX11.so.6")
    except OSError:
        return "the library libX11.so.6 is missing"
    x11.XOpenDisplay.restype = ctypes.c_void_p
    connection = x11.XOpenDisplay(None)
    if not connection:
        return f"no X server answers at DISPLAY={display!r}"
    x11.XCloseDisplay(ctypes.c_void_p(connection))
    return ""


def joints_and_links(client: Any, body: int) -> tuple[dict[str, int], dict[str, int]]:
    """Return Bullet's index of every joint, and of every link, of a body by name; that of the root link is -1."""
    joints, links = {}, {client.getBodyInfo(body)[0].decode(): -1}
    for i in range(client.getNumJoints(body)):
        info = client.getJointInfo(body, i)
        joints[info[1].decode()] = links[info[12].decode()] = i
    return joints, links


def free_link(
    client: Any, body: int, link: int, *, lateral_friction: float, rolling_friction: float, spinning_friction: float
) -> None:
    """Set a link's friction coefficients, and take away Bullet's damping of its motion.

    Args:
        client: The physics client.
        body: Bullet's index of the body.
        link: Bullet's index of the link.
        lateral_friction: Coulomb coefficient.
        rolling_friction: Friction length against rolling, metres.
        spinning_friction: Friction length against spinning, metres.
    """
    client.changeDynamics(
        body,
        link,
        lateralFriction=lateral_friction,
        rollingFriction=rolling_friction,
        spinningFriction=spinning_friction,
        linearDamping=0.0,
        angularDamping=0.0,
        jointDamping=0.0,
    )


def stiffen(client: Any, body: int) -> None:
    """Make the surface of a body stiff; it must be called for every body that the arm may press an object against.

    Otherwise objects sink in by up to 20 mm, because the solver stops before it balances the much heavier arm.
    """
    for link in range(-1, client.getNumJoints(body)):
        client.changeDynamics(body, link, contactStiffness=STIFFNESS, contactDamping=DAMPING)


def palm_of(client: Any, body: int, fingers: Sequence[int]) -> int:
    """Return Bullet's index of the link that carries both fingers, given the indices of their joints."""
    palm: int = client.getJointInfo(body, fingers[0])[16]
    return palm


def soften_hand(client: Any, body: int, fingers: Sequence[int]) -> None:
    """Let the surface of fingers and palm yield like the pads of a real hand, with the elastic arm behind them.

    Where rigid bodies meet, the speed of an impact is undone within one substep, whose force then is a multiple of what
    the impact would be on a robot.

    Args:
        client: The physics client.
        body: Bullet's index of the robot.
        fingers: Indices of the finger joints, both on the palm.
    """
    for link in (palm_of(client, body, fingers), *fingers):
        client.changeDynamics(body, link, contactStiffness=HAND_STIFFNESS, contactDamping=HAND_DAMPING)


@contextlib.contextmanager
def plain_urdf(urdf: Path) -> Iterator[Path]:
    """Yield a temporary copy of the robot's URDF in which links are drawn by their collision meshes."""
    meshes = urdf.parent / "meshes" / "collision"
    text = re.sub(r'"package://meshes/\w+/(\w+\.obj)"', rf'"{meshes}/\1"', urdf.read_text())
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / urdf.name
        plain.write_text(text)
        yield plain


def pose_of(position: tuple[float, ...], quat_xyzw: tuple[float, ...]) -> Pose:
    """Turn a position and a quaternion of Bullet's into a pose."""
    return Pose(np.array(pybullet.getMatrixFromQuaternion(quat_xyzw)).reshape(3, 3), np.array(position))


def load_asset(client: Any, name: str, *, flags: int, fixed: bool, position: tuple[float, float, float]) -> int:
    """Load a URDF below `assets/`, with sleeping disabled.

    Args:
        client: The physics client.
        name: The file, as `asset_path` takes it.
        flags: Flags of Bullet's `loadURDF`.
        fixed: Whether its root link is bolted down.
        position: Where it is put, metres.

    Returns:
        Index of the body.

    Raises:
        FileNotFoundError: No such asset.
        ValueError: It cannot be loaded, or the inertial frame of its root link, by which Bullet places it, is not the
            link's own frame.
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
