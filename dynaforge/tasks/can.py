"""Can: grasp a rolling drink can and lift it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dynaforge.geometry import Pose
from dynaforge.sim import Condition
from dynaforge.sim.hand_target import under_palm
from dynaforge.sim.spec import BodySpec, Launch, SceneSpec
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.phase import REDUCED_SPEED
from dynaforge.tasks.predicates import Aligned, All, Departed, Fallen, Grasped, Gripped, Lifted, Near, Reached, Touched
from dynaforge.tasks.rolling import start_of_roll
from dynaforge.tasks.targets import Above, Downstream, Raised
from dynaforge.tasks.task import Mode, Phase, ResidualSpec, Task

RADIUS = 0.033
REACH = 0.60
UNDER_PALM = under_palm(RADIUS)

CONDITIONS = ConditionSpace(
    task="can",
    difficulty="speed",
    ranges={
        # Nearly static up to the paper's 1.5 m/s at launch.
        "speed": (0.05, 1.5),
        # The sign is the side it comes from: right or left.
        "side": (-1.0, 1.0),
        # Up to 20 degrees off the straight line across the workspace.
        "heading": (-0.35, 0.35),
        # A point on its line in front of the robot: x in the middle of the reach; y, the offset along the line.
        "cross_x": (0.42, 0.55),
        "cross_y": (-0.05, 0.05),
        # Seconds, at launch speed, until it enters the reach: the arm needs 0.7 s to get there, after 0.2 s to start.
        "lead": (0.9, 1.3),
        # From an almost empty to a full can, kg.
        "mass": (0.1, 0.4),
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
    """Roll the can without slip along its heading."""
    v = condition.values
    frame = start_of_roll(v, height=RADIUS, reach=REACH)
    x, z = frame.rotation[:, 0], frame.rotation[:, 2]
    axis = np.cross(x, z)
    c, s = math.cos(v["roll"]), math.sin(v["roll"])
    rotation = np.column_stack((c * x + s * z, c * z - s * x, axis))
    spin = np.cross(z, x) * v["speed"] / RADIUS
    return {"can": Launch(Pose(rotation, frame.position), v["speed"] * x, spin, v["mass"])}


TASK = Task(
    name="can",
    env_name="Can",
    skill="grasp",
    motion="A can is launched rolling without slip at 0.05 to 1.5 m/s; from then on only physics moves it.",
    randomisation="Speed, side, heading within 20 degrees, line, launch distance, mass 0.1 to 0.4 kg, roll angle.",
    goal="The can is lifted 10 cm, gripped by both fingers, for 0.25 s.",
    instruction="pick up the rolling can",
    scene=SceneSpec(bodies=(BodySpec("can", "can/can.urdf"),), launch=launch),
    conditions=CONDITIONS,
    phases=(
        Phase(
            "pregrasp",
            Mode.GLOBAL,
            Downstream("can", 0.085, reach=REACH, clearance=0.08),
            width=0.08,
            done=All((Reached(0.03), Near("can", 0.30))),
            timeout=3.0,
            failure="not reached",
        ),
        Phase(
            "track",
            Mode.IK,
            Above("can", 0.085),
            width=0.08,
            gate=True,
            done=Aligned("can", 0.012, 0.03),
            hold=1 / 30,
            lowest=UNDER_PALM,
            timeout=2.5,
            failure="lost track",
        ),
        Phase(
            "descend",
            Mode.IK,
            Above("can", 0.0),
            width=0.08,
            gate=True,
            done=Aligned("can", 0.02, 0.03, height=0.012),
            ramp=REDUCED_SPEED,
            lowest=UNDER_PALM,
            timeout=1.0,
            failure="missed descent",
            track_until=Touched("can"),
        ),
        Phase(
            "close",
            Mode.IK,
            Above("can", 0.0),
            width=0.0,
            gate=True,
            done=Grasped("can"),
            hold=0.1,
            lowest=UNDER_PALM,
            timeout=0.8,
            failure="missed close",
            track_until=Touched("can"),
        ),
        Phase(
            "lift",
            Mode.GLOBAL,
            Raised("can", 0.15),
            width=0.0,
            done=All((Lifted("can", 0.10), Gripped("can"))),
            hold=0.25,
            timeout=2.5,
            failure="slipped",
        ),
    ),
    impossible=(("dropped", Fallen("can")), ("lost track", Departed("can", 0.75))),
    # Along the heading: the arm, within its limits, trails a can at 1 m/s by 15 cm. Upward: twice the hover height.
    # Across: half the can's length. Rolling or pitching the hand would only press a finger onto the can.
    residual=ResidualSpec(translation=(0.15, 0.06, 0.15), rotation=(0.0, 0.0, 0.15)),
)
