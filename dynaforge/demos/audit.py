"""Whether recorded motion is possible: for a real arm, and for objects that only physics moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.episode import Episode
from dynaforge.demos.prescription import Prescription, prescription_of
from dynaforge.demos.replay import Replayer
from dynaforge.geometry import Array
from dynaforge.sim import RobotDescription, franka

CONTACT_RANGE = 0.25  # metres: no part of the robot touches an object farther from the hand
FINGER_SPEED_GAIN = 1.5  # m/s that turning or closing fingers may add to an object within one control step
POSITION_TOLERANCE = 0.005  # metres
OFF_PATH = 1e-6  # metres
GRAVITY = 9.81
DEEP_CONTACT = 0.005  # metres of penetration that an impact may cause
DEEP_CONTACT_STEPS = 6  # control steps that a deep contact may last: an object squeezed between hand and table
MARGIN = 1.01  # by which a commanded motion may exceed a limit, for rounding


@dataclass(frozen=True, slots=True)
class Flag:
    """Something that cannot happen in a real recording.

    Attributes:
        step: First control step at which it happens.
        violation: Which law it breaks, with the figure.
        times: Number of control steps at which it happens.
    """

    step: int
    violation: str
    times: int

    def __str__(self) -> str:
        more = f", and at {self.times - 1} more" if self.times > 1 else ""
        return f"{self.violation} at step {self.step}{more}"


def audit(episode: Episode, *, robot: RobotDescription | None = None, replayer: Replayer | None = None) -> list[Flag]:
    """Look for teleports, edited velocities, and motion that a real Franka could not make.

    An object whose motion is prescribed, in an episode that says so, must follow its path until physics moves it; the
    path itself may gain speed.

    Args:
        episode: The recorded states and references; a column that was not recorded is skipped.
        robot: Whose limits apply; the Franka by default.
        replayer: Simulates the episode again, to look for deep penetration too.

    Returns:
        One flag for each broken law, ordered by the first step at which it is broken.

    Raises:
        ValueError: Its notes on a prescribed motion are malformed.
    """
    if len(episode) < 3:
        return []
    flags = [*_object_flags(episode), *_arm_flags(episode, robot or franka())]
    if replayer is not None:
        flags += _penetration_flags(episode, replayer)
    return sorted(flags, key=lambda flag: flag.step)


def _flag(broken: NDArray[np.bool_], violation: str, measured: Array) -> Iterator[Flag]:
    """Yield one flag for all steps at which a law is broken; `violation` is formatted with the worst figure."""
    steps = np.flatnonzero(broken)
    if len(steps):
        yield Flag(int(steps[0]), violation.format(float(np.max(measured[broken]))), len(steps))


def _object_flags(episode: Episode) -> Iterator[Flag]:
    steps, dt = episode.steps, np.diff(episode.steps["time"])
    hand, prescribed = steps.get("ee_position"), prescription_of(episode)
    if prescribed is not None:
        yield from _path_flags(episode, prescribed)
    for key in steps:
        kind, _, rest = key.partition("/")
        name = rest.removesuffix("/position")
        velocity = steps.get(f"object/{name}/velocity")
        if kind != "object" or not rest.endswith("/position") or hand is None or velocity is None:
            continue
        position = steps[key]
        speed = np.linalg.norm(velocity, axis=1)
        distance = np.linalg.norm(position - hand, axis=1)
        near_hand = np.minimum(distance[1:], distance[:-1]) < CONTACT_RANGE
        moved = np.linalg.norm(np.diff(position, axis=0), axis=1)
        fastest = np.maximum(speed[1:], speed[:-1]) + np.where(near_hand, FINGER_SPEED_GAIN, 0.0)
        farthest = fastest * dt + POSITION_TOLERANCE
        yield from _flag(moved > farthest, f"{name} jumps {{:.3f}} m, further than its speed carries it,", moved)
        # Away from the hand and all fixtures, only a fall adds speed. The tolerance counts twice because an impact may
        # lie between two steps.
        untouched = ~near_hand & _far_from(episode, position, ("fixture",))
        if prescribed is not None and name == prescribed.motion.body:
            untouched &= steps["time"][:-1] >= prescribed.until
        gained = np.diff(0.5 * speed**2 + GRAVITY * position[:, 2])
        allowed = 1e-3 + 2.0 * GRAVITY * POSITION_TOLERANCE
        yield from _flag(untouched & (gained > allowed), f"{name} gains {{:.2f}} J/kg with nothing near it", gained)


def _path_flags(episode: Episode, prescribed: Prescription) -> Iterator[Flag]:
    """Look for places at which an object is not where its prescribed path says."""
    name, time = prescribed.motion.body, episode.steps["time"]
    position = episode.steps.get(f"object/{name}/position")
    if position is not None:
        path = np.array([prescribed.motion.position(t) for t in time.tolist()])
        off = np.where(time < prescribed.until, np.linalg.norm(position - path, axis=1), 0.0)
        yield from _flag(off > OFF_PATH, f"{name} is {{:.3g}} m off its prescribed path", off)


def _far_from(episode: Episode, position: Array, kinds: tuple[str, ...]) -> NDArray[np.bool_]:
    """Return between which steps a position was out of contact range of all bodies of these kinds."""
    far = np.ones(len(position) - 1, dtype=bool)
    for key, column in episode.steps.items():
        if key.startswith(kinds) and key.endswith("/position"):
            distance = np.linalg.norm(position - column, axis=1)
            far &= np.minimum(distance[1:], distance[:-1]) > CONTACT_RANGE
    return far


def _arm_flags(episode: Episode, robot: RobotDescription) -> Iterator[Flag]:
    steps = episode.steps
    dt = np.diff(steps["time"])[:, None]
    if "q" in steps:
        q = steps["q"]
        beyond = np.maximum(robot.q_lower - q, q - robot.q_upper).max(axis=1)
        yield from _flag(beyond > POSITION_TOLERANCE, "a joint is {:.3f} rad beyond its limit", beyond)
    if "dq" in steps:
        share = (np.abs(steps["dq"]) / robot.dq_max).max(axis=1)  # as the robot's own stop: `stop_speed` says why
        yield from _flag(share > robot.stop_speed, "a joint moves at {:.2f} of its speed limit", share)
    if "width" in steps and "ee_position" in steps:
        speed = np.abs(np.diff(steps["width"])) / dt[:, 0]
        too_fast = (speed > 2.0 * robot.finger_speed_max * 1.05) & _hand_alone(episode)
        yield from _flag(too_fast, "the hand opens or closes at {:.3f} m/s", speed)
    if "joint_velocity_reference" in steps:
        velocity = steps["joint_velocity_reference"]
        if "joint_reference" in steps:
            # The velocity is that of the step's end, or its mean where the target was absolute (`TargetFollower`).
            end, back = steps["joint_reference"], velocity * (0.5 * dt.mean() if len(dt) else 0.0)
            share = np.minimum(*(robot.speed_limits.share(q, velocity) for q in (end, end - back)))
            yield from _flag(share > MARGIN, "a joint is commanded to {:.2f} of its speed limit there", share)
        acceleration = np.diff(velocity, axis=0) / dt
        share = (np.abs(acceleration) / robot.ddq_max).max(axis=1)
        yield from _flag(share > MARGIN, "a joint is commanded to {:.2f} of its acceleration limit", share)
        jerk = (np.abs(np.diff(acceleration, axis=0) / dt[1:]) / robot.dddq_max).max(axis=1)
        yield from _flag(jerk > MARGIN, "a joint is commanded to {:.2f} of its jerk limit", jerk)


def _hand_alone(episode: Episode) -> NDArray[np.bool_]:
    """Return between which steps nothing can have struck the fingers, which a blow moves for a substep."""
    return _far_from(episode, episode.steps["ee_position"], ("object", "fixture"))


def _penetration_flags(episode: Episode, replayer: Replayer) -> Iterator[Flag]:
    depths = [replayer.scene.overlaps() for _ in replayer.states(episode)]
    for pair in depths[0]:
        depth = np.array([row[pair] for row in depths])
        length = longest = last = 0
        for step, deep in enumerate(depth > DEEP_CONTACT):
            length = length + 1 if deep else 0
            if length > longest:
                longest, last = length, step
        if longest > DEEP_CONTACT_STEPS:
            worst = 1000 * depth.max()
            violation = f"{' and '.join(pair)} overlap by up to {worst:.0f} mm for {longest} steps"
            yield Flag(last - longest + 1, violation, times=1)
