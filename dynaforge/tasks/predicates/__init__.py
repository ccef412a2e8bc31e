"""Predicates, the words for what must hold: adjectives over a view of the scene."""

from dynaforge.tasks.predicates.force import Gently, Gripped, Struck, SupportedBy
from dynaforge.tasks.predicates.logic import All, Not, Predicate
from dynaforge.tasks.predicates.objects import (
    AtRestOn,
    Departed,
    Fallen,
    FootOn,
    Lifted,
    OnTable,
    Upright,
    Within,
)
from dynaforge.tasks.predicates.robot import (
    Aligned,
    Around,
    Between,
    Clicked,
    Grasped,
    Narrowed,
    Near,
    Overloaded,
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
    "Between",
    "Clicked",
    "Departed",
    "Fallen",
    "FootOn",
    "Gently",
    "Grasped",
    "Gripped",
    "Lifted",
    "Narrowed",
    "Near",
    "Not",
    "OnTable",
    "Overloaded",
    "Predicate",
    "Reached",
    "Released",
    "RobotStopped",
    "Struck",
    "SupportedBy",
    "Touched",
    "Upright",
    "Within",
]
