"""Where an object stands when it is grasped at rest: the static scenes from which synchronised replay begins."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dynaforge.geometry import Array, Pose, rotation_z
from dynaforge.sim import Condition, Launch
from dynaforge.sim.prescribed import PrescribedMotion
from dynaforge.tasks import Task, block, peach
from dynaforge.tasks.targets import Grip
from dynaforge.tasks.view import yaw

# The table top is that of table.urdf; the rest is room for the object.
TABLE = np.array(((-1.0, 1.8), (-2.9, 2.9)))  # metres: least and greatest x, and y
BASE = (0.0, 0.0, 0.3)  # metres: x and y of the robot's base, and how far from it an object stays
BOWL, PAD = 0.20, 0.22  # metres: radius of the disc that the bowl, or the pad, with the object beside it never leaves


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StaticScene:
    """The scene of a condition with its object at rest where it is grasped.

    Attributes:
        pose: `T_world_object`.
        direction: About where the object goes in this condition, as an angle in radians from the world's x axis.
        still: Names of the fixtures that stand still where the condition starts them.
        keep_out: Discs on the table, x, y and radius in metres, that the object must not enter.
    """

    pose: Pose
    direction: float
    still: tuple[str, ...] = ()
    keep_out: tuple[tuple[float, float, float], ...] = (BASE,)

    def standing(self, body: str) -> PrescribedMotion:
        """Return the object at rest as a motion without a path."""
        return PrescribedMotion(
            body=body,
            quat_wxyz=tuple(self.pose.quat_wxyz.tolist()),
            end=tuple(self.pose.position.tolist()),
            still=self.still,
        )

    def is_free(self, points: Array) -> bool:
        """Return whether the object may be at all of some points, metres, shape (n, 3)."""
        flat = points[:, :2]
        on_table = bool(((flat >= TABLE[:, 0]) & (flat <= TABLE[:, 1])).all())
        return on_table and all(np.linalg.norm(flat - (x, y), axis=1).min() >= r for x, y, r in self.keep_out)


def static_scene(task: Task, condition: Condition) -> StaticScene:
    """Return the static scene of a condition.

    Raises:
        ValueError: There is none for this task; the supported ones are named.
    """
    check_supported(task)
    return _SCENES[task.name](task, condition)


def check_supported(task: Task) -> None:
    """Raise ValueError unless the object of a task can be grasped at rest."""
    if task.name not in _SCENES:
        raise ValueError(
            f"The generator replay is for the tasks {', '.join(_SCENES)}, whose object can stand where it is grasped; "
            f"the task is {task.name!r}."
        )


def _rolling(task: Task, condition: Condition) -> StaticScene:
    """Stand where the line of the object crosses the workspace, so turned that it comes between the open fingers."""
    values = condition.values
    start = _launch(task, replace(condition, values={**values, **({"roll": 0.0} if "roll" in values else {})}))
    side = math.copysign(1.0, values["side"])
    heading = side * math.pi / 2 + values["heading"]
    grip = getattr(task.phases[task.contact_phase].target, "grip", Grip.ALONG)
    wanted = heading if grip is Grip.ACROSS else heading + side * math.pi / 2
    rotation = rotation_z(wanted - yaw(start.pose)) @ start.pose.rotation
    position = np.array((values["cross_x"], values["cross_y"], start.pose.position[2]))
    return StaticScene(pose=Pose(rotation, position), direction=heading)


def _peach(task: Task, condition: Condition) -> StaticScene:
    side = math.copysign(1.0, condition.values["side"])
    bowl = (peach.BOWL_X, side * peach.BOWL_Y, BOWL)
    return replace(_rolling(task, condition), keep_out=(BASE, bowl))


def _block(task: Task, condition: Condition) -> StaticScene:
    """Stand on the tray as at t = 0, with the tray at rest; the block comes from the outside."""
    side = math.copysign(1.0, condition.values["side"])
    pad = (block.CENTRE_X, -side * block.PAD_Y, PAD)
    start = _launch(task, condition)
    return StaticScene(pose=start.pose, direction=-side * math.pi / 2, still=("tray",), keep_out=(BASE, pad))


def _launch(task: Task, condition: Condition) -> Launch:
    start = task.scene.starts(condition)[task.manipulated]
    assert isinstance(start, Launch)
    return start


_SCENES: Mapping[str, Callable[[Task, Condition], StaticScene]] = {
    "can": _rolling,
    "bottle": _rolling,
    "toycar": _rolling,
    "peach": _peach,
    "block": _block,
}
SUPPORTED = tuple(_SCENES)
"""Names of the tasks that have a static scene."""
