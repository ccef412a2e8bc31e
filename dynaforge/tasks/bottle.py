"""Bottle: grasp a tapered bottle that rolls in a curve and lift it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dynaforge.geometry import Array, Pose, rotation_z
from dynaforge.sim import Condition
from dynaforge.sim.hand_target import under_palm
from dynaforge.sim.spec import BodySpec, Launch, SceneSpec
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.phase import REDUCED_SPEED
from dynaforge.tasks.predicates import Aligned, All, Departed, Fallen, Grasped, Gripped, Lifted, Near, Reached, Touched
from dynaforge.tasks.reach import along_arc, arc_to_disc
from dynaforge.tasks.targets import Above, DownstreamArc, Raised
from dynaforge.tasks.task import Mode, Phase, ResidualSpec, Task

# The bottle touches the table with two circles of these radii, this far apart along its axis; its origin is midway.
WIDE, NARROW, APART = 0.033, 0.029, 0.10
TILT = math.asin((WIDE - NARROW) / APART)
"""Tilt of its axis while it lies on the table, thin end down, radians."""
HEIGHT = (WIDE + NARROW) / 2
"""Height of its origin while it lies on the table, metres."""
TURN = HEIGHT / math.tan(TILT)
"""Radius of the circle on which its origin moves, metres: it rolls like a cone about its tip, which is on the table."""
REACH = 0.60
UNDER_PALM = under_palm(2 * WIDE - HEIGHT)

CONDITIONS = ConditionSpace(
    task="bottle",
    difficulty="speed",
    ranges={
        # Nearly static up to a strong push. At 1.2 m/s a force of a fifth of its weight keeps it on its curve: no slip.
        "speed": (0.05, 1.2),
        # The sign is the side it comes from: right or left.
        "side": (-1.0, 1.0),
        # Where it passes in front of the robot, it moves straight to one side, up to 20 degrees off.
        "heading": (-0.35, 0.35),
        # That point: x in the middle of the reach, and so near that the circle, on the far side, is on the table; y.
        "cross_x": (0.42, 0.52),
        "cross_y": (-0.05, 0.05),
        # Seconds, at launch speed, until it enters the reach: the arm needs 0.7 s to get there, after 0.2 s to start.
        # In 1.2 s the fastest bottle goes half round its circle, from the far end of the table.
        "lead": (0.9, 1.2),
        # From an empty to a half-full glass bottle, kg.
        "mass": (0.15, 0.4),
        "roll": (0.0, 2 * math.pi),
    },
    units={
        "speed": "m/s",
        "heading": "rad",
        "cross_x": "m",
        "cross_y": "m",
        "lead": "s",
        "mass": "kg",
        "roll": "rad",
    },
)


def launch(condition: Condition) -> Mapping[str, Launch]:
    """Roll the bottle on its circle without slip, the tip of its cone on the far side from the robot."""
    v = condition.values
    side = math.copysign(1.0, v["side"])
    crossing = Pose(rotation_z(side * math.pi / 2 + v["heading"]), np.array((v["cross_x"], v["cross_y"], HEIGHT)))
    turn = -side * TURN  # a bottle that goes to the left (+y) turns right, away from the robot
    start = along_arc(crossing, turn, arc_to_disc(crossing, turn, REACH) - v["speed"] * v["lead"])
    return {"bottle": rolling(start, side, v["speed"], v["roll"], v["mass"])}


def rolling(heading: Pose, side: float, speed: float, roll: float, mass: float) -> Launch:
    """Launch a bottle rolling without slip along the x axis of a heading frame.

    Both points of contact are at rest, so the bottle turns about the line through them, which is horizontal.

    Args:
        heading: Heading frame, at the bottle's origin.
        side: 1.0 or -1.0: the thin end points right or left.
        speed: Speed of the origin, m/s.
        roll: Angle of the bottle about its own axis, radians.
        mass: kg.
    """
    ahead, up = heading.rotation[:, 0], heading.rotation[:, 2]
    to_tip = -side * heading.rotation[:, 1]
    axis = math.cos(TILT) * to_tip - math.sin(TILT) * up
    x = math.cos(roll) * ahead + math.sin(roll) * np.cross(axis, ahead)
    spin: Array = np.cross(up, ahead) * speed / HEIGHT
    return Launch(Pose(np.column_stack((x, np.cross(axis, x), axis)), heading.position), speed * ahead, spin, mass)


TASK = Task(
    name="bottle",
    env_name="Bottle",
    skill="grasp",
    motion="A tapered bottle is launched rolling along a curve at 0.05 to 1.2 m/s; from then on only physics moves it.",
    randomisation="Speed, side, heading within 20 degrees, circle, launch distance, mass 0.15 to 0.4 kg, roll angle.",
    goal="The bottle is lifted 10 cm, gripped by both fingers, for 0.25 s.",
    instruction="pick up the rolling bottle",
    scene=SceneSpec(bodies=(BodySpec("bottle", "bottle/bottle.urdf"),), launch=launch),
    conditions=CONDITIONS,
    phases=(
        Phase(
            "pregrasp",
            Mode.GLOBAL,
            DownstreamArc("bottle", 0.085, reach=REACH, clearance=0.08, radius=TURN),
            width=0.08,
            done=All((Reached(0.03), Near("bottle", 0.30))),
            timeout=3.0,
            failure="not reached",
        ),
        # No stricter than the descent: on a curve, a tight bound that must hold for two steps rejects good grasps.
        Phase(
            "track",
            Mode.IK,
            Above("bottle", 0.085),
            width=0.08,
            gate=True,
            done=Aligned("bottle", 0.02, 0.03),
            lowest=UNDER_PALM,
            timeout=2.5,
            failure="lost track",
        ),
        Phase(
            "descend",
            Mode.IK,
            Above("bottle", 0.0),
            width=0.08,
            gate=True,
            done=Aligned("bottle", 0.02, 0.03, height=0.012),
            ramp=REDUCED_SPEED,
            lowest=UNDER_PALM,
            timeout=1.0,
            failure="missed descent",
            track_until=Touched("bottle"),
        ),
        Phase(
            "close",
            Mode.IK,
            Above("bottle", 0.0),
            width=0.0,
            gate=True,
            done=Grasped("bottle"),
            hold=0.1,
            lowest=UNDER_PALM,
            timeout=0.8,
            failure="missed close",
            track_until=Touched("bottle"),
        ),
        Phase(
            "lift",
            Mode.GLOBAL,
            Raised("bottle", 0.15),
            width=0.0,
            done=All((Lifted("bottle", 0.10), Gripped("bottle"))),
            hold=0.25,
            timeout=2.5,
            failure="slipped",
        ),
    ),
    impossible=(("dropped", Fallen("bottle")), ("lost track", Departed("bottle", 0.75))),
    # Along the heading: the arm, within its limits, trails a bottle at 1 m/s by 15 cm. Upward: twice the hover
    # height. Across: half the length of its body. About the vertical: what its heading turns in 0.13 s at 1.2 m/s.
    residual=ResidualSpec(translation=(0.15, 0.03, 0.15), rotation=(0.0, 0.0, 0.2)),
)
