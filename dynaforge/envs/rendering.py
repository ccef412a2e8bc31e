"""Pictures of a scene, drawn by Bullet's software renderer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.sim import SimScene
from dynaforge.sim.bullet import pybullet as p

Point = tuple[float, float, float]


class Renderer:
    """A fixed camera on a scene; the scene must have been loaded with visuals.

    Args:
        scene: What to draw.
        camera: (eye, look-at), metres, world frame.
        size: (width, height), pixels.
    """

    def __init__(self, scene: SimScene, camera: tuple[Point, Point], size: tuple[int, int] = (480, 360)) -> None:
        self._client: Any = scene.client
        self._size = size
        eye, look_at = camera
        self._view = p.computeViewMatrix(eye, look_at, (0.0, 0.0, 1.0))
        self._projection = p.computeProjectionMatrixFOV(45.0, size[0] / size[1], 0.05, 8.0)

    def image(self) -> NDArray[np.uint8]:
        """Draw the scene now: RGB, shape (height, width, 3), uint8."""
        width, height = self._size
        pixels = self._client.getCameraImage(
            width, height, self._view, self._projection, renderer=p.ER_TINY_RENDERER, shadow=1,
            lightDirection=(0.6, -0.6, 2.0), flags=p.ER_NO_SEGMENTATION_MASK,
        )[2]  # fmt: skip
        return np.asarray(pixels, dtype=np.uint8).reshape(height, width, 4)[:, :, :3].copy()
