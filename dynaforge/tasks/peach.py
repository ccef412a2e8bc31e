"""Peach: grasp a rolling peach and put it into a moving bowl."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dynaforge.sim import Condition
from dynaforge.sim.hand_target import TIP, under_palm
from dynaforge.sim.spec import BodySpec, FixtureSpec, Launch, Placement, SceneSpec
from dynaforge.tasks.carriers import DRIVEN, carrier
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.phase import REDUCED_SPEED
from dynaforge.tasks.predicates import (
    Aligned,
    All,
    Around,
    AtRestOn,
    Departed,
    Fallen,
    Grasped,
    Lifted,
    Narrowed,
    Near,
    Not,
    Reached,
    Released,
    SupportedBy,
    Touched,
    Within,
)
from dynaforge.tasks.rolling import start_of_roll
from dynaforge.tasks.targets import Above, Downstream, Over, Raised
from dynaforge.tasks.task import Mode, Phase, ResidualSpec, Task

RADIUS = 0.031
REACH = 0.64
UNDER_PALM = under_palm(RADIUS)
# Above the bowl's: the fingertips stay 4 mm above its rim, which is 22 mm high.
ABOVE_RIM = 0.022 + 0.004 + TIP
ARM, SWING = 0.08, 0.08  # arm and amplitude of the bowl's carrier, metres
# The bowl stays within 14 cm of this point, and the peach's line outside: only the hand brings them together.
BOWL_X, BOWL_Y = 0.35, 0.14

CONDITIONS = ConditionSpace(
    task="peach",
    difficulty="speed",
    ranges={
        # Nearly static up to a peach that has rolled down a short ramp.
        "speed": (0.05, 0.8),
        # The sign is the side it comes from: right or left.
        "side": (-1.0, 1.0),
        # Up to 6 degrees off the straight line, so that it stays clear of the bowl.
        "heading": (-0.1, 0.1),
        # A point on its line in front of the robot: x in the outer half of the reach; y, the offset along the line.
        "cross_x": (0.54, 0.59),
        "cross_y": (-0.05, 0.05),
        # Seconds, at launch speed, until it enters the reach: the arm needs 0.7 s to get there, after 0.2 s to start.
        "lead": (0.9, 1.3),
        # From a small to a large peach, kg.
        "mass": (0.08, 0.2),
        # Peak speed of the bowl, up to that of a slow conveyor. Below zero it slides back and forth, else it turns.
        "bowl_speed": (-0.25, 0.25),
        "bowl_phase": (-math.pi, math.pi),
        "bowl_yaw": (-math.pi / 2, math.pi / 2),
    },
    units={
        "speed": "m/s",
        "heading": "rad",
        "cross_x": "m",
        "cross_y": "m",
        "lead": "s",
        "mass": "kg",
        "bowl_speed": "m/s",
        "bowl_phase": "rad",
        "bowl_yaw": "rad",
    },
)


def launch(condition: Condition) -> Mapping[str, Launch | Placement]:
    """Roll the peach without slip along its heading, past the bowl."""
    v = condition.values
    side = math.copysign(1.0, v["side"])
    frame = start_of_roll(v, height=RADIUS, reach=REACH)
    x, z = frame.rotation[:, 0], frame.rotation[:, 2]
    spin = np.cross(z, x) * v["speed"] / RADIUS
    bowl = carrier(
        np.array((BOWL_X, side * BOWL_Y, 0.0)), v["bowl_speed"], yaw=v["bowl_yaw"], phase=v["bowl_phase"],
        arm=ARM, swing=SWING,
    )  # fmt: skip
    return {
        "peach": Launch(frame, v["speed"] * x, spin, v["mass"]),
        "bowl": bowl,
    }


IN_HAND = (("dropped", Not(Around("peach", 0.05))),)
# It touches the bowl in a point, whose friction does not turn it about the vertical: below a peach at rest the bowl
# turns at up to 3.1 rad/s.
SPIN = 4.0
# On the bowl's floor the centre of the peach is RADIUS high, and the wall keeps it within 17 mm of the axis; on the
# rim it is higher.
IN_BOWL = All((Within("peach", "bowl", 0.022, RADIUS + 0.005, floor=RADIUS - 0.005), SupportedBy("peach", "bowl")))
HOVER, RELEASE = RADIUS + 0.045, RADIUS + 0.010
GRIP = 0.05  # commanded width while the peach is grasped: firm on 62 mm, and quick to open again

TASK = Task(
    name="peach",
    env_name="Peach",
    skill="grasp + place",
    motion="A peach is launched rolling at 0.05 to 0.8 m/s; a bowl slides back and forth or turns at up to 0.25 m/s.",
    randomisation="Speed, side, heading, line, launch distance, mass; the bowl's kind of motion, speed, phase and yaw.",
    goal="The peach lies in the bowl, released, at rest relative to it and touching its floor, for 0.25 s.",
    instruction="pick up the rolling peach and put it into the moving bowl",
    scene=SceneSpec(
        bodies=(BodySpec("peach", "peach/peach.urdf"),),
        # The bowl is lined: on bare glaze the peach would roll back and forth for seconds.
        fixtures=(FixtureSpec("bowl", "peach/bowl.urdf", "bowl", driven=DRIVEN, rolling_friction=0.006),),
        launch=launch,
    ),
    conditions=CONDITIONS,
    phases=(
        Phase(
            "pregrasp",
            Mode.GLOBAL,
            Downstream("peach", 0.06, reach=REACH, clearance=0.08),
            width=0.08,
            done=All((Reached(0.03), Near("peach", 0.30))),
            timeout=3.0,
            failure="not reached",
        ),
        # The fingers close along the heading: a peach that is faster than the hand runs into the leading finger.
        Phase(
            "track",
            Mode.IK,
            Above("peach", 0.06),
            width=0.08,
            gate=True,
            done=Aligned("peach", 0.015, 0.03),
            hold=1 / 30,
            lowest=UNDER_PALM,
            timeout=2.0,
            failure="lost track",
        ),
        Phase(
            "descend",
            Mode.IK,
            Above("peach", 0.0),
            width=0.08,
            gate=True,
            done=Aligned("peach", 0.02, 0.03, height=0.012),
            ramp=REDUCED_SPEED,
            lowest=UNDER_PALM,
            timeout=1.0,
            failure="missed descent",
            track_until=Touched("peach"),
        ),
        Phase(
            "close",
            Mode.IK,
            Above("peach", 0.0),
            width=GRIP,
            gate=True,
            done=Grasped("peach"),
            hold=0.1,
            lowest=UNDER_PALM,
            timeout=0.8,
            failure="missed close",
            track_until=Touched("peach"),
        ),
        Phase(
            "lift",
            Mode.GLOBAL,
            Raised("peach", 0.08),
            width=GRIP,
            takes_hold=True,
            done=All((Lifted("peach", 0.06), Grasped("peach"))),
            hold=1 / 30,
            timeout=1.5,
            failure="slipped",
        ),
        Phase(
            "carry",
            Mode.GLOBAL,
            Over("bowl", "peach", HOVER),
            width=GRIP,
            done=Reached(0.02),
            lowest=ABOVE_RIM,
            timeout=2.0,
            failure="not carried",
            fails=IN_HAND,
        ),
        Phase(
            "hover",
            Mode.IK,
            Over("bowl", "peach", HOVER),
            width=GRIP,
            gate=True,
            residual_share=0.4,
            done=Within("peach", "bowl", 0.02, HOVER + 0.02),
            hold=1 / 30,
            lowest=ABOVE_RIM,
            timeout=2.0,
            failure="lost bowl",
            fails=IN_HAND,
        ),
        Phase(
            "lower",
            Mode.IK,
            Over("bowl", "peach", RELEASE),
            width=GRIP,
            gate=True,
            residual_share=0.4,
            done=Within("peach", "bowl", 0.022, RELEASE + 0.006),
            ramp=REDUCED_SPEED,
            lowest=ABOVE_RIM,
            timeout=1.0,
            failure="missed bowl",
            fails=IN_HAND,
        ),
        Phase(
            "release",
            Mode.IK,
            Over("bowl", "peach", RELEASE),
            width=0.08,
            gate=True,
            residual_share=0.4,
            done=Not(Narrowed(0.068)),
            lowest=ABOVE_RIM,
            timeout=0.8,
            failure="not released",
        ),
        Phase(
            "settle",
            Mode.IK,
            Raised("peach", 0.06),
            width=0.08,
            done=All((IN_BOWL, Released("peach"), AtRestOn("peach", "bowl", 0.05, spin=SPIN))),
            hold=0.25,
            ramp=REDUCED_SPEED,
            timeout=1.5,
            failure="not in bowl",
        ),
    ),
    impossible=(("dropped", Fallen("peach")), ("lost track", Departed("peach", 0.78))),
    # Along the heading: the arm, within its limits, trails a peach at 0.8 m/s by 15 cm. Up and down: half the hover
    # height, because a sphere gripped far below its middle slips out upward.
    residual=ResidualSpec(translation=(0.15, 0.04, 0.03), rotation=(0.0, 0.0, 0.15)),
)
