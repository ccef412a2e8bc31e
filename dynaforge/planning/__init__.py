"""Kinematics, collision checks, the global planner for stable phases and the local planner for dynamic ones."""

from dynaforge.planning.collision import TABLE, CollisionModel, Obstacle
from dynaforge.planning.global_planner import GlobalPlanner, PlanFailure
from dynaforge.planning.kinematics import ArmKinematics, IkResult
from dynaforge.planning.local_planner import JointReference, LocalPlanner
from dynaforge.planning.target_follower import TargetFollower

__all__ = [
    "TABLE",
    "ArmKinematics",
    "CollisionModel",
    "GlobalPlanner",
    "IkResult",
    "JointReference",
    "LocalPlanner",
    "Obstacle",
    "PlanFailure",
    "TargetFollower",
]
