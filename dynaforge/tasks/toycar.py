"""ToyCar: grasp a toy car that coasts by, across its body, and lift it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynaforge.sim import Condition
from dynaforge.sim.hand_target import under_palm
from dynaforge.sim.spec import BodySpec, Launch, SceneSpec
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.phase import REDUCED_SPEED
from dynaforge.tasks.predicates import Aligned, All, Departed, Fallen, Grasped, Gripped, Lifted, Near, Reached
from dynaforge.tasks.rolling import start_of_roll
from dynaforge.tasks.targets import Above, Downstream, Grip, Raised
from dynaforge.tasks.task import Mode, Phase, ResidualSpec, Task

HEIGHT = 0.026
"""Height of the car's origin above the table, metres."""
WHEEL_RADIUS = 0.016
WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
REACH = 0.60
UNDER_PALM = under_palm(0.0285)
HOVER = 0.06
OPEN = 0.072
"""Opening of the fingers around the body of 56 mm, metres: as much room as a can has in a fully open hand."""
# Less than a can's: on wheels of 16 mm, 2e-4 would stop a slow car before it reaches the hand. The car still goes
# straight.
ROLLING_FRICTION = 5e-5

CONDITIONS = ConditionSpace(
    task="toycar",
    difficulty="speed",
    ranges={
        # Nearly static up to what the hand can keep up with. Fingers at the sides of a car do not block its way, as
        # they do a can's: the hand must reach the car's speed, and at 1 m/s that and closing take half the reach.
        "speed": (0.05, 1.0),
        # The sign is the side it comes from: right or left.
        "side": (-1.0, 1.0),
        # Up to 20 degrees off the straight line across the workspace.
        "heading": (-0.35, 0.35),
        # A point on its line in front of the robot: x in the middle of the reach; y, the offset along the line.
        "cross_x": (0.42, 0.55),
        "cross_y": (-0.05, 0.05),
        # Seconds, at launch speed, until it enters the reach: the arm needs 0.7 s to get there, after 0.2 s to start.
        "lead": (0.9, 1.3),
        # Mass of the body without its wheels, from plastic to die-cast metal, kg.
        "mass": (0.1, 0.3),
    },
    units={
        "speed": "m/s",
        "heading": "rad",
        "cross_x": "m",
        "cross_y": "m",
        "lead": "s",
        "mass": "kg",
    },
)


def launch(condition: Condition) -> Mapping[str, Launch]:
    """Push the car along its heading, its wheels rolling without slip."""
    v = condition.values
    frame = start_of_roll(v, height=HEIGHT, reach=REACH)
    spin = dict.fromkeys(WHEELS, v["speed"] / WHEEL_RADIUS)
    return {"toycar": Launch(frame, v["speed"] * frame.rotation[:, 0], np.zeros(3), v["mass"], spin)}


TASK = Task(
    name="toycar",
    env_name="ToyCar",
    skill="grasp",
    motion="A toy car is launched at 0.05 to 1.0 m/s with its wheels rolling; from then on only physics moves it.",
    randomisation="Speed, side, heading within 20 degrees, line, launch distance, mass 0.1 to 0.3 kg.",
    goal="The car is lifted 10 cm, gripped by both fingers, for 0.25 s.",
    instruction="pick up the moving toy car",
    scene=SceneSpec(
        bodies=(BodySpec("toycar", "toycar/toycar.urdf", rolling_friction=ROLLING_FRICTION),), launch=launch
    ),
    conditions=CONDITIONS,
    phases=(
        Phase(
            "pregrasp",
            Mode.GLOBAL,
            Downstream("toycar", HOVER, reach=REACH, clearance=0.08, grip=Grip.ACROSS),
            width=OPEN,
            # So near that a residual that leads by 15 cm has the hand under way before the car is below it. With 30 cm
            # the hand first runs to meet the car, has to turn back, and is passed beside it.
            done=All((Reached(0.03), Near("toycar", 0.10))),
            timeout=3.0,
            failure="not reached",
        ),
        # The fingers have 8 mm of room on each side; 42 mm from the car's middle the whole pad is still on its body.
        # One finger at the side cannot push the car along its way, so the hand follows it until both fingers grip.
        Phase(
            "track",
            Mode.IK,
            Above("toycar", HOVER, Grip.ACROSS),
            width=OPEN,
            gate=True,
            done=Aligned("toycar", 0.042, 0.008),
            lowest=UNDER_PALM,
            timeout=2.0,
            failure="lost track",
        ),
        Phase(
            "descend",
            Mode.IK,
            Above("toycar", 0.0, Grip.ACROSS),
            width=OPEN,
            gate=True,
            done=Aligned("toycar", 0.050, 0.010, height=0.012),
            ramp=REDUCED_SPEED,
            lowest=UNDER_PALM,
            timeout=1.0,
            failure="missed descent",
            track_until=Grasped("toycar"),
        ),
        Phase(
            "close",
            Mode.IK,
            Above("toycar", 0.0, Grip.ACROSS),
            width=0.0,
            gate=True,
            done=Grasped("toycar"),
            hold=0.1,
            lowest=UNDER_PALM,
            timeout=0.8,
            failure="missed close",
            track_until=Grasped("toycar"),
        ),
        Phase(
            "lift",
            Mode.GLOBAL,
            Raised("toycar", 0.15),
            width=0.0,
            done=All((Lifted("toycar", 0.10), Gripped("toycar"))),
            hold=0.25,
            timeout=2.5,
            failure="slipped",
        ),
    ),
    impossible=(("dropped", Fallen("toycar")), ("lost track", Departed("toycar", 0.75))),
    # Along the heading: the arm, within its limits, trails a car at 1 m/s by 15 cm. Across: twice the fingers'
    # room; 40 mm win no more. Upward: one and a half times the hover height. Width: enough to open the hand fully.
    residual=ResidualSpec(translation=(0.15, 0.015, 0.09), rotation=(0.0, 0.0, 0.10), width=0.01),
)
