"""Lemon: catch a lemon that rolls off a ledge."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dynaforge.geometry import Pose, rotation_z
from dynaforge.sim import Condition
from dynaforge.sim.spec import BodySpec, FixtureSpec, Launch, Placement, SceneSpec
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.phase import REDUCED_SPEED
from dynaforge.tasks.predicates import (
    All,
    Around,
    Between,
    Fallen,
    Grasped,
    Gripped,
    Narrowed,
    Not,
    OnTable,
    Reached,
    SupportedBy,
    Touched,
)
from dynaforge.tasks.targets import Catching
from dynaforge.tasks.task import Mode, Phase, ResidualSpec, Task

RADIUS = 0.025  # radius of the spheres on which it rolls, metres
FLAT = 0.35  # distance from the foot of the ramp to the edge, metres
SLOPE = math.radians(8.0)
RESISTANCE = 0.8 * 2e-4 / RADIUS  # rolling resistance over weight: Bullet's combined friction length over the radius
GRAVITY = 9.81
ROLLING = 5 / 7  # share of gravity's pull that accelerates a ball rolling without slip
FOOT = 0.996  # share of its speed left after the turn onto the flat, measured in simulation

CONDITIONS = ConditionSpace(
    task="lemon",
    difficulty="speed",
    ranges={
        # Speed at the edge, m/s: from a lemon that tips over it to one that flies 12 cm while it falls 3 cm.
        "speed": (0.3, 1.5),
        # Offset of the lemon's line from the middle of the ledge, which is 16 cm wide, metres.
        "offset": (-0.03, 0.03),
        # Position of the middle of the edge, and yaw of the ledge: the hand in front of it stays within reach.
        "edge_x": (0.70, 0.76),
        "edge_y": (-0.06, 0.06),
        "edge_z": (0.30, 0.34),
        "yaw": (-0.10, 0.10),
        # From a small to a large lemon, kg.
        "mass": (0.06, 0.15),
    },
    units={
        "speed": "m/s",
        "offset": "m",
        "edge_x": "m",
        "edge_y": "m",
        "edge_z": "m",
        "yaw": "rad",
        "mass": "kg",
    },
)


def run_up(speed: float) -> float:
    """Return the distance up the ramp from which a lemon released at rest passes the edge at `speed` m/s, metres.

    In simulation the speed is within 1 % of it, and within 5 % below 0.4 m/s.
    """
    drag = ROLLING * GRAVITY * RESISTANCE
    pull = ROLLING * GRAVITY * math.sin(SLOPE) - drag * math.cos(SLOPE)
    at_foot = math.sqrt(speed * speed + 2.0 * drag * FLAT) / FOOT
    return at_foot * at_foot / (2.0 * pull) + RADIUS * math.tan(SLOPE / 2.0)


def launch(condition: Condition) -> Mapping[str, Launch | Placement]:
    """Release the lemon at rest on the ramp, at the height that gives its speed at the edge."""
    v = condition.values
    ledge = Pose(rotation_z(math.pi + v["yaw"]), np.array((v["edge_x"], v["edge_y"], v["edge_z"])))
    c, s = math.cos(SLOPE), math.sin(SLOPE)
    along = run_up(v["speed"])
    centre = np.array((-FLAT - along * c + RADIUS * s, v["offset"], along * s + RADIUS * c))
    start = Pose(ledge.rotation, ledge.apply(centre))
    return {"lemon": Launch(start, np.zeros(3), np.zeros(3), v["mass"]), "ledge": Placement(ledge)}


# Below sqrt(g RADIUS), 0.5 m/s, a lemon does not fly off but rolls round the edge and drops steeply: 5 cm ahead of the
# edge it would already be below the fingers.
CATCH = Catching("lemon", "ledge", ahead=0.04, height=0.005, pitch=math.radians(30.0))
BACKED_OFF = Catching("lemon", "ledge", ahead=0.10, height=0.005, pitch=math.radians(30.0))
# Below 45 mm the fingers pinch only the lemon's near end, and it would slip out if the edge did not wedge it in.
CAUGHT = All((Grasped("lemon"), Around("lemon", 0.025), Narrowed(0.065), Not(Narrowed(0.045))))
HELD = All((CAUGHT, Gripped("lemon"), Between("lemon"), Not(SupportedBy("lemon", "ledge"))))

TASK = Task(
    name="lemon",
    env_name="Lemon",
    skill="catch",
    motion="A lemon rolls down a ramp and off a ledge 0.3 m high, at 0.3 to 1.5 m/s at the edge.",
    randomisation="Speed, lateral offset within 3 cm, place, height and yaw of the ledge, mass 60 to 150 g.",
    goal="The lemon is gripped clear of the ledge for 0.5 s, and has touched neither table nor floor before.",
    instruction="catch the falling lemon",
    scene=SceneSpec(
        bodies=(BodySpec("lemon", "lemon/lemon.urdf"),),
        launch=launch,
        fixtures=(FixtureSpec("ledge", "lemon/ledge.urdf", link="ledge"),),
    ),
    conditions=CONDITIONS,
    phases=(
        Phase(
            "approach",
            Mode.GLOBAL,
            CATCH,
            width=0.066,
            done=Reached(0.03),
            timeout=1.5,
            failure="not reached",
        ),
        Phase(
            "wait",
            Mode.IK,
            CATCH,
            width=0.066,
            gate=True,
            done=Around("lemon", 0.10),
            timeout=2.5,
            failure="never came",
        ),
        Phase(
            "close",
            Mode.IK,
            CATCH,
            width=0.0,
            gate=True,
            done=CAUGHT,
            hold=0.1,
            timeout=0.8,
            failure="missed catch",
            track_until=Touched("lemon"),
        ),
        Phase(
            "hold",
            Mode.IK,
            BACKED_OFF,
            width=0.0,
            done=HELD,
            hold=0.5,
            ramp=REDUCED_SPEED,
            timeout=0.8,
            failure="slipped",
            track_until=Touched("lemon"),
        ),
    ),
    impossible=(("dropped", OnTable("lemon")), ("dropped", Fallen("lemon"))),
    residual=ResidualSpec(translation=(0.05, 0.03, 0.05), rotation=(0.0, 0.25, 0.0), width=0.04, decision_steps=1),
    camera=((0.35, -1.35, 0.75), (0.75, 0.0, 0.30)),
)
