"""Back to a saved state of Bullet, without a trace of what was simulated since."""

from __future__ import annotations

from dynaforge.sim.bullet_scene import BulletScene

# Collision group and mask; FREE and BOLTED are those that Bullet assigns when it loads a body.
WITH_NOTHING, FREE, BOLTED = (0, 0), (1, -1), (2, -3)


class ExactRestore:
    """Restores saved states so that what follows is the same bit for bit each time.

    Bullet's `restoreState` leaves the contact caches of pairs that touch. Registering every link with the broad phase
    anew drops them, and those of the saved state with them: contacts begin anew from the restored positions. All links
    are registered in load order, because the solver processes contacts in that order and its 20 iterations do not
    converge: with the robot last, the planner fails on one peach in ten.

    The broad phase also remembers where in its list of pairs it looks for stale ones next, modulo the length of the
    list. One collision detection with a single pair in the list, of the robot's first two links, sets that place to 0.

    Args:
        scene: The scene, as loaded.
    """

    def __init__(self, scene: BulletScene) -> None:
        client = scene.client
        self._restore, self._detect = client.restoreState, client.performCollisionDetection
        self._register = client.setCollisionFilterGroupMask
        free = [body.body for body in scene.free.values()]
        fixtures = [body for fixture in scene.fixtures.values() for body in fixture.variants]
        self._colliding = [
            (body, link, BOLTED if body in fixtures or (link == -1 and body not in free) else FREE)
            for body in (scene.robot.body, scene.table, *free, *fixtures)
            for link in range(-1, client.getNumJoints(body))
        ]
        # The first two always overlap, and no contact is computed between them.
        first = [(body, link, FREE) for body, link, _ in self._colliding[:2]]
        self._parked = first + [(body, link, WITH_NOTHING) for body, link, _ in self._colliding[2:]]

    def restore(self, state: int) -> None:
        """Go back to a state that Bullet's `saveState` returned."""
        self._restore(state)
        self.renew_contacts()

    def renew_contacts(self) -> None:
        """Let contacts begin anew from where everything is now; what follows is the same as after `restore`."""
        for body, link, kind in self._parked:
            self._register(body, link, *kind)
        self._detect()
        for body, link, kind in self._colliding:
            self._register(body, link, *kind)
