"""Block: grasp a block from a moving tray and put it on a moving pad."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dynaforge.geometry import Pose, rotation_z
from dynaforge.sim import Condition
from dynaforge.sim.hand_target import TIP
from dynaforge.sim.spec import BodySpec, FixtureSpec, Launch, Placement, SceneSpec
from dynaforge.tasks.carriers import DRIVEN, LEVELLED, carried, carrier, levelled, peak_speed
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.phase import REDUCED_SPEED
from dynaforge.tasks.predicates import (
    Aligned,
    All,
    Around,
    AtRestOn,
    Fallen,
    FootOn,
    Grasped,
    Lifted,
    Narrowed,
    Not,
    OnTable,
    Reached,
    Released,
    SupportedBy,
    Upright,
    Within,
)
from dynaforge.tasks.targets import Above, Grip, Over, Raised
from dynaforge.tasks.task import Mode, Phase, ResidualSpec, Task

HALF = 0.0225  # half the edge length of the block, metres
PAD = 0.045  # half the edge length of the pad, twice that of the block, metres
TOP = 0.024  # height of tray and pad above the table, metres
# Least height of the end effector above the origin of block and pad, metres: the fingertips stay 5 mm above
# tray and pad.
ABOVE_TRAY, ABOVE_PAD = 0.005 + TIP - HALF, 0.005 + TIP
TRAY_ARM, TRAY_SWING = 0.15, 0.14
PAD_ARM, PAD_SWING = 0.08, 0.08
# Tray and pad stay within 22 cm and 13 cm of these points, on either side of the robot, and so never meet.
CENTRE_X, TRAY_Y, PAD_Y = 0.47, 0.20, 0.19

CONDITIONS = ConditionSpace(
    task="block",
    difficulty="speed",
    ranges={
        # Mean speed of the tray, nearly static up to a conveyor: at 0.3 m/s one that slides back and forth, up to
        # 0.47 m/s fast, accelerates at up to 1.6 m/s^2, below the 4 m/s^2 at which the block would slide.
        "speed": (0.05, 0.3),
        # Below zero the tray slides back and forth, otherwise an arm carries it in circles.
        "tray_motion": (-1.0, 1.0),
        "tray_phase": (-math.pi, math.pi),
        "tray_yaw": (-math.pi / 2, math.pi / 2),
        # The tray itself turns at up to 30 degrees per second. If it turned with the carrier's arm, at up to 150, the
        # wrist of the tracking hand would lag by up to 40 degrees and delay all other joints: hardly any constant
        # residual succeeded.
        "tray_spin": (-0.5, 0.5),
        # Peak speed of the pad: below zero it slides back and forth, otherwise it turns.
        "pad_speed": (-0.25, 0.25),
        "pad_phase": (-math.pi, math.pi),
        "pad_yaw": (-math.pi / 2, math.pi / 2),
        # The sign is the side of the tray, right or left; the pad is on the other side.
        "side": (-1.0, 1.0),
        # Pose of the block on the tray: offset from its middle, and yaw.
        "offset_x": (-0.01, 0.01),
        "offset_y": (-0.01, 0.01),
        "yaw": (-math.pi / 4, math.pi / 4),
        # From balsa to hardwood, kg.
        "mass": (0.04, 0.12),
    },
    units={
        "speed": "m/s",
        "tray_phase": "rad",
        "tray_yaw": "rad",
        "tray_spin": "rad/s",
        "pad_speed": "m/s",
        "pad_phase": "rad",
        "pad_yaw": "rad",
        "offset_x": "m",
        "offset_y": "m",
        "yaw": "rad",
        "mass": "kg",
    },
)


def launch(condition: Condition) -> Mapping[str, Launch | Placement]:
    """Let the block ride on the tray from the first moment."""
    v = condition.values
    side = math.copysign(1.0, v["side"])
    tray = carrier(
        np.array((CENTRE_X, side * TRAY_Y, 0.0)), peak_speed(v["speed"], v["tray_motion"]), yaw=v["tray_yaw"],
        phase=v["tray_phase"], arm=TRAY_ARM, swing=TRAY_SWING,
    )  # fmt: skip
    pad = carrier(
        np.array((CENTRE_X, -side * PAD_Y, 0.0)), v["pad_speed"], yaw=v["pad_yaw"], phase=v["pad_phase"],
        arm=PAD_ARM, swing=PAD_SWING,
    )  # fmt: skip
    tray = levelled(tray, v["tray_spin"])
    T_world_tray, velocity, spin = carried(tray, arm=TRAY_ARM, height=TOP)
    T_tray_block = Pose(rotation_z(v["yaw"]), np.array((v["offset_x"], v["offset_y"], HALF)))
    T_world_block = T_world_tray @ T_tray_block
    velocity = velocity + np.cross(spin, T_world_block.position - T_world_tray.position)
    return {"block": Launch(T_world_block, velocity, spin, v["mass"]), "tray": tray, "pad": pad}


IN_HAND = (("dropped", Not(Around("block", 0.05))),)
HOVER, RELEASE = HALF + 0.035, HALF + 0.003
GRIP = 0.035  # commanded width while the block is grasped: firm on 45 mm, and quick to open again

TASK = Task(
    name="block",
    env_name="Block",
    skill="grasp + place",
    motion="A block rides on a tray that slides or circles at a mean speed of 0.05 to 0.3 m/s; the pad moves alike.",
    randomisation="Kind, speed, phase and direction of both motions, side, the block's place on the tray, its mass.",
    goal="The block stands on the pad with its whole foot, any face up, released and at rest on it, for 0.25 s.",
    instruction="pick up the block from the moving tray and place it on the moving pad",
    scene=SceneSpec(
        # Painted wood. At 0.8 a block that is askew between the fingers jams instead of turning flat against them.
        bodies=(BodySpec("block", "block/block.urdf", lateral_friction=0.5),),
        fixtures=(
            FixtureSpec("tray", "block/tray.urdf", "tray", driven=LEVELLED),
            FixtureSpec("pad", "block/pad.urdf", "pad", driven=DRIVEN),
        ),
        solver_iterations=50,  # with 20 a fingertip that presses on the block's edge sinks 18 mm in
        launch=launch,
    ),
    conditions=CONDITIONS,
    phases=(
        Phase(
            "pregrasp",
            Mode.GLOBAL,
            Above("block", 0.10, Grip.FACES),
            width=0.08,
            done=Reached(0.03),
            timeout=2.5,
            failure="not reached",
        ),
        Phase(
            "track",
            Mode.IK,
            Above("block", 0.06, Grip.FACES),
            width=0.08,
            gate=True,
            done=Aligned("block", 0.018, height=0.09),
            hold=1 / 30,
            lowest=ABOVE_TRAY,
            timeout=2.0,
            failure="lost track",
        ),
        Phase(
            "descend",
            Mode.IK,
            Above("block", 0.0, Grip.FACES),
            width=0.08,
            gate=True,
            done=Aligned("block", 0.02, height=0.012),
            ramp=REDUCED_SPEED,
            lowest=ABOVE_TRAY,
            timeout=1.0,
            failure="missed descent",
        ),
        Phase(
            "close",
            Mode.IK,
            Above("block", 0.0, Grip.FACES),
            width=GRIP,
            gate=True,
            done=Grasped("block"),
            hold=0.1,
            lowest=ABOVE_TRAY,
            timeout=0.8,
            failure="missed close",
        ),
        Phase(
            "lift",
            Mode.GLOBAL,
            Raised("block", 0.08),
            width=GRIP,
            takes_hold=True,
            done=All((Lifted("block", 0.06), Grasped("block"))),
            hold=1 / 30,
            timeout=1.5,
            failure="slipped",
        ),
        Phase(
            "carry",
            Mode.GLOBAL,
            Over("pad", "block", HOVER),
            width=GRIP,
            done=Reached(0.02),
            lowest=ABOVE_PAD,
            timeout=2.0,
            failure="not carried",
            fails=IN_HAND,
        ),
        Phase(
            "hover",
            Mode.IK,
            Over("pad", "block", HOVER, upright=True),
            width=GRIP,
            gate=True,
            residual_share=0.5,
            done=Within("block", "pad", 0.018, HOVER + 0.02),
            hold=1 / 30,
            lowest=ABOVE_PAD,
            timeout=2.0,
            failure="lost pad",
            fails=IN_HAND,
        ),
        Phase(
            "lower",
            Mode.IK,
            Over("pad", "block", RELEASE, upright=True),
            width=GRIP,
            gate=True,
            residual_share=0.5,
            done=Within("block", "pad", 0.02, RELEASE + 0.004),
            ramp=REDUCED_SPEED,
            lowest=ABOVE_PAD,
            timeout=1.0,
            failure="missed pad",
            fails=IN_HAND,
        ),
        Phase(
            "release",
            Mode.IK,
            Over("pad", "block", RELEASE, upright=True),
            width=0.08,
            gate=True,
            residual_share=0.5,
            done=Not(Narrowed(0.065)),
            lowest=ABOVE_PAD,
            timeout=0.8,
            failure="not released",
        ),
        Phase(
            "settle",
            Mode.IK,
            Raised("block", 0.06),
            width=0.08,
            done=All(
                (
                    FootOn("block", "pad", HALF, PAD),
                    Within("block", "pad", PAD, HALF + 0.005, floor=HALF - 0.005),
                    Upright("block", 0.1, any_face=True),
                    SupportedBy("block", "pad"),
                    Released("block"),
                    AtRestOn("block", "pad", 0.05, spin=1.0),
                )
            ),
            hold=0.25,
            ramp=REDUCED_SPEED,
            timeout=1.5,
            failure="not on pad",
        ),
    ),
    impossible=(("dropped", Fallen("block")), ("knocked off", OnTable("block"))),
    # Along the heading: the arm, within its limits, trails a tray at 0.47 m/s by 7 cm, and a turning one by 3 cm
    # sideways.
    residual=ResidualSpec(translation=(0.08, 0.04, 0.03), rotation=(0.0, 0.0, 0.3)),
)
