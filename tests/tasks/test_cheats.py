"""End states that look like successes and are none: Bullet puts hand and object there, physics runs, the judge judges.

Each has its honest counterpart, which must be accepted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest

from dynaforge.geometry import Array, Pose, matrix_from_rotvec, rotation_z
from dynaforge.planning.kinematics import ArmKinematics
from dynaforge.sim import Condition, SimScene, franka
from dynaforge.sim.hand import HandCommand, HandState
from dynaforge.tasks import get_task
from dynaforge.tasks.success import SuccessJudge
from dynaforge.tasks.targets import DOWN_ALONG_Y

HIGH = np.array((0.5, 0.0, 0.5))
PADS = 0.0021  # an object is so much narrower than the hand is open when both fingers touch it, metres
LEVEL = np.column_stack((np.cross((0.0, 1.0, 0.0), (1.0, 0.0, 0.0)), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)))
"""The hand points ahead; its fingers open along y."""
LYING_ALONG_X = np.column_stack(((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)))
STILL = np.zeros(3)
LAUNCHED = {"can": LYING_ALONG_X, "bottle": LYING_ALONG_X, "toycar": np.eye(3)}
ACROSS = {"can": 0.0652, "bottle": 0.056, "toycar": 0.056}
"""Width of the object where the fingers hold it, metres."""
GRIP_AT = {"can": (0.0, 0.0, 0.0), "bottle": (0.026, 0.0, 0.0), "toycar": (0.0, 0.0, 0.0)}
"""Where the object is held, from its origin as it is launched, metres."""


@cache
def hand_at(x: float, y: float, z: float, rotation: tuple[float, ...]) -> Array:
    """Return joint positions at which the end effector is there."""
    found = ArmKinematics(franka()).solve_cold(
        Pose(np.reshape(rotation, (3, 3)), np.array((x, y, z))), q_seed=franka().q_ready
    )
    assert found.converged
    return found.q


class Stage:
    """A task's scene in which everything can be put anywhere, and the judge of its success."""

    def __init__(self, name: str, **values: float) -> None:
        task = get_task(name)
        middle = {field: (low + high) / 2 for field, (low, high) in task.conditions.ranges.items()} | values
        self.world = SimScene(task.scene)
        self.client, self.robot = self.world._bullet.client, self.world._bullet.robot
        self.start = self.world.reset(Condition(name, 1, 0.0, middle))
        self.judge = SuccessJudge(task, self.start)
        self.q, self.width = self.world.robot.q_ready, 0.08

    def put_hand(self, position: Array, rotation: Array, width: float, *, closing: float | None = None) -> None:
        """Put the hand somewhere, its fingers so far apart and told to go on to another width."""
        self.q = hand_at(*np.round(position, 9).tolist(), tuple(rotation.ravel().tolist()))
        for joint, q in zip(self.robot.arm, self.q.tolist(), strict=True):
            self.client.resetJointState(self.robot.body, joint, q)
        for joint in self.robot.fingers:
            self.client.resetJointState(self.robot.body, joint, width / 2)
        self.world._arm.reset(q=self.q)
        self.width = width if closing is None else closing
        finger, late = (width / 2, width / 2), self.world._hand.state
        told = (self.width / 2,) * len(late.waiting)  # so that the dead time is over
        self.world._hand.restore(HandState(told, late.due, HandCommand(width / 2, finger, finger)))

    def put(self, name: str, position: Array, rotation: Array, spin: Array = STILL) -> None:
        """Put a free body somewhere, without velocity."""
        body = self.world._bullet.free[name].body
        w, x, y, z = Pose(rotation, position).quat_wxyz.tolist()
        self.client.resetBasePositionAndOrientation(body, position.tolist(), (x, y, z, w))
        self.client.resetBaseVelocity(body, [0, 0, 0], spin.tolist())

    def wins(self, steps: int = 20, *, held: tuple[str, Array, Array, Array] | None = None) -> bool:
        """Let physics run; `held`: a body that is put there again before each control step."""
        won = False
        for _ in range(steps):
            if held is not None:
                self.put(*held)
            won = self.judge.push(self.world.step(self.q, self.width)) or won
        return won


@pytest.fixture
def stage() -> Iterator[type[Stage]]:
    """The class of stages, all of which are closed at the end of the test."""
    opened: list[Stage] = []

    class Closing(Stage):
        def __init__(self, *args: str, **values: float) -> None:
            super().__init__(*args, **values)
            opened.append(self)

    yield Closing
    for one in opened:
        one.world.close()


