from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from dynaforge.geometry import Pose
from dynaforge.sim import SimScene
from dynaforge.sim.camera import Camera, world_points
from dynaforge.tasks import get_task

FRONT = Camera("front", (1.2, -0.5, 0.7), (0.45, 0.0, 0.1), size=(96, 72))
HAND = Camera("wrist", (0.07, 0.0, -0.10), (0.0, 0.0, 0.05), up=(1.0, 0.0, 0.0), in_hand=True, size=(64, 64))


@pytest.fixture(scope="module")
def scene() -> Iterator[SimScene]:
    task = get_task("can")
    scene = SimScene(task.scene, visuals="plain")
    scene.reset(next(task.conditions.stream("val", n_strata=8)))
    yield scene
    scene.close()


def test_a_hand_worked_camera() -> None:
    """Two metres above the origin, looking straight down, up along x: x right is -y of the world, y down is -x."""
    camera = Camera("above", (0.0, 0.0, 2.0), (0.0, 0.0, 0.0), up=(1.0, 0.0, 0.0), size=(100, 100), fov=90.0)
    np.testing.assert_allclose(camera.intrinsics, ((50, 0, 50), (0, 50, 49), (0, 0, 1)))
    pose = camera.pose(Pose.identity())
    np.testing.assert_allclose(pose.rotation, ((0, -1, 0), (-1, 0, 0), (0, 0, -1)), atol=1e-12)
    np.testing.assert_allclose(pose.inverse().apply(np.array((0.5, 0.0, 0.0))), (0.0, -0.5, 2.0), atol=1e-12)


@pytest.mark.parametrize("camera", [FRONT, HAND], ids=lambda camera: camera.name)
def test_depth_gives_points_on_what_is_seen(scene: SimScene, camera: Camera) -> None:
    image = scene.image(camera)
    points, seen = world_points(camera, image)
    table = points[image.shows("table")]
    assert len(table) > 100
    assert np.abs(table[:, 2]).max() < 0.0001
    assert image.rgb.shape == (*camera.size[::-1], 3)
    assert seen.any()


def test_points_of_the_object_lie_on_it(scene: SimScene) -> None:
    state = scene.observe()
    can = state.objects["can"].pose.position
    camera = Camera("close", tuple(can + (0.0, -0.4, 0.3)), tuple(can), size=(96, 96))
    image = scene.image(camera)
    points, _ = world_points(camera, image)
    mine = points[image.shows("can")]
    assert len(mine) > 200
    assert np.linalg.norm(mine - can, axis=1).max() < 0.075
    assert mine[:, 2].min() > -0.003


def test_a_camera_in_the_hand_moves_with_it(scene: SimScene) -> None:
    here, there = Pose.identity(), Pose(np.eye(3), np.array((0.1, 0.2, 0.3)))
    np.testing.assert_allclose(HAND.pose(there).position - HAND.pose(here).position, (0.1, 0.2, 0.3))
    np.testing.assert_array_equal(FRONT.pose(there).position, FRONT.pose(here).position)


def test_a_camera_goes_through_json() -> None:
    assert Camera.from_dict(HAND.to_dict()) == HAND
    with pytest.raises(ValueError, match="lens"):
        Camera.from_dict({"name": "x", "eye": (0, 0, 1), "look_at": (0, 0, 0), "lens": 2})


@pytest.mark.parametrize("wrong", [{"size": (0, 4)}, {"fov": 180.0}, {"near": 2.0, "far": 1.0}])
def test_impossible_cameras_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="needs a size"):
        Camera("bad", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), **wrong)


def test_a_film_shows_what_a_dataset_does_and_shadows(scene: SimScene) -> None:
    image, picture = scene.image(FRONT), scene.picture(FRONT)
    assert picture.shape == image.rgb.shape
    darker = (picture < image.rgb).any(axis=-1)
    assert (picture <= image.rgb).mean() > 0.99
    assert 0.001 < darker.mean() < 0.5
    assert image.shows("robot").any()
    with pytest.raises(ValueError, match="bowl"):
        image.shows("bowl")
