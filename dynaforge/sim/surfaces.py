"""Friction of everything in a scene, varied by the hidden fields of a condition."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from dynaforge.sim.bullet_scene import BulletScene

LATERAL, ROLLING = 1, 6  # places in what Bullet's getDynamicsInfo returns


class Surfaces:
    """The friction coefficients of a scene as it was loaded, and their factors now.

    Bullet's restoreState does not undo a change of friction, so every reset says what holds, nominal values included.

    Args:
        scene: The scene, as loaded.
    """

    def __init__(self, scene: BulletScene) -> None:
        self._change = scene.client.changeDynamics
        free = [body.body for body in scene.free.values()]
        fixtures = [body for fixture in scene.fixtures.values() for body in fixture.variants]
        robot, client = scene.robot, scene.client

        def links(bodies: Iterable[int]) -> list[tuple[int, int]]:
            return [(body, link) for body in bodies for link in range(-1, client.getNumJoints(body))]

        # Where nothing is free, as in AlarmClock, the hand acts on a fixture.
        parts = {
            "object_friction": links(free or fixtures),
            "finger_friction": [(robot.body, finger) for finger in robot.fingers],
            "table_friction": links([scene.table, *(fixtures if free else [])]),
        }
        self._nominal = {name: [(*at, *_friction(client, *at)) for at in places] for name, places in parts.items()}
        self._factors = dict.fromkeys(parts, (1.0, 1.0))

    def apply(self, hidden: Mapping[str, float]) -> None:
        """Set the friction of an episode; what is set already is not set again.

        Args:
            hidden: Hidden fields of its condition.
        """
        rolling = hidden.get("rolling_friction", 1.0)
        for name, places in self._nominal.items():
            factors = (hidden.get(name, 1.0), rolling)
            if factors == self._factors[name]:
                continue
            self._factors[name] = factors
            for body, link, lateral, length in places:
                self._change(body, link, lateralFriction=factors[0] * lateral, rollingFriction=rolling * length)


def _friction(client: Any, body: int, link: int) -> tuple[float, float]:
    info = client.getDynamicsInfo(body, link)
    return info[LATERAL], info[ROLLING]
