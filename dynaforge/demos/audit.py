"""Whether what an episode records is possible: for a real arm, and for objects that only physics moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.episode import Episode
from dynaforge.demos.replay import Replayer
from dynaforge.geometry import Array
from dynaforge.sim import RobotDescription, franka

CONTACT_RANGE = 0.25  # metres from the hand: nothing of the robot touches an object there
FINGER_SPEED_GAIN = 1.5  # m/s that turning and closing fingers may add to an object within a control step
POSITION_TOLERANCE = 0.005  # metres
GRAVITY = 9.81
DEEP_CONTACT = 0.005  # metres of penetration that an impact may make
DEEP_CONTACT_STEPS = 6  # control steps that a deep contact may last: an object pressed down between hand and table
MARGIN = 1.01


@dataclass(frozen=True, slots=True)
class Flag:
    """Something that should not happen.

    Attributes:
        step: Control step at which it happened first.
        what: Which law it breaks, with the figure.
        times: At how many steps.
    """

    step: int
    what: str
    times: int

    def __str__(self) -> str:
        more = f", and at {self.times - 1} more" if self.times > 1 else ""
        return f"{self.what} at step {self.step}{more}"


def audit(episode: Episode, *, robot: RobotDescription | None = None, replayer: Replayer | None = None) -> list[Flag]:
    """Look for teleports, edited velocities, and motion that a real Franka could not make.

    Args:
        episode: With the recorded state and references; what was not recorded is not looked at.
        robot: Its limits; the Franka by default.
        replayer: Simulates it again, to look for deep penetration too.
    """
    if len(episode) < 3:
        return []
    flags = [*_objects(episode), *_arm(episode, robot or franka())]
    if replayer is not None:
        flags += _depths(episode, replayer)
    return sorted(flags, key=lambda flag: flag.step)


def _flag(broken: NDArray[np.bool_], what: str, measured: Array) -> Iterator[Flag]:
    """Make one flag of the steps at which a law is broken; `what` takes the worst figure."""
    steps = np.flatnonzero(broken)
    if len(steps):
        yield Flag(int(steps[0]), what.format(float(np.max(measured[broken]))), len(steps))


def _objects(episode: Episode) -> Iterator[Flag]:
    steps, dt = episode.steps, np.diff(episode.steps["time"])
    hand = steps.get("ee_position")
    for key in steps:
        kind, _, rest = key.partition("/")
        name = rest.removesuffix("/position")
        velocity = steps.get(f"object/{name}/velocity")
        if kind != "object" or not rest.endswith("/position") or hand is None or velocity is None:
            continue
        place = steps[key]
        speed = np.linalg.norm(velocity, axis=1)
        away = np.linalg.norm(place - hand, axis=1)
        near = np.minimum(away[1:], away[:-1]) < CONTACT_RANGE
        way = np.linalg.norm(np.diff(place, axis=0), axis=1)
        reach = (np.maximum(speed[1:], speed[:-1]) + np.where(near, FINGER_SPEED_GAIN, 0.0)) * dt + POSITION_TOLERANCE
        yield from _flag(way > reach, f"{name} jumps {{:.3f}} m, further than its speed carries it,", way)
        # Out of the hand's and every fixture's reach, only falling gives speed; twice, for impacts between two steps.
        alone = ~near & _far_from(episode, place, ("fixture",))
        energy = 0.5 * speed**2 + GRAVITY * place[:, 2]
        gained = np.diff(energy)
        allowed = 1e-3 + 2.0 * GRAVITY * POSITION_TOLERANCE
        yield from _flag(alone & (gained > allowed), f"{name} gains {{:.2f}} J/kg with nothing near it", gained)


def _far_from(episode: Episode, place: Array, kinds: tuple[str, ...]) -> NDArray[np.bool_]:
    """Tell between which steps a place was out of reach of all bodies of these kinds."""
    far = np.ones(len(place) - 1, dtype=bool)
    for key, column in episode.steps.items():
        if key.startswith(kinds) and key.endswith("/position"):
            distance = np.linalg.norm(place - column, axis=1)
            far &= np.minimum(distance[1:], distance[:-1]) > CONTACT_RANGE
    return far


def _arm(episode: Episode, robot: RobotDescription) -> Iterator[Flag]:
    steps = episode.steps
    dt = np.diff(steps["time"])[:, None]
    if "q" in steps:
        q = steps["q"]
        beyond = np.maximum(robot.q_lower - q, q - robot.q_upper).max(axis=1)
        yield from _flag(beyond > POSITION_TOLERANCE, "a joint is {:.3f} rad beyond its limit", beyond)
    if "dq" in steps:
        share = (np.abs(steps["dq"]) / robot.dq_max).max(axis=1)
        yield from _flag(share > robot.stop_speed, "a joint moves at {:.2f} of its speed limit", share)
    if "width" in steps and "ee_position" in steps:
        speed = np.abs(np.diff(steps["width"])) / dt[:, 0]
        too_fast = (speed > 2.0 * robot.finger_speed_max * 1.05) & _hand_alone(episode)
        yield from _flag(too_fast, "the hand opens or closes at {:.3f} m/s", speed)
    if "joint_velocity_reference" in steps:
        velocity = steps["joint_velocity_reference"]
        share = (np.abs(velocity) / robot.dq_max).max(axis=1)
        yield from _flag(share > MARGIN, "a joint is asked for {:.2f} of its speed limit", share)
        acceleration = np.diff(velocity, axis=0) / dt
        share = (np.abs(acceleration) / robot.ddq_max).max(axis=1)
        yield from _flag(share > MARGIN, "a joint is asked for {:.2f} of its acceleration limit", share)
        jerk = (np.abs(np.diff(acceleration, axis=0) / dt[1:]) / robot.dddq_max).max(axis=1)
        yield from _flag(jerk > MARGIN, "a joint is asked for {:.2f} of its jerk limit", jerk)


def _hand_alone(episode: Episode) -> NDArray[np.bool_]:
    """Tell between which steps nothing can have pushed the fingers, which give way under load."""
    return _far_from(episode, episode.steps["ee_position"], ("object", "fixture"))


def _depths(episode: Episode, replayer: Replayer) -> Iterator[Flag]:
    depths = [replayer.scene.overlaps() for _ in replayer.states(episode)]
    for pair in depths[0]:
        depth = np.array([row[pair] for row in depths])
        run, longest, end = 0, 0, 0
        for step, deep in enumerate(depth > DEEP_CONTACT):
            run = run + 1 if deep else 0
            if run > longest:
                longest, end = run, step
        if longest > DEEP_CONTACT_STEPS:
            worst = 1000 * depth.max()
            yield Flag(
                end - longest + 1, f"{' and '.join(pair)} overlap by up to {worst:.0f} mm for {longest} steps", 1
            )
