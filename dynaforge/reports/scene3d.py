"""An episode to walk around in: a page that viser plays in any browser, or a recording for Rerun's viewer."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dynaforge.demos import Episode
from dynaforge.demos.replay import Replayer
from dynaforge.files.atomic import atomic_write
from dynaforge.geometry import Pose, one_line
from dynaforge.reports.extras import load_extra
from dynaforge.sim.shapes import LinkName, VisualShape
from dynaforge.tasks import Task

CYLINDER_FACES = 24
PATH_COLOR = (30, 90, 200)
LABEL_AT = (0.0, 0.0, 0.9)  # metres, above the robot
CURVES = {"q": "joint", "dq": "joint_speed", "residual_action": "residual", "width": "gripper_width", "gate": "gate"}


@dataclass(frozen=True, slots=True, eq=False)
class Scene3D:
    """An episode as moving meshes.

    Attributes:
        task: The task.
        episode: The episode.
        meshes: The mesh of each link, a `trimesh.Trimesh` in the link's frame.
        poses: `T_world_link` of each link at each of the T control steps.
    """

    task: Task
    episode: Episode
    meshes: Mapping[LinkName, Any]
    poses: Mapping[LinkName, list[Pose]]

    __repr__ = one_line


class SceneRecorder:
    """Simulates episodes of a task again and records the pose of every link.

    Args:
        task: The task.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._replayer = Replayer(task, visuals="plain")

    def record(self, episode: Episode) -> Scene3D:
        """Return an episode as moving meshes.

        Raises:
            ImportError: trimesh, which the `[viser]` and `[rerun]` extras bring, is missing.
            ValueError: It cannot be simulated again.
        """
        scene = self._replayer.scene
        meshes: dict[LinkName, Any] = {}
        poses: dict[LinkName, list[Pose]] = {}
        for _ in self._replayer.recorded_states(episode):
            if not meshes:
                shapes = scene.shapes()
                for link in dict.fromkeys(shape.link for shape in shapes):
                    meshes[link] = _mesh([shape for shape in shapes if shape.link == link])
            now = scene.link_poses()
            for link in meshes:
                poses.setdefault(link, []).append(now[link])
        return Scene3D(self._task, episode, meshes, poses)

    def close(self) -> None:
        """Release physics; safe to call more than once."""
        self._replayer.close()


def _mesh(shapes: list[VisualShape]) -> Any:
    """Join the shapes of a link into one mesh, each part in its colour."""
    trimesh = load_extra("trimesh", extra="viser")
    return trimesh.util.concatenate([_part(trimesh, shape) for shape in shapes])


def _part(trimesh: Any, shape: VisualShape) -> Any:
    """Return one shape as a mesh in the link's frame."""
    if shape.kind == "box":
        mesh = trimesh.creation.box(shape.size)
    elif shape.kind == "sphere":
        mesh = trimesh.creation.icosphere(subdivisions=2, radius=shape.size[0])
    elif shape.kind == "cylinder":
        mesh = trimesh.creation.cylinder(height=shape.size[0], radius=shape.size[1], sections=CYLINDER_FACES)
    else:
        loaded = trimesh.load(shape.file, force="mesh", process=False)
        mesh = trimesh.Trimesh(loaded.vertices * shape.size, loaded.faces, process=False)
    mesh.vertices = shape.pose.apply(mesh.vertices)
    color = np.array([*(round(255 * part) for part in shape.rgb), 255], dtype=np.uint8)
    mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=np.tile(color, (len(mesh.vertices), 1)))
    return mesh


def write_viser(path: Path, scene: Scene3D) -> None:
    """Write a page that plays the episode in three dimensions, in any browser and without a server.

    Raises:
        ImportError: viser, of the `[viser]` extra, is missing.
    """
    viser = load_extra("viser", extra="viser")
    with contextlib.redirect_stdout(io.StringIO()):  # its banner
        server = viser.ViserServer(host="127.0.0.1")
    try:
        draw = server.scene
        draw.set_up_direction("+z")
        server.initial_camera.position, server.initial_camera.look_at = scene.task.camera
        links = {}
        for (name, link), mesh in scene.meshes.items():
            node = f"/{name}/{link}"
            links[name, link] = draw.add_frame(node, show_axes=False)
            draw.add_mesh_trimesh(f"{node}/mesh", mesh)
        path_taken = scene.episode.steps["ee_position"]
        draw.add_spline_catmull_rom("/path", path_taken, color=PATH_COLOR, line_width=2.0, segments=len(path_taken))
        label = draw.add_label("/phase", "", position=LABEL_AT)
        recording = server.get_scene_serializer()
        for step, text in enumerate(_labels(scene.episode)):
            if label.text != text:
                label.text = text
            for key, frame in links.items():
                pose = scene.poses[key][step]
                frame.position, frame.wxyz = pose.position, pose.quat_wxyz
            recording.insert_sleep(1 / scene.task.scene.fps)
        page = recording.as_html()
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
    atomic_write(path, page.encode())


def write_rerun(path: Path, scene: Scene3D) -> None:
    """Write the episode as a recording (.rrd) for Rerun's viewer: the scene, and curves of joints and residual.

    Raises:
        ImportError: rerun-sdk, of the `[rerun]` extra, is missing.
    """
    rr = load_extra("rerun", extra="rerun")

    def write(temporary: Path) -> None:
        recording = rr.RecordingStream("dynaforge", recording_id=scene.episode.id)
        recording.save(temporary)
        recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for (name, link), mesh in scene.meshes.items():
            shape = rr.Mesh3D(
                vertex_positions=mesh.vertices,
                triangle_indices=mesh.faces,
                vertex_colors=mesh.visual.vertex_colors,
                vertex_normals=mesh.vertex_normals,
            )
            recording.log(["scene", name, link], shape, static=True)
        steps = scene.episode.steps
        recording.log("scene/path", rr.LineStrips3D([steps["ee_position"]], colors=[PATH_COLOR]), static=True)
        logged = ""
        for step, text in enumerate(_labels(scene.episode)):
            recording.set_time("time", duration=float(steps["time"][step]))
            for (name, link), poses in scene.poses.items():
                w, x, y, z = poses[step].quat_wxyz
                moved = rr.Transform3D(translation=poses[step].position, quaternion=rr.Quaternion(xyzw=(x, y, z, w)))
                recording.log(["scene", name, link], moved)
            for column, label in CURVES.items():
                if column in steps:
                    recording.log(f"curves/{label}", rr.Scalars(np.atleast_1d(steps[column][step]).astype(float)))
            if text != logged:
                recording.log("phase", rr.TextLog(text))
                logged = text
        recording.flush()
        recording.disconnect()

    atomic_write(path, write)


def _labels(episode: Episode) -> Iterator[str]:
    """Yield the label of each control step: its phase, and whether a finger has touched."""
    names = list(episode.meta.get("phases", []))
    contact = episode.meta.get("contact_time")
    for time, phase in zip(episode.steps["time"].tolist(), episode.steps["phase"].tolist(), strict=True):
        name = names[phase] if phase < len(names) else str(phase)
        yield f"{name}, in contact" if contact is not None and time >= contact else name
