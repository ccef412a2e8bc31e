"""Real sensing: what is seen is late and blurred, what is judged is not."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from trajectory_hash import TrajectoryHash, condition

from dynaforge.demos.replay import Replayer
from dynaforge.envs import executor as executor_module
from dynaforge.envs.observation import ObservationBuilder
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.sensing import PoseTrack, Sensor
from dynaforge.envs.task_env import TaskEnv
from dynaforge.envs.world import ControlStep
from dynaforge.generators.generator import PlannerOnly
from dynaforge.geometry import Pose, rotation_z
from dynaforge.registration import ENV_NAMES
from dynaforge.sim import BodyState, Condition, SceneState
from dynaforge.sim.delays import DelayLine, Delays, Sensing

DT = 1.0 / 30.0


def condition_with(delays: Delays) -> Condition:
    """Return a condition that has these delays."""
    return next(c for c in (replace(condition(3), seed=seed) for seed in range(1000)) if Delays.drawn_by(c) == delays)


def scene(step: int, speed: float = 0.3) -> SceneState:
    """A can that moves along x; the first joint tells the step."""
    pose = Pose(np.eye(3), np.array((speed * step * DT, 0.0, 0.03)))
    return SceneState(
        time=step * DT,
        q=np.full(7, float(step)),
        dq=np.zeros(7),
        ee=Pose.identity(),
        width=0.08,
        objects={"can": BodyState(pose, np.array((speed, 0.0, 0.0)), np.zeros(3))},
        touching={"can": (False, False)},
        on_table={"can": True},
    )


def run(env: ResidualEnv, chosen: Condition) -> str:
    trace = TrajectoryHash(env.world)
    env.reset(options={"condition": chosen})
    done = False
    while not done:
        *_, done, _, _ = env.step(np.zeros(env.action_space.shape, np.float32))
    env.world.listeners.remove(trace)
    return trace.hex


def test_a_delay_line_is_late_by_as_many_steps_as_wait_in_it() -> None:
    line = DelayLine((-2, -1))
    assert [line.push(k) for k in range(4)] == [-2, -1, 0, 1]
    assert DelayLine[int]().push(7) == 7


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_joint_readings_and_object_poses_have_the_same_age(delay: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dynaforge.envs.sensing.POSE_OFFSET", (0.0, 0.0))
    monkeypatch.setattr("dynaforge.envs.sensing.POSE_NOISE", (0.0, 0.0))
    sensor = Sensor(DT)
    seen = [sensor.reset(scene(0), condition_with(Delays(delay, 0))), *(sensor.push(scene(k)) for k in range(1, 6))]
    for step, state in enumerate(seen):
        assert state.time == scene(step).time
        assert state.q[0] == max(step - delay, 0)
        np.testing.assert_allclose(state.objects["can"].pose.position[0], 0.3 * (step - delay) * DT, atol=1e-12)
        np.testing.assert_allclose(state.objects["can"].velocity, (0.3, 0.0, 0.0), atol=1e-9)


def test_velocities_are_weighted_differences_of_sensed_poses() -> None:
    track = PoseTrack(np.zeros(6), 0.1)
    for x, angle in ((0.0, 0.0), (0.01, 0.1), (0.03, 0.1), (0.03, 0.3)):
        state = track.push(Pose(rotation_z(angle), np.array((x, 0.0, 0.0))), np.zeros(6))
        assert not state.velocity.any()
    state = track.push(Pose(rotation_z(0.4), np.array((0.07, 0.0, 0.0))), np.zeros(6))
    # Differences 10, 20, 0, 40 mm and 0.1, 0.0, 0.2, 0.1 rad, weights 0.2, 0.3, 0.3, 0.2, every 0.1 s.
    np.testing.assert_allclose(state.velocity, (0.16, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(state.angular_velocity, (0.0, 0.0, 1.0), atol=1e-9)


def test_a_constant_offset_moves_poses_and_no_velocity() -> None:
    track = PoseTrack(np.array((0.01, 0.0, 0.0, 0.0, 0.0, 0.5)), 0.1)
    for _ in range(6):
        state = track.push(Pose.identity(), np.zeros(6))
    np.testing.assert_allclose(state.pose.position, (0.01, 0.0, 0.0))
    np.testing.assert_allclose(state.pose.rotation, rotation_z(0.5), atol=1e-12)
    np.testing.assert_allclose([state.velocity, state.angular_velocity], 0.0, atol=1e-12)


def test_conditions_draw_every_delay() -> None:
    drawn = {Delays.drawn_by(replace(condition(3), seed=seed)) for seed in range(100)}
    assert drawn == {Delays(sensing, action) for sensing in range(3) for action in range(2)}


def test_a_command_reaches_the_robot_one_control_step_late() -> None:
    env = TaskEnv("can", action_mode="joint", sensing="real")
    sent: list[np.ndarray] = []
    step = env.world.scene.step
    env.world.scene.step = lambda q, width: (sent.append(q), step(q, width))[1]  # type: ignore[method-assign]
    env.reset(options={"condition": condition_with(Delays(0, 1))})
    commanded = [env.world.reference.joints.q]
    for _ in range(3):
        env.step(env.action_space.low)
        commanded.append(env.world.reference.joints.q)
    assert not np.array_equal(commanded[0], commanded[1])
    np.testing.assert_array_equal(sent, commanded[:3])
    env.close()


def test_predicates_read_the_truth_and_targets_and_the_observation_what_is_sensed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    judged: list[SceneState] = []
    aimed: list[SceneState] = []
    holds, aims = executor_module.evaluate_predicate, executor_module.evaluate_target
    monkeypatch.setattr(executor_module, "evaluate_predicate", lambda *a: (judged.append(a[3].state), holds(*a))[1])
    monkeypatch.setattr(executor_module, "evaluate_target", lambda *a: (aimed.append(a[2].state), aims(*a))[1])
    observed: list[SceneState] = []
    monkeypatch.setattr(
        ObservationBuilder, "push", lambda self, state: (observed.append(state), self._history.append(state))[1]
    )
    env = ResidualEnv("can", sensing="real")
    true: list[SceneState] = []
    seen: list[SceneState] = []
    with env.world.listening(lambda step: (true.append(step.before), seen.append(step.sensed))):
        run(env, condition_with(Delays(2, 0)))
    true.append(env.world.state)
    seen.append(env.world.sensed)
    assert judged
    assert {id(s) for s in judged} <= {id(s) for s in true}
    assert aimed
    assert {id(s) for s in aimed} <= {id(s) for s in seen}
    assert observed
    assert {id(s) for s in observed} <= {id(s) for s in seen}
    assert not {id(s) for s in true} & {id(s) for s in seen}
    env.close()


def test_a_condition_fixes_what_is_sensed_whatever_came_before() -> None:
    env, chosen = ResidualEnv("can", sensing="real"), condition(3)
    first = run(env, chosen)
    run(env, condition(5))
    assert run(env, chosen) == first
    env.close()


def test_with_ideal_sensing_the_truth_itself_is_seen() -> None:
    env = ResidualEnv("can")
    env.reset(options={"condition": condition(3)})
    env.step(np.zeros(env.action_space.shape, np.float32))
    assert env.world.sensed is env.world.state
    env.close()


def test_an_unknown_sensing_is_refused() -> None:
    with pytest.raises(ValueError, match="sensing"):
        ResidualEnv("can", sensing="reel")  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("name", [f"DynaForge/{name}{kind}-v0" for name in ENV_NAMES.values() for kind in ("", "Task")])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_every_env_keeps_its_contract_with_real_sensing(name: str) -> None:
    env = gym.make(name, sensing="real")
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.parametrize("sensing", ["ideal", "real"])
def test_a_recording_keeps_the_truth_and_what_was_sensed_where_it_differs(sensing: Sensing) -> None:
    env = ResidualEnv("can", sensing=sensing)
    steps: list[ControlStep] = []
    with env.world.listening(steps.append):
        episode = PlannerOnly().attempt(env, condition_with(Delays(2, 0)))
    np.testing.assert_array_equal(episode.steps["q"], [step.before.q for step in steps])
    sensed = {name for name in episode.steps if name.startswith("sensed/")}
    assert bool(sensed) == (sensing == "real")
    if sensed:
        np.testing.assert_array_equal(episode.steps["sensed/q"][2:], episode.steps["q"][:-2])
        wrong = episode.steps["sensed/can/position"][2:] - episode.steps["object/can/position"][:-2]
        assert 1e-4 < np.abs(wrong).max() < 0.02
    env.close()


def test_a_recording_with_late_commands_replays_to_the_bit() -> None:
    env = ResidualEnv("can", sensing="real")
    episode = PlannerOnly().attempt(env, condition_with(Delays(1, 1)))
    env.close()
    for sensing, agrees in (("real", True), ("ideal", False)):
        replayer = Replayer(env.task.under(sensing=sensing))  # type: ignore[arg-type]
        assert (replayer.replay(episode).divergence is None) == agrees
        replayer.close()
