"""Whether the columns of an episode agree with each other and with its task, checked without simulating anything."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos.episode import Episode
from dynaforge.geometry import Array, Pose, matrix_from_quat, matrix_from_rotvec
from dynaforge.planning import ArmKinematics
from dynaforge.sim import BodyState
from dynaforge.tasks import Task
from dynaforge.tasks.view import heading_frame

EXACT = 1e-9  # metres, radians, seconds: how far rounding on another machine may change a sum
MEASURED = 1e-6  # metres, and components of a unit quaternion: Bullet's kinematics against Pinocchio's
NO_SPIN = np.zeros(3)
Steps = Mapping[str, NDArray[Any]]


def contradictions(episode: Episode, task: Task, kinematics: ArmKinematics) -> Iterator[str]:
    """Compare every column that follows from others with what it follows from; missing columns are skipped.

    Args:
        episode: What was recorded.
        task: Its task, as defined when the episode was recorded.
        kinematics: Kinematics of the arm.

    Yields:
        What contradicts what, and the first step at which it does.
    """
    yield from _outcome(episode, task)
    if len(episode):
        yield from _peaks(episode)
        yield from _clock(episode, task)
        yield from _program(episode, task)
        yield from _residual(episode.steps, task)
        yield from _request(episode.steps)
        yield from _projection(episode.steps, task, kinematics)
        if is_planned(episode):
            yield from _speeds(episode.steps, task, kinematics)
        yield from _hand(episode.steps, kinematics)
        yield from _contact(episode, task)


def _first(wrong: Any, text: str) -> Iterator[str]:
    """Yield a text with the first step at which something is wrong."""
    steps = np.flatnonzero(wrong)
    if len(steps):
        yield f"{text} at step {steps[0]}"


def _has(steps: Steps, *names: str) -> bool:
    return all(name in steps for name in names)


def is_planned(episode: Episode) -> bool:
    """Return whether an episode ran a phase program; one in which a learned policy acted alone has no phases."""
    return episode.outcome.phase != "" or bool({"phase", "gate", "planner_action"} & set(episode.steps))


def _outcome(episode: Episode, task: Task) -> Iterator[str]:
    outcome, names, last = episode.outcome, [phase.name for phase in task.phases], 0
    if is_planned(episode):
        if outcome.phase not in names:
            yield f"it ends in phase {outcome.phase!r}, which the task does not have"
            return
        last = names.index(outcome.phase)
        if outcome.success and last != len(names) - 1:
            yield f"it succeeds in phase {outcome.phase!r}, which is not the last"
    if "phase" in episode.steps and len(episode):  # a program that went back keeps the checkpoints that it passed
        last = max(last, int(episode.steps["phase"].max()))
    reached = len(names) if outcome.success else last
    if outcome.checkpoint != reached:
        yield f"its checkpoint is {outcome.checkpoint}, where its phase {outcome.phase!r} makes it {reached}"
    rewards = episode.steps.get("reward")
    share = replace(outcome, checkpoint=reached, n_checkpoints=len(names)).episodic_return()
    if rewards is not None and len(rewards) and abs(rewards[-1] - share) > EXACT:
        yield f"its last reward is {rewards[-1]:g}, its outcome is worth {share:g}"


def _clock(episode: Episode, task: Task) -> Iterator[str]:
    time, dt = episode.steps["time"], task.scene.control_dt
    yield from _first(np.abs(time - dt * np.arange(len(time))) > EXACT, "time does not count the control steps")
    if len(time) > task.time_limit / dt + 1.0:
        yield f"it has {len(time)} control steps, more than the phases of the task may last"
    if abs(episode.duration - dt * len(time)) > EXACT:
        yield f"its duration is {episode.duration:g} s, its {len(time)} control steps take {dt * len(time):g} s"


def _peaks(episode: Episode) -> Iterator[str]:
    """Check that no control step has a greater force than the episode; only the last step is in no column."""
    if _has(episode.steps, "peak_force") and episode.loads is not None:
        greatest = episode.loads.peak_force
        yield from _first(episode.steps["peak_force"] > greatest, f"peak_force exceeds the episode's {greatest:.4g} N")


def _program(episode: Episode, task: Task) -> Iterator[str]:
    """Check phase and gate: the program advances one phase at a time or retries, and the phase says the gate."""
    names = [phase.name for phase in task.phases]
    if "phases" in episode.meta and list(episode.meta["phases"]) != names:
        yield f"its phases are {episode.meta['phases']}, those of the task {names}"
    if not _has(episode.steps, "phase"):
        return
    phase = episode.steps["phase"].astype(int)
    ways = {(k, k + step) for k in range(len(names)) for step in (0, 1)}
    ways |= {(k, names.index(each.retry[0])) for k, each in enumerate(task.phases) if each.retry is not None}
    wrong = (phase < 0) | (phase >= len(names))
    wrong |= [way not in ways for way in zip(np.r_[0, phase[:-1]].tolist(), phase.tolist(), strict=True)]
    yield from _first(wrong, "phase does not follow the task's program")
    # An episode that fails as it enters a phase has no step of it.
    last = episode.outcome.phase
    if last in names and (int(phase[-1]), names.index(last)) not in ways:
        yield f"phase ends with {phase[-1]}, the episode in {last!r}"
    if _has(episode.steps, "gate") and not wrong.any():
        gates = np.array([each.gate for each in task.phases])
        yield from _first(episode.steps["gate"] != gates[phase], "gate is not that of its phase")


def _residual(steps: Steps, task: Task) -> Iterator[str]:
    """Check that the residual is zero while the gate is closed, within its scales, and one action within a decision."""
    if not _has(steps, "residual_action", "gate"):
        return
    residual, gate = steps["residual_action"], steps["gate"]
    if residual.shape[1] != 7:
        yield f"residual_action has {residual.shape[1]} components, where there are 7"
        return
    yield from _first(~gate & residual.any(axis=1), "residual_action is not zero while the gate is closed,")
    scales = np.array(task.residual.scales)
    for part in (slice(0, 3), slice(3, 6), slice(6, 7)):  # a rotated frame turns each part, but makes none longer
        size = np.linalg.norm(residual[:, part], axis=1)
        yield from _first(size > np.linalg.norm(scales[part]) + EXACT, "residual_action is beyond its scale")
    if (headings := _headings(steps, task)) is None:
        return
    shares = np.array([phase.residual_share for phase in task.phases])
    local = residual.copy()
    for part in (slice(0, 3), slice(3, 6)):
        local[:, part] = np.einsum("ti,tij->tj", residual[:, part], headings)  # row vectors: v_frame = v_world @ R
    local /= shares[steps["phase"].astype(int)][:, None]
    index = np.arange(len(gate))
    opened = np.flatnonzero(gate & ~np.roll(gate, 1) | (index == 0))
    since_opening = index - opened[np.searchsorted(opened, index, side="right") - 1]
    within_decision = gate[1:] & gate[:-1] & (since_opening[1:] % task.residual.decision_steps != 0)
    changed = (np.abs(np.diff(local, axis=0)) > EXACT).any(axis=1)
    yield from _first(np.r_[False, within_decision & changed], "residual_action changes within a decision")


def _headings(steps: Steps, task: Task) -> Array | None:
    """Return the axes of a_res at every step, shape (T, 3, 3); None where the columns do not tell them."""
    phase = steps.get("phase")
    if phase is None or not ((phase >= 0) & (phase < len(task.phases))).all():
        return None
    if task.residual.frame == "world":
        return np.broadcast_to(np.eye(3), (len(phase), 3, 3))
    free = {body.name for body in task.scene.bodies}
    aims = [each.target.object for each in task.phases]
    turned: dict[str, Array] = {}
    for name in set(aims):
        kind = "object" if name in free else "fixture"
        columns = [steps.get(f"{kind}/{name}/{column}") for column in ("position", "quat_wxyz", "velocity")]
        if any(column is None for column in columns):
            return None
        frame: Pose | None = None
        rotations = []
        for position, quat, velocity in zip(*columns, strict=True):
            frame = heading_frame(BodyState(Pose.from_quat(position, quat), velocity, NO_SPIN), frame)
            rotations.append(frame.rotation)
        turned[name] = np.array(rotations)
    return np.array([turned[aims[k]][t] for t, k in enumerate(phase.astype(int))])


def _request(steps: Steps) -> Iterator[str]:
    """Check Eq. 5 before its projection: the request is the plan plus the residual, which turns the hand in place."""
    if not _has(steps, "planner_action", "residual_action", "requested_action"):
        return
    plan, residual, requested = steps["planner_action"], steps["residual_action"], steps["requested_action"]
    if plan.shape[1] != 8 or residual.shape[1] != 7:
        yield f"planner_action has {plan.shape[1]} components, residual_action {residual.shape[1]}, not 8 and 7"
        return
    moved = plan[:, [0, 1, 2, 7]] + residual[:, [0, 1, 2, 6]]
    wrong = (np.abs(requested[:, [0, 1, 2, 7]] - moved) > EXACT).any(axis=1)
    turn, quat = residual[:, 3:6], plan[:, 3:7]
    wrong |= (np.abs(np.linalg.norm(quat, axis=1) - 1.0) > MEASURED) | (np.linalg.norm(turn, axis=1) > 2.0 * np.pi)
    for k in np.flatnonzero(~wrong):
        turned = Pose(matrix_from_rotvec(turn[k]) @ matrix_from_quat(quat[k]), np.zeros(3)).quat_wxyz
        wrong[k] = _quat_distance(requested[k : k + 1, 3:7], turned[None])[0] > EXACT
    yield from _first(wrong, "requested_action is not planner_action plus residual_action")


def _quat_distance(a: Array, b: Array) -> Array:
    """Return the largest difference of components of quaternions, shape (T,); q and -q are the same rotation."""
    return np.asarray(np.minimum(np.abs(a - b).max(axis=1), np.abs(a + b).max(axis=1)))


def _projection(steps: Steps, task: Task, kinematics: ArmKinematics) -> Iterator[str]:
    """Check that the projected action is the joint and width reference, and that the fingers can follow."""
    if _has(steps, "projected_action", "joint_reference") and steps["projected_action"].shape[1] == 8:
        action = steps["projected_action"]
        position, quat = _forward(steps["joint_reference"], kinematics)
        wrong = (np.abs(action[:, :3] - position) > EXACT).any(axis=1) | (_quat_distance(action[:, 3:7], quat) > EXACT)
        yield from _first(wrong, "projected_action is not where joint_reference brings the hand")
        if _has(steps, "width_reference"):
            wrong = np.abs(action[:, 7] - steps["width_reference"]) > EXACT
            yield from _first(wrong, "projected_action and width_reference ask for different widths")
    robot, dt = kinematics.robot, task.scene.control_dt
    if _has(steps, "width_reference"):
        width = np.r_[robot.width_max, steps["width_reference"]]
        wrong = np.abs(np.diff(width)) > 2.0 * robot.finger_speed_max * dt + EXACT
        wrong |= (width[1:] < 0.0) | (width[1:] > robot.width_max)
        yield from _first(wrong, "width_reference is no way that the fingers can go")


def _speeds(steps: Steps, task: Task, kinematics: ArmKinematics) -> Iterator[str]:
    """Check that joint references agree with their velocities, as they do where the planner moves the arm."""
    robot, dt = kinematics.robot, task.scene.control_dt
    if _has(steps, "joint_reference", "joint_velocity_reference"):
        q = np.vstack((robot.q_ready, steps["joint_reference"]))
        dq = np.vstack((np.zeros(7), steps["joint_velocity_reference"]))
        # The mean of two velocities errs most where the acceleration changes its sign half way.
        bound = 0.25 * dt * dt * robot.ddq_max
        error = np.abs(np.diff(q, axis=0) - 0.5 * dt * (dq[1:] + dq[:-1])) / bound
        yield from _first((error > 1.01).any(axis=1), "joint_velocity_reference is not the speed of joint_reference")


def _hand(steps: Steps, kinematics: ArmKinematics) -> Iterator[str]:
    """Check that the measured pose of the hand follows from the measured joints."""
    if not _has(steps, "q", "ee_position", "ee_quat_wxyz"):
        return
    position, quat = _forward(steps["q"], kinematics)
    wrong = (np.abs(steps["ee_position"] - position) > MEASURED).any(axis=1)
    yield from _first(wrong, "ee_position is not where q brings the hand")
    yield from _first(
        _quat_distance(steps["ee_quat_wxyz"], quat) > MEASURED, "ee_quat_wxyz is not how q turns the hand"
    )


def _forward(q: Array, kinematics: ArmKinematics) -> tuple[Array, Array]:
    poses = [kinematics.forward(row) for row in q]
    return np.array([pose.position for pose in poses]), np.array([pose.quat_wxyz for pose in poses])


def _contact(episode: Episode, task: Task) -> Iterator[str]:
    """Check the times of contact in the header against the columns that they were computed from."""
    steps = episode.steps
    if _has(steps, "left_contact", "right_contact"):
        contact = steps["left_contact"] | steps["right_contact"]
        yield from _stored_time(episode, "contact_time", contact, "its contacts begin")
    if _has(steps, "phase"):
        planned = steps["phase"] >= task.contact_phase
        yield from _stored_time(episode, "planned_contact_time", planned, "its phase of contact begins")


def _stored_time(episode: Episode, name: str, condition: NDArray[np.bool_], event: str) -> Iterator[str]:
    """Compare a time in `meta` with that of the first step at which a condition is true."""
    found = np.flatnonzero(condition)
    first = float(episode.steps["time"][found[0]]) if len(found) else None
    if name in episode.meta and episode.meta[name] != first:
        yield f"its {name} is {episode.meta[name]}, {event} at {first}"
