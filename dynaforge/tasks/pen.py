"""Pen: take a pen from a rack and put it into a moving holder."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim import Condition
from dynaforge.sim.spec import BodySpec, FixtureSpec, Launch, Placement, SceneSpec
from dynaforge.tasks.carriers import DRIVEN, carrier, peak_speed
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

LENGTH = 0.14
TIP = (0.0, 0.0, -LENGTH / 2)
RACK_FLOOR = 0.006  # height of the pen's tip above the table at the start, metres
DEPTH = 0.08  # depth of the holder, metres; its frame is in the middle of its floor
HOLDERS = ("pen/holder_14.urdf", "pen/holder_16.urdf", "pen/holder_18.urdf", "pen/holder_20.urdf")
ARM, SWING = 0.08, 0.08  # arm and amplitude of the holder's carrier, metres
GRIP = 0.042  # height of the hand above the middle of the pen, metres: the palm keeps clear of its end

CONDITIONS = ConditionSpace(
    task="pen",
    difficulty="speed",
    ranges={
        # Mean speed of the holder: nearly static up to that of a fast conveyor.
        "speed": (0.02, 0.3),
        # Below zero the holder slides back and forth, otherwise it turns.
        "motion": (-1.0, 1.0),
        "phase": (-math.pi, math.pi),
        "yaw": (-math.pi / 2, math.pi / 2),
        # Which of the four holders, with inner radii of 14, 16, 18 and 20 mm.
        "holder": (0.0, 4.0),
        # The sign is the side of the rack, right or left; the holder is on the other side.
        "side": (-1.0, 1.0),
        # In the middle of the reach; rack and holder are apart by the holder's amplitude and the width of a hand.
        "rack_x": (0.42, 0.52),
        "rack_y": (0.12, 0.17),
        "holder_x": (0.43, 0.48),
        "holder_y": (0.10, 0.14),
        # From a plastic to a metal pen, kg.
        "mass": (0.03, 0.06),
    },
    units={
        "speed": "m/s",
        "phase": "rad",
        "yaw": "rad",
        "rack_x": "m",
        "rack_y": "m",
        "holder_x": "m",
        "holder_y": "m",
        "mass": "kg",
    },
)


def launch(condition: Condition) -> Mapping[str, Launch | Placement]:
    """Stand the pen in its rack and set the holder going."""
    v = condition.values
    side = math.copysign(1.0, v["side"])
    rack = np.array((v["rack_x"], -side * v["rack_y"], 0.0))
    holder = carrier(
        np.array((v["holder_x"], side * v["holder_y"], 0.0)), peak_speed(v["speed"], v["motion"]),
        yaw=v["yaw"], phase=v["phase"], arm=ARM, swing=SWING,
    )  # fmt: skip
    still = np.zeros(3)
    return {
        "pen": Launch(Pose(np.eye(3), rack + (0.0, 0.0, RACK_FLOOR + LENGTH / 2)), still, still, v["mass"]),
        "rack": Placement(Pose(np.eye(3), rack)),
        "holder": replace(holder, variant=min(int(v["holder"]), len(HOLDERS) - 1)),
    }


# So deep inside, the wall keeps the pen's tip near the axis; a pen that lies below the holder is not upright.
INSIDE = All((Within("pen", "holder", 0.02, 0.4 * DEPTH, floor=-0.005, tool=TIP), Upright("pen", 0.5)))
IN_HAND = (
    ("slipped", Not(Around("pen", GRIP + 0.02))),
    ("slipped", Not(Upright("pen", 0.5))),
    ("pushed back", Around("pen", GRIP - 0.025)),  # by the rim, into the hand
)
# Heights of the tip above the holder's floor, metres.
HOVER, ENTERED, INSERTED = DEPTH + 0.015, DEPTH - 0.02, 0.25 * DEPTH

TASK = Task(
    name="pen",
    env_name="Pen",
    skill="insert",
    motion="A pen holder slides back and forth or turns at a mean speed of 0.02 to 0.3 m/s; the pen rests in a rack.",
    randomisation="The holder's speed, kind of motion, phase, direction, place, width; the rack's place; the mass.",
    goal="The pen's tip is at 60 % of the depth or more, let go by a hand that is still around it, for 0.25 s.",
    instruction="put the pen into the moving pen holder",
    scene=SceneSpec(
        bodies=(BodySpec("pen", "pen/pen.urdf", lateral_friction=0.4),),
        fixtures=(
            FixtureSpec("rack", "pen/rack.urdf", "rack"),
            FixtureSpec("holder", HOLDERS, "holder", driven=DRIVEN, lateral_friction=0.4),
        ),
        launch=launch,
        physics_dt=1 / 480,  # a hand that misses pushes the light pen 1.5 mm into the rim, at 1/240 s 9 mm
    ),
    conditions=CONDITIONS,
    phases=(
        *rack_pick_phases("pen", grip=GRIP, precision=0.006, lift=0.12, clear=0.10),
        *insertion_phases(
            "pen",
            "holder",
            TIP,
            grip=GRIP,
            rim=DEPTH,
            heights=(HOVER, ENTERED, INSERTED),
            precision=0.012,
            entered=Within("pen", "holder", 0.02, DEPTH - 0.01, tool=TIP),
            inside=INSIDE,
            fails=IN_HAND,
        ),
    ),
    impossible=(("dropped", Fallen("pen")), ("dropped", OnTable("pen"))),
    # Along the holder's path: the hand trails it by 12 mm at 0.3 m/s, and by as much again while it goes down. Turning
    # the pen about its axis changes nothing.
    residual=ResidualSpec(translation=(0.03, 0.02, 0.02), rotation=(0.1, 0.1, 0.0), width=0.0),
    camera=((1.15, -0.3, 0.6), (0.4, 0.0, 0.12)),
)
