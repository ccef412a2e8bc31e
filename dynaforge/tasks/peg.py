"""Peg: take a peg from a rack and put it into a tight hole that turns about an axis beside it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim import Condition
from dynaforge.sim.spec import BodySpec, FixtureSpec, Launch, Placement, SceneSpec
from dynaforge.tasks.carriers import DRIVEN, carrier
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.insertion import insertion_phases, rack_pick_phases
from dynaforge.tasks.predicates import (
    All,
    Around,
    Fallen,
    Not,
    OnTable,
    Upright,
    Within,
)
from dynaforge.tasks.task import ResidualSpec, Task

LENGTH = 0.09
TIP = (0.0, 0.0, -LENGTH / 2)
RACK_FLOOR = 0.006  # height of the peg's lower end above the table at the start, metres
DEPTH = 0.045  # depth of the hole, metres; its frame is in the middle of its floor
HOLES = ("peg/hole_10.urdf", "peg/hole_15.urdf", "peg/hole_20.urdf")
ARM = 0.08  # distance from the axis to the hole, metres
GRIP = 0.018  # height of the hand above the middle of the peg, metres: the palm keeps clear of its end

CONDITIONS = ConditionSpace(
    task="peg",
    difficulty="speed",
    ranges={
        # Speed of the hole on its circle: nearly static up to that of a rotary assembly table. With the first choice,
        # up to 0.06 m/s, planner-only success was 88 % (n = 48), which left a residual little to learn.
        "speed": (0.01, 0.15),
        # Where on its circle the hole starts; the sign is the direction in which it turns.
        "phase": (-math.pi, math.pi),
        # Which of the three holes, with 1.0, 1.5 and 2.0 mm of clearance all round.
        "hole": (0.0, 3.0),
        # The sign is the side of the rack, right or left; the hole is on the other side.
        "side": (-1.0, 1.0),
        # In the middle of the reach; rack and hole are apart by the circle of the hole and the width of a hand.
        "rack_x": (0.42, 0.52),
        "rack_y": (0.12, 0.17),
        "hole_x": (0.43, 0.48),
        "hole_y": (0.10, 0.14),
        # From hardwood to aluminium, kg.
        "mass": (0.03, 0.08),
    },
    units={
        "speed": "m/s",
        "phase": "rad",
        "rack_x": "m",
        "rack_y": "m",
        "hole_x": "m",
        "hole_y": "m",
        "mass": "kg",
    },
)


def launch(condition: Condition) -> Mapping[str, Launch | Placement]:
    """Stand the peg in its rack and set the hole turning."""
    v = condition.values
    side = math.copysign(1.0, v["side"])
    rack = np.array((v["rack_x"], -side * v["rack_y"], 0.0))
    centre = np.array((v["hole_x"], side * v["hole_y"], 0.0))
    hole = carrier(centre, v["speed"], yaw=0.0, phase=v["phase"], arm=ARM, swing=ARM)
    still = np.zeros(3)
    return {
        "peg": Launch(Pose(np.eye(3), rack + (0.0, 0.0, RACK_FLOOR + LENGTH / 2)), still, still, v["mass"]),
        "rack": Placement(Pose(np.eye(3), rack)),
        "hole": replace(hole, variant=min(int(v["hole"]), len(HOLES) - 1)),
    }


# So deep inside, the wall keeps the peg's lower end near the axis; a peg that lies below the hole is not upright.
INSIDE = All((Within("peg", "hole", 0.006, 0.4 * DEPTH, floor=-0.005, tool=TIP), Upright("peg", 0.3)))
IN_HAND = (("slipped", Not(Around("peg", GRIP + 0.02))), ("slipped", Not(Upright("peg", 0.5))))
# Heights of the lower end above the hole's floor, metres.
HOVER, ENTERED, INSERTED = DEPTH + 0.010, DEPTH - 0.010, 0.25 * DEPTH

TASK = Task(
    name="peg",
    env_name="Peg",
    skill="grasp + insert",
    motion="A hole on a rotating arm moves at 0.01 to 0.15 m/s; the peg rests in a rack.",
    randomisation="The hole's speed, direction of rotation, start, place, clearance; the rack's place; the peg's mass.",
    goal="The peg stands at 60 % of the depth or more, let go by a hand that is still around it, for 0.25 s.",
    instruction="insert the peg into the moving hole",
    scene=SceneSpec(
        bodies=(BodySpec("peg", "peg/peg.urdf", lateral_friction=0.5),),
        fixtures=(
            FixtureSpec("rack", "peg/rack.urdf", "rack", lateral_friction=0.3),
            FixtureSpec("hole", HOLES, "hole", driven=DRIVEN, lateral_friction=0.3),
        ),
        launch=launch,
        physics_dt=1 / 480,
    ),
    conditions=CONDITIONS,
    phases=(
        *rack_pick_phases("peg", grip=GRIP, precision=0.003, lift=0.095, clear=0.075),
        *insertion_phases(
            "peg",
            "hole",
            TIP,
            grip=GRIP,
            rim=DEPTH,
            heights=(HOVER, ENTERED, INSERTED),
            precision=0.008,
            entered=Within("peg", "hole", 0.006, DEPTH - 0.005, tool=TIP),
            inside=INSIDE,
            fails=IN_HAND,
        ),
    ),
    impossible=(("dropped", Fallen("peg")), ("dropped", OnTable("peg"))),
    # Along the hole's path: the hand trails it by 6 mm at 0.15 m/s, and by as much again while it goes down. Larger
    # scales would only drown the millimetres that decide.
    residual=ResidualSpec(translation=(0.012, 0.012, 0.012), rotation=(0.05, 0.05, 0.0), width=0.0),
    camera=((1.15, -0.3, 0.6), (0.4, 0.0, 0.12)),
)
