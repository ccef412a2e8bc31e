"""Scene, condition, state, robot: everything that touches physics."""

from dynaforge.sim.condition import Condition
from dynaforge.sim.robot import RobotDescription, franka
from dynaforge.sim.scene import SimScene
from dynaforge.sim.spec import BodySpec, Drive, FixtureSpec, Launch, Placement, SceneSpec, Spring
from dynaforge.sim.state import BodyState, SceneState

__all__ = [
    "BodySpec",
    "BodyState",
    "Condition",
    "Drive",
    "FixtureSpec",
    "Launch",
    "Placement",
    "RobotDescription",
    "SceneSpec",
    "SceneState",
    "SimScene",
    "Spring",
    "franka",
]
