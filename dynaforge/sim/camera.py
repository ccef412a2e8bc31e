"""Cameras on a scene: colour, depth and segmentation, and the points of a depth image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, asdict, dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from dynaforge.geometry import Array, Pose, one_line
from dynaforge.sim.checks import check_choice, check_flag, check_name, check_number, check_numbers, is_whole, quoted

if TYPE_CHECKING:
    from dynaforge.sim.bullet_scene import BulletScene

Point = tuple[float, float, float]
Visuals = bool | Literal["plain"]
"""Which visual shapes a scene loads; see `SimScene`."""

FLIP = np.diag((1.0, -1.0, -1.0))  # from OpenGL's camera axes (y up, looking along -z) to OpenCV's (y down, along z)
MAX_EDGE = 4096  # pixels; a larger image takes gigabytes
LIGHT = (0.6, -0.6, 2.0)  # direction of the light


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera, fixed in the world or in the hand.

    Attributes:
        name: Its name in files and observations.
        eye, look_at, up: Position, point that it looks at (m), and direction that is up in the image; in the world
            frame or, for a camera in the hand, in the end-effector frame.
        in_hand: Whether it moves with the end effector.
        size: (width, height), pixels.
        fov: Vertical field of view, degrees.
        near, far: Distances of the planes between which it sees, metres.
    """

    name: str
    eye: Point
    look_at: Point
    _: KW_ONLY
    up: Point = (0.0, 0.0, 1.0)
    in_hand: bool = False
    size: tuple[int, int] = (128, 128)
    fov: float = 50.0
    near: float = 0.02
    far: float = 4.0

    def __post_init__(self) -> None:
        check_name("Camera: name", self.name)
        camera = f"Camera {self.name!r}"
        for name in ("eye", "look_at", "up"):
            check_numbers(f"{camera}: {name}", getattr(self, name), 3)
        check_flag(f"{camera}: in_hand", self.in_hand)
        check_numbers(f"{camera}: size", self.size, 2)
        for name in ("fov", "near", "far"):
            check_number(f"{camera}: {name}", getattr(self, name), above=0.0)
        inside = all(is_whole(edge) and 1 <= edge <= MAX_EDGE for edge in self.size)
        if not inside or self.fov >= 180.0 or self.near >= self.far:
            raise ValueError(f"{camera} needs a size of whole pixels, 1 to {MAX_EDGE} each, fov < 180 and near < far.")
        self.pose(Pose.identity())

    @property
    def intrinsics(self) -> Array:
        """The matrix K, pixels, shape (3, 3): the pixel in column j and row i shows what lies along K^-1 (j, i, 1).

        Bullet's software renderer samples a pixel at its lower left corner.
        """
        width, height = self.size
        f = 0.5 * height / np.tan(0.5 * np.radians(self.fov))
        return np.array(((f, 0.0, 0.5 * width), (0.0, f, 0.5 * height - 1.0), (0.0, 0.0, 1.0)))

    def pose(self, ee: Pose) -> Pose:
        """Return `T_world_camera` with the axes of OpenCV (x right, y down, z ahead), given the end effector's pose.

        Raises:
            ValueError: It looks at itself, or along its own up direction.
        """
        eye, ahead, up = np.array(self.eye), np.subtract(self.look_at, self.eye), np.array(self.up)
        distance = np.linalg.norm(ahead)
        if distance < 1e-9:
            raise ValueError(f"Camera {self.name!r} looks at itself: eye and look_at are both {self.eye}.")
        z = ahead / distance
        x = np.cross(z, up)
        if np.linalg.norm(x) < 1e-6:
            raise ValueError(f"Camera {self.name!r} looks along its own up direction.")
        x /= np.linalg.norm(x)
        own = Pose(np.column_stack((x, np.cross(z, x), z)), eye)
        return ee @ own if self.in_hand else own

    def to_dict(self) -> dict[str, Any]:
        """Return the camera as plain JSON data."""
        return asdict(self)

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Camera:
        """Build a camera from what `to_dict` returned.

        Raises:
            ValueError: A field is missing, unknown or out of range.
        """
        if not isinstance(data, Mapping):
            raise ValueError(f"No camera: {quoted(data)} is not a mapping with name, eye and look_at.")
        try:
            values: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in data.items()}
            return Camera(**values)
        except TypeError as error:
            raise ValueError(f"No camera: {error}.") from error


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Image:
    """What a camera saw at one moment.

    Attributes:
        rgb: Shape (H, W, 3), uint8.
        depth: Distance along the optical axis, metres, shape (H, W), float32; `far` where nothing is.
        segmentation: Index into `names` of what each pixel shows, shape (H, W), int8; -1 where nothing is.
        names: Those of `SimScene.names`.
        pose: `T_world_camera`.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    segmentation: NDArray[np.int8]
    names: tuple[str, ...]
    pose: Pose

    __repr__ = one_line

    def shows(self, name: str) -> NDArray[np.bool_]:
        """Return which pixels show the robot, table, body or fixture of this name, shape (H, W).

        Raises:
            ValueError: The scene has none of that name.
        """
        check_choice("Image: name", name, self.names)
        return np.equal(self.segmentation, self.names.index(name))


def film_camera(view: tuple[Point, Point]) -> Camera:
    """Return the camera of `render()` and films: it looks from the first point to the second, as in `Task.camera`."""
    eye, look_at = view
    return Camera("film", eye, look_at, size=(480, 360), fov=45.0, near=0.05, far=8.0)


def take_image(scene: BulletScene, camera: Camera, ee: Pose) -> Image:
    """Return an image of the scene as it is now; see `SimScene.image`.

    Args:
        scene: The scene.
        camera: The camera.
        ee: `T_world_ee` now, for a camera in the hand.
    """
    width, height = camera.size
    pose = camera.pose(ee)
    _, _, rgba, z, mask = _draw(scene, camera, _view_matrix(pose), shadow=0)
    near, far = camera.near, camera.far
    depth = far * near / (far - (far - near) * np.asarray(z, dtype=np.float64).reshape(height, width))
    drawn = np.asarray(mask).reshape(height, width)
    segmentation = np.full((height, width), -1, dtype=np.int8)
    for index, body in enumerate(scene.bodies.values()):
        segmentation[drawn == body] = index
    return Image(
        rgb=_rgb(rgba, camera),
        depth=depth.astype(np.float32),
        segmentation=segmentation,
        names=tuple(scene.bodies),
        pose=pose,
    )


def take_picture(scene: BulletScene, camera: Camera, ee: Pose) -> NDArray[np.uint8]:
    """Return a picture with shadows of the scene as it is now; see `SimScene.picture`.

    Args:
        scene: The scene.
        camera: The camera.
        ee: `T_world_ee` now, for a camera in the hand.

    Returns:
        RGB, shape (H, W, 3).
    """
    from dynaforge.sim.bullet import pybullet as p

    if camera.in_hand:
        view = _view_matrix(camera.pose(ee))
    else:  # with Bullet's own rounding, so that films stay the same in every pixel
        view = list(p.computeViewMatrix(camera.eye, camera.look_at, camera.up))
    return _rgb(_draw(scene, camera, view, shadow=1, flags=p.ER_NO_SEGMENTATION_MASK)[2], camera)


def _draw(scene: BulletScene, camera: Camera, view: list[float], **options: int) -> Any:
    """Draw with Bullet's software renderer; return width, height, RGBA, depth and bodies."""
    from dynaforge.sim.bullet import pybullet as p  # only here, so that cameras can be described without the engine

    width, height = camera.size
    projection = p.computeProjectionMatrixFOV(camera.fov, width / height, camera.near, camera.far)
    return scene.client.getCameraImage(
        width, height, view, projection, renderer=p.ER_TINY_RENDERER, lightDirection=LIGHT, **options
    )


def _view_matrix(pose: Pose) -> list[float]:
    """Return `T_camera_world` in OpenGL's axes, column by column."""
    view = np.eye(4)
    view[:3, :3] = FLIP @ pose.rotation.T
    view[:3, 3] = -view[:3, :3] @ pose.position
    columns: list[float] = view.T.ravel().tolist()
    return columns


def _rgb(rgba: Any, camera: Camera) -> NDArray[np.uint8]:
    width, height = camera.size
    return np.asarray(rgba, dtype=np.uint8).reshape(height, width, 4)[:, :, :3].copy()


def world_points(camera: Camera, image: Image) -> tuple[Array, NDArray[np.bool_]]:
    """Return the world point (m) that each pixel shows, shape (H, W, 3), and whether it shows any, shape (H, W)."""
    points = (_rays(camera) * image.depth[..., None]) @ image.pose.rotation.T + image.pose.position
    return points, image.segmentation >= 0


@lru_cache(maxsize=16)
def _rays(camera: Camera) -> Array:
    """Return the direction of each pixel in the camera's axes, with z = 1, shape (H, W, 3): the same in every frame."""
    width, height = camera.size
    K = camera.intrinsics
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack(((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)), axis=-1)
