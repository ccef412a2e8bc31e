"""Scene, condition, state and robot: everything that touches physics."""

from typing import TYPE_CHECKING, Any

from dynaforge.sim.condition import Condition
from dynaforge.sim.hand_target import HandTarget
from dynaforge.sim.robot import RobotDescription, franka
from dynaforge.sim.spec import BodySpec, Drive, FixtureSpec, Launch, Placement, SceneSpec, Spring
from dynaforge.sim.state import BodyState, SceneState

if TYPE_CHECKING:
    from dynaforge.sim.scene import SimScene

__all__ = [
    "BodySpec",
    "BodyState",
    "Condition",
    "Drive",
    "FixtureSpec",
    "HandTarget",
    "Launch",
    "Placement",
    "RobotDescription",
    "SceneSpec",
    "SceneState",
    "SimScene",
    "Spring",
    "franka",
]


def __getattr__(name: str) -> Any:
    """Import SimScene, and the physics engine with it, only when it is used: conditions and tasks are plain data."""
    if name == "SimScene":
        from dynaforge.sim.scene import SimScene

        return SimScene
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