def in_hand(stage: Stage, name: str, gap: float, closing: float | None = None) -> tuple[str, Array, Array, Array]:
    """Put an object high up between fingers that are `gap` metres from it on either side."""
    stage.put_hand(HIGH, DOWN_ALONG_Y, ACROSS[name] + PADS + 2.0 * gap, closing=closing)
    place = (name, HIGH - GRIP_AT[name], LAUNCHED[name], STILL)
    stage.put(*place)
    return place


@pytest.mark.parametrize("name", ["can", "bottle", "toycar"])
def test_an_object_gripped_high_up_counts_and_with_air_at_the_fingers_does_not(name: str, stage: type[Stage]) -> None:
    honest = stage(name)
    in_hand(honest, name, 0.0005, closing=0.0)
    assert honest.wins()
    for gap in (0.0005, 0.0018):
        loose = stage(name)
        loose.client.setGravity(0, 0, 0)
        assert not loose.wins(held=in_hand(loose, name, gap))


@pytest.mark.parametrize("name", ["can", "bottle", "toycar"])
def test_an_object_with_the_fingers_deep_inside_does_not_count(name: str, stage: type[Stage]) -> None:
    deep = stage(name)
    for _ in range(20):
        in_hand(deep, name, -0.010)
        deep.client.stepSimulation()
        assert not deep.judge.push(deep.world.observe())


@pytest.mark.parametrize("apart", [0.030, 0.045])
@pytest.mark.parametrize("name", ["can", "bottle"])
def test_an_object_cradled_on_open_fingers_does_not_count(name: str, apart: float, stage: type[Stage]) -> None:
    """It lies along the fingers, half of its weight on each; the bottle with its wide end."""
    cradle = stage(name)
    cradle.put_hand(HIGH, LEVEL, apart)
    ahead, radius = {"can": (0.03, 0.0326), "bottle": (0.05, 0.033)}[name]
    rise = 0.0101 + math.sqrt(radius**2 - (apart / 2) ** 2)
    place = (name, HIGH + (ahead, 0.0, rise), LAUNCHED[name], STILL)
    assert not cradle.wins(held=place)


def test_a_lemon_in_the_grip_counts_and_in_air_or_at_the_ledge_does_not(stage: type[Stage]) -> None:
    honest = stage("lemon")
    honest.put_hand(HIGH, LEVEL, 0.05 + PADS, closing=0.0)
    honest.put("lemon", HIGH + (0.004, 0.0, 0.0), LYING_ALONG_X)
    assert honest.wins()
    for gap in (0.001, 0.004):
        loose = stage("lemon")
        loose.client.setGravity(0, 0, 0)
        loose.put_hand(HIGH, LEVEL, 0.05 + PADS + 2.0 * gap)
        assert not loose.wins(held=("lemon", HIGH, LYING_ALONG_X, STILL))
    squeezed = stage("lemon", yaw=0.0, edge_x=0.6, edge_y=0.0, edge_z=0.32)
    place = np.array((0.603, 0.0, 0.345))
    squeezed.put_hand(place, DOWN_ALONG_Y, 0.05 + PADS, closing=0.0)
    squeezed.put("lemon", place, LYING_ALONG_X)
    assert not squeezed.wins()


@pytest.mark.parametrize("apart", [0.047, 0.049])
def test_a_lemon_on_top_of_two_fingers_does_not_count(apart: float, stage: type[Stage]) -> None:
    wedged = stage("lemon")
    wedged.put_hand(HIGH, LEVEL, apart)
    wedged.put("lemon", HIGH + (0.0, 0.0, 0.0105 + math.sqrt(0.025**2 - (apart / 2) ** 2)), LYING_ALONG_X)
    assert not wedged.wins()


SLOW = {"speed": 1e-4, "radius": 0.1, "angle": 0.0, "centre_x": 0.4, "centre_y": 0.0}


def press(stage: type[Stage], depth: float, *, off: float = 0.0, width: float = 0.0, tilt: float = 0.0) -> bool:
    """Press the button so deep with fingers that are so far beside it, apart or tilted; return whether it counts."""
    clock = stage("alarmclock", **SLOW)
    rotation = DOWN_ALONG_Y @ matrix_from_rotvec((0.0, -tilt, 0.0))
    # The fingertips are 8 mm ahead of the end effector, and a tilted finger touches with the edge of its tip.
    above = 0.008 * math.cos(tilt) + 0.0076 * math.sin(tilt)
    top = clock.start.objects["alarmclock"].pose.position
    for sunk in np.linspace(-0.004, depth, 8):
        place = top + (off, 0.0, above - sunk)
        if sunk == -0.004:
            clock.put_hand(place, rotation, width)
        clock.q = hand_at(*np.round(place, 9).tolist(), tuple(rotation.ravel().tolist()))
        if clock.wins(2):
            return True
    return clock.wins(6)


