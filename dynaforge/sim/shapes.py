"""What a scene looks like, as plain shapes and poses: for viewers that draw it themselves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dynaforge.geometry import Pose
from dynaforge.sim.bullet import pose_of
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.scene import SimScene

KINDS = {p.GEOM_SPHERE: "sphere", p.GEOM_BOX: "box", p.GEOM_CYLINDER: "cylinder", p.GEOM_MESH: "mesh"}
ROOT = -1  # Bullet's index of a body's root link

LinkKey = tuple[str, int]


@dataclass(frozen=True, slots=True)
class VisualShape:
    """A shape on a link.

    Attributes:
        link: Which of `SimScene.things`, and Bullet's index of the link; -1 for its root.
        kind: "box", "sphere", "cylinder" (along z) or "mesh".
        size: Metres: edges of a box; radius of a sphere; length and radius of a cylinder; scale of a mesh.
        file: Of a mesh.
        pose: `T_link_shape`.
        rgb: Colour, each within [0, 1].
    """

    link: LinkKey
    kind: str
    size: tuple[float, ...]
    file: Path | None
    pose: Pose
    rgb: tuple[float, float, float]


def visual_shapes(scene: SimScene) -> list[VisualShape]:
    """Return the shapes of everything that stands in the scene now; it must have been loaded with visuals.

    Raises:
        ValueError: A shape of a kind that is not drawn.
    """
    shapes = []
    for name, body in scene.things.items():
        for _, link, kind, size, file, position, quat, rgba in scene.client.getVisualShapeData(body):
            if kind not in KINDS:
                raise ValueError(f"A visual of {name!r} is no box, sphere, cylinder or mesh; viewers cannot draw it.")
            path = Path(file.decode()) if KINDS[kind] == "mesh" else None
            used = {"sphere": 1, "cylinder": 2}.get(KINDS[kind], 3)
            shapes.append(VisualShape((name, link), KINDS[kind], size[:used], path, pose_of(position, quat), rgba[:3]))
    return shapes


def link_pose(scene: SimScene, link: LinkKey) -> Pose:
    """`T_world_link` now."""
    name, index = link
    body = scene.things[name]
    if index == ROOT:
        return pose_of(*scene.client.getBasePositionAndOrientation(body))
    return pose_of(*scene.client.getLinkState(body, index, computeForwardKinematics=1)[4:6])
