"""The ramp of a target: where two phases want the hand at different places, it goes from one to the other steadily."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynaforge.geometry import Array, Pose, one_line


@dataclass(frozen=True, slots=True, eq=False)
class Ramp:
    """The difference between the targets of two phases, which shrinks at a steady speed; `Phase.ramp` says why.

    Attributes:
        jump: Position of the old target less that of the new one, in the heading frame of the new phase's object,
            metres, shape (3,).
        speed: Speed at which it shrinks, m/s.
    """

    jump: Array
    speed: float

    __repr__ = one_line

    @staticmethod
    def between(old: Pose, new: Pose, frame: Pose, speed: float) -> Ramp:
        """Return the ramp from one target to another.

        Args:
            old: Where the phase before wants the hand now.
            new: Where the new phase wants it.
            frame: Heading frame of the new phase's object.
            speed: m/s.
        """
        return Ramp((old.position - new.position) @ frame.rotation, speed)

    def applied(self, target: Pose, frame: Pose, time: float) -> Pose:
        """Return the target with what is left of the difference.

        Args:
            target: Where the phase wants the hand in the end.
            frame: Heading frame of its object now.
            time: Seconds since its entry.
        """
        length = float(np.linalg.norm(self.jump))
        left = length - self.speed * time
        if left <= 0.0:
            return target
        return Pose(target.rotation, target.position + frame.rotation @ (self.jump * (left / length)))