def test_a_gentle_press_of_closed_fingertips_counts(stage: type[Stage]) -> None:
    assert press(stage, 0.0065)


@pytest.mark.parametrize(
    "way",
    [
        pytest.param({"depth": 0.004}, id="not to the click point"),
        pytest.param({"depth": 0.0065, "off": 0.007}, id="7 mm off the middle"),
        pytest.param({"depth": 0.0065, "width": 0.0049}, id="fingers straddle the middle"),
        pytest.param({"depth": 0.0065, "tilt": math.radians(60.0)}, id="by the side of a finger"),
    ],
)
def test_another_press_does_not_count(way: dict[str, float], stage: type[Stage]) -> None:
    assert not press(stage, **way)


def test_a_blow_through_the_stop_does_not_count(stage: type[Stage]) -> None:
    """The fingers are already through the stop when the judge looks."""
    clock = stage("alarmclock", **SLOW)
    top = clock.start.objects["alarmclock"].pose.position
    clock.put_hand(top + (0.0, 0.0, 0.020), DOWN_ALONG_Y, 0.0)
    clock.q = hand_at(*np.round(top + (0.0, 0.0, -0.010), 9).tolist(), tuple(DOWN_ALONG_Y.ravel().tolist()))
    assert not clock.wins(12)


@pytest.mark.parametrize(("height", "spin", "counts"), [(0.031, 0.0, True), (0.031, 60.0, False), (0.036, 0.0, False)])
def test_a_peach_lies_in_the_bowl_and_neither_spins_nor_hovers(
    height: float, spin: float, counts: bool, stage: type[Stage]
) -> None:
    bowl = stage("peach", bowl_speed=0.0)
    if height > 0.031:
        bowl.client.setGravity(0, 0, 0)
    floor = bowl.start.objects["bowl"].pose.position
    bowl.put("peach", floor + (0.0, 0.0, height), np.eye(3), np.array((0.0, 0.0, spin)))
    assert bowl.wins() is counts


@pytest.mark.parametrize(
    ("off", "yaw", "side", "spin", "counts"),
    [
        (0.0, 0.0, False, 0.0, True),
        (0.0, math.pi / 4, True, 0.0, True),  # on another face
        (0.012, math.pi / 4, False, 0.0, True),
        (0.020, math.pi / 4, False, 0.0, False),  # a corner overhangs by 7 mm
        (0.0246, 0.0, False, 0.0, False),  # an edge overhangs by 2 mm
        (0.0, 0.0, False, 20.0, False),
    ],
)
def test_a_block_stands_with_its_whole_foot_on_the_pad_and_does_not_spin(
    off: float, yaw: float, side: bool, spin: float, counts: bool, stage: type[Stage]
) -> None:
    pad = stage("block", pad_speed=0.0)
    frame = pad.start.objects["pad"].pose
    turned = matrix_from_rotvec((math.pi / 2, 0.0, 0.0)) if side else np.eye(3)
    place = frame.apply(np.array((off, 0.0, 0.0225)))
    rotation = frame.rotation @ rotation_z(yaw) @ turned
    turning = np.array((0.0, 0.0, spin))
    pad.put("block", place, rotation)
    assert pad.wins(held=("block", place, rotation, turning) if spin else None) is counts


@pytest.mark.parametrize(("name", "hole"), [("pen", "holder"), ("peg", "hole")])
@pytest.mark.parametrize(
    ("above_floor", "hand", "held", "counts"),
    [
        pytest.param(0.1, True, False, True, id="let go inside"),
        pytest.param(0.39, True, True, False, id="held up by nothing"),
        pytest.param(-0.65, True, True, False, id="below the floor"),
        pytest.param(1.25, False, False, False, id="dropped in, no hand near"),
        pytest.param(1.25, True, False, False, id="dropped in from above the mouth"),
    ],
)
def test_only_what_stands_in_the_hole_by_itself_below_the_hand_that_let_go_counts(
    name: str, hole: str, above_floor: float, hand: bool, held: bool, counts: bool, stage: type[Stage]
) -> None:
    """Heights are shares of the depth; what is held is put there again before each control step, without gravity."""
    length, depth, grip = {"pen": (0.14, 0.08, 0.042), "peg": (0.09, 0.045, 0.018)}[name]
    one = stage(name, speed=1e-4)
    if held:
        one.client.setGravity(0, 0, 0)
    middle = one.start.objects[hole].pose.position + (0.0, 0.0, above_floor * depth + length / 2)
    if hand:
        one.put_hand(middle + (0.0, 0.0, grip), DOWN_ALONG_Y, 0.08)
    place = (name, middle, np.eye(3), STILL)
    one.put(*place)
    assert one.wins(24, held=place if held else None) is counts
