"""Predicates, the words for what must hold: adjectives over a view of the scene."""

from dynaforge.tasks.predicates.logic import All, Not, Predicate
from dynaforge.tasks.predicates.objects import AtRestOn, Departed, Fallen, Lifted, OnTable, Upright, Within
from dynaforge.tasks.predicates.robot import (
    Aligned,
    Around,
    Clicked,
    Grasped,
    Narrowed,
    Near,
    Reached,
    Released,
    RobotStopped,
    Touched,
)

__all__ = [
    "Aligned",
    "All",
    "Around",
    "AtRestOn",
    "Clicked",
    "Departed",
    "Fallen",
    "Grasped",
    "Lifted",
    "Narrowed",
    "Near",
    "Not",
    "OnTable",
    "Predicate",
    "Reached",
    "Released",
    "RobotStopped",
    "Touched",
    "Upright",
    "Within",
]
