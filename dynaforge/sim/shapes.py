"""The look of a scene as plain shapes and poses, for viewers that draw it themselves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dynaforge.geometry import Pose
from dynaforge.sim.bullet import joints_and_links, pose_of
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.bullet_scene import BulletScene

ShapeKind = Literal["box", "sphere", "cylinder", "mesh"]
LinkName = tuple[str, str]
"""A name of `SimScene.names`, and the name of one of its links."""

_KINDS: dict[int, ShapeKind] = {
    p.GEOM_SPHERE: "sphere",
    p.GEOM_BOX: "box",
    p.GEOM_CYLINDER: "cylinder",
    p.GEOM_MESH: "mesh",
}
_ROOT = -1  # Bullet's index of a body's root link


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualShape:
    """A shape on a link.

    Attributes:
        link: The link.
        kind: Kind of shape; the axis of a cylinder is z.
        size: Edges of a box, radius of a sphere, length and radius of a cylinder (m), or scale factors of a mesh.
        file: File of a mesh; None for other kinds.
        pose: `T_link_shape`.
        rgb: Colour, each component within [0, 1].
    """

    link: LinkName
    kind: ShapeKind
    size: tuple[float, ...]
    file: Path | None
    pose: Pose
    rgb: tuple[float, float, float]


def visual_shapes(scene: BulletScene) -> list[VisualShape]:
    """Return the shapes of everything that is in the scene now; see `SimScene.shapes`."""
    names = {(body, index): link for link, body, index in _links(scene)}
    shapes = []
    for name, body in scene.bodies.items():
        for _, index, code, size, file, position, quat, rgba in scene.client.getVisualShapeData(body):
            if code not in _KINDS:
                raise ValueError(
                    f"A visual shape of {name!r} is not a box, sphere, cylinder or mesh; viewers cannot draw it."
                )
            kind = _KINDS[code]
            n_sizes = {"sphere": 1, "cylinder": 2}.get(kind, 3)
            shape = VisualShape(
                link=names[body, index],
                kind=kind,
                size=size[:n_sizes],
                file=Path(file.decode()) if kind == "mesh" else None,
                pose=pose_of(position, quat),
                rgb=rgba[:3],
            )
            shapes.append(shape)
    return shapes


def link_poses(scene: BulletScene) -> dict[LinkName, Pose]:
    """Return `T_world_link` of every link now; see `SimScene.link_poses`."""
    return {link: _link_pose(scene, body, index) for link, body, index in _links(scene)}


def _links(scene: BulletScene) -> Iterator[tuple[LinkName, int, int]]:
    """Yield the name of every link of the scene, the index of its body, and its own index."""
    for name, body in scene.bodies.items():
        for link, index in joints_and_links(scene.client, body)[1].items():
            yield (name, link), body, index


def _link_pose(scene: BulletScene, body: int, index: int) -> Pose:
    if index == _ROOT:
        return pose_of(*scene.client.getBasePositionAndOrientation(body))
    return pose_of(*scene.client.getLinkState(body, index, computeForwardKinematics=1)[4:6])
