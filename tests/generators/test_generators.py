from __future__ import annotations

import pickle

import numpy as np
import pytest

from dynaforge.demos import Episode
from dynaforge.demos.schema import validate_steps
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import ConstantResidual, ExploringPolicy, Oracle, PlannerOnly, ResidualGenerator
from dynaforge.generators.oracle import FeedbackResidual, PhaseResidual, _policy
from dynaforge.geometry import matrix_from_quat, matrix_from_rotvec
from dynaforge.planning import ArmKinematics
from dynaforge.sim import Condition, franka
from dynaforge.tasks import get_task
from dynaforge.tasks.digest import task_digest

SPACE = get_task("can").conditions
ROBOT = franka()


def condition(stratum: int, seed: int) -> Condition:
    return SPACE.draw(np.random.default_rng(seed), stratum, 8)


LIFTED = condition(0, 7)
CONDITIONS = [LIFTED, condition(1, 4), condition(2, 3), condition(4, 3)]
RESIDUAL = ConstantResidual(np.array((0.1, -0.2, 0.15, 0.3, -0.4), np.float32))


@pytest.fixture(scope="module")
def env():
    env = ResidualEnv("can")
    yield env
    env.close()


@pytest.fixture(scope="module", params=["planner only", "with residual"])
def episode(request: pytest.FixtureRequest, env: ResidualEnv) -> Episode:
    generator = PlannerOnly() if request.param == "planner only" else ResidualGenerator(RESIDUAL)
    return generator.attempt(env, LIFTED)


def test_every_step_of_an_episode_fits_the_schema(episode: Episode) -> None:
    steps = validate_steps(episode.steps)
    needed = {
        "planner_action",
        "residual_action",
        "requested_action",
        "projected_action",
        "joint_reference",
        "q",
        "gate",
    }
    assert needed | {"object/can/position", "left_contact", "phase", "reward"} <= set(steps)
    assert len(episode) == round(episode.duration * 30)
    np.testing.assert_allclose(np.diff(steps["time"]), 1 / 30)
    assert steps["phase"].max() < len(episode.meta["phases"])


def test_contact_is_noted_as_planned_and_as_it_came(episode: Episode) -> None:
    steps, meta = episode.steps, episode.meta
    closing = np.flatnonzero(steps["phase"] == meta["phases"].index("close"))
    touching = np.flatnonzero(steps["left_contact"] | steps["right_contact"])
    assert meta["planned_contact_time"] == (steps["time"][closing[0]] if len(closing) else None)
    assert meta["contact_time"] == (steps["time"][touching[0]] if len(touching) else None)
    assert meta["task_hash"] == task_digest(get_task("can"))
    assert len(meta["state_digests"]) == 1 + int(steps["time"][-1])


def test_the_request_is_the_plan_plus_the_gated_residual(episode: Episode) -> None:
    """Eq. 5 before its projection, recorded in the base frame: metres, radians, metres."""
    steps = episode.steps
    assert 0 < steps["gate"].sum() < len(episode)
    for plan, residual, request, gate in zip(
        steps["planner_action"], steps["residual_action"], steps["requested_action"], steps["gate"], strict=True
    ):
        assert gate or not residual.any()
        np.testing.assert_allclose(request[:3], plan[:3] + residual[:3], atol=1e-12)
        turned = matrix_from_rotvec(residual[3:6]) @ matrix_from_quat(plan[3:7])
        np.testing.assert_allclose(matrix_from_quat(request[3:7]), turned, atol=1e-9)
        assert request[7] == pytest.approx(plan[7] + residual[6], abs=1e-12)


def test_what_the_limits_left_is_inside_them(episode: Episode) -> None:
    q, dq = episode.steps["joint_reference"], episode.steps["joint_velocity_reference"]
    assert ((q >= ROBOT.q_lower - 1e-9) & (q <= ROBOT.q_upper + 1e-9)).all()
    assert (np.abs(dq) <= ROBOT.dq_max + 1e-6).all()
    assert (np.abs(np.diff(q, axis=0)) * 30 <= ROBOT.dq_max + 1e-6).all()
    assert (np.abs(np.diff(dq, axis=0)) * 30 <= ROBOT.ddq_max + 1e-3).all()
    width = episode.steps["width_reference"]
    assert ((width >= 0.0) & (width <= ROBOT.width_max)).all()
    assert (np.abs(np.diff(width)) * 30 <= 2 * ROBOT.finger_speed_max + 1e-9).all()


def test_the_projected_action_is_where_the_joint_reference_puts_the_hand(episode: Episode) -> None:
    kinematics = ArmKinematics(ROBOT)
    for k in range(0, len(episode), 10):
        pose = kinematics.forward(episode.steps["joint_reference"][k])
        np.testing.assert_allclose(episode.steps["projected_action"][k][:3], pose.position, atol=1e-12)
        assert episode.steps["projected_action"][k][7] == episode.steps["width_reference"][k]


def test_only_the_last_step_is_rewarded_and_with_the_return(episode: Episode) -> None:
    reward = episode.steps["reward"]
    assert not reward[:-1].any()
    assert reward[-1] == (1.0 if episode.success else episode.outcome.checkpoint / 5)


def test_planner_only_requests_its_plan(env: ResidualEnv) -> None:
    episode = PlannerOnly().attempt(env, LIFTED)
    assert episode.success
    assert episode.generator == "planner_only"
    assert not episode.steps["residual_action"].any()
    np.testing.assert_array_equal(episode.steps["requested_action"], episode.steps["planner_action"])


def test_a_generator_leaves_no_listener_behind(env: ResidualEnv) -> None:
    before = list(env.world.listeners)
    PlannerOnly().attempt(env, LIFTED)

    def broken(observation: np.ndarray) -> np.ndarray:
        raise RuntimeError("no policy")

    with pytest.raises(RuntimeError, match="no policy"):
        ResidualGenerator(broken).attempt(env, LIFTED)
    assert env.world.listeners == before


def test_the_same_attempt_has_the_same_content(env: ResidualEnv) -> None:
    hashes = {ResidualGenerator(RESIDUAL).attempt(env, LIFTED).content_hash() for _ in range(2)}
    assert len(hashes) == 1


def test_the_oracle_is_at_least_as_good_as_the_planner(env: ResidualEnv) -> None:
    oracle = Oracle(m=4)
    for each in CONDITIONS:
        planner, best = PlannerOnly().attempt(env, each), oracle.attempt(env, each)
        assert best.outcome.checkpoint >= planner.outcome.checkpoint
        assert best.generator == "oracle"


def test_the_oracle_wins_what_the_planner_misses(env: ResidualEnv) -> None:
    """The planner misses this can; some residual lifts it."""
    missed = condition(1, 4)
    assert not PlannerOnly().attempt(env, missed).success
    found = Oracle(m=64).attempt(env, missed)
    assert found.success
    assert found.steps["residual_action"].any()


def test_the_oracle_tries_three_kinds_of_residual_in_turn(env: ResidualEnv) -> None:
    which = condition(1, 4)
    zero, constant, redrawn, feedback, *others = (_policy(k, env, which) for k in range(7))
    assert isinstance(zero, ConstantResidual)
    assert isinstance(constant, ConstantResidual)
    assert isinstance(redrawn, PhaseResidual)
    assert isinstance(feedback, FeedbackResidual)
    assert [type(each) for each in others] == [ConstantResidual, PhaseResidual, FeedbackResidual]
    assert not zero.action.any()
    assert constant.action.any()
    assert len(np.unique(redrawn.actions, axis=0)) == len(env.task.phases)
    env.reset(options={"condition": which})
    np.testing.assert_array_equal(redrawn(np.zeros(1, np.float32)), redrawn.actions[env.executor.index])


def test_the_draws_of_the_oracle_depend_on_condition_and_place_alone(env: ResidualEnv) -> None:
    def drawn(k: int, which: Condition) -> str:
        policy = vars(_policy(k, env, which))
        return str({name: value for name, value in policy.items() if name != "_env"})

    here, there = condition(1, 4), condition(2, 3)
    for k in (2, 3):
        assert drawn(k, here) == drawn(k, here)
        assert drawn(k, here) != drawn(k + 3, here)
        assert drawn(k, here) != drawn(k, there)
    hashes = {ResidualGenerator(_policy(3, env, here)).attempt(env, here).content_hash() for _ in range(2)}
    assert len(hashes) == 1


def seen(env: ResidualEnv, **parts: tuple[float, float, float]) -> np.ndarray:
    """Return an observation of zeros, but for the given vectors in SI units."""
    observation, at = np.zeros(env.observer.size, np.float32), 0
    for name, size, scale in env.observer.layout:
        if (value := parts.get(name.removesuffix("[0]"))) is not None:
            observation[at : at + size] = np.array(value) / scale
        at += size
    return observation


def test_feedback_is_nothing_for_a_hand_on_its_target_and_never_more_than_the_scale(env: ResidualEnv) -> None:
    env.reset(options={"condition": LIFTED})
    feedback = FeedbackResidual(env, proportional=1.0, integral=5.0, lead=0.2)
    for _ in range(3):
        assert not feedback(seen(env)).any()
    for _ in range(100):
        far = feedback(seen(env, plan_from_ee=(1.0, -1.0, 1.0), object_velocity=(9.0, -9.0, 9.0)))
        assert env.action_space.contains(far)
    np.testing.assert_allclose(far[:3], (1.0, -1.0, 1.0), atol=1e-6)
    constant = np.full(env.residual_scale.size, -0.5)
    still = FeedbackResidual(env, proportional=1.0, integral=5.0, lead=0.2, constant=constant)
    np.testing.assert_array_equal(still(seen(env)), constant)
    assert env.action_space.contains(still(seen(env, plan_from_ee=(-1.0, -1.0, -1.0))))
    # The sum was held at the scale, so that it takes one decision to come back: 5 / s * 0.1 s * 0.6 m > 2 * 0.15 m.
    back = feedback(seen(env, plan_from_ee=(-0.6, 0.0, 0.0)))
    assert back[0] == -1.0


def test_feedback_adds_lead_offset_and_its_integral_in_metres(env: ResidualEnv) -> None:
    """Worked by hand: e = 10, -4, 6 mm, v = 0.1 m/s, 0.1 s a decision; 20 and 25 mm ahead, of 150 mm."""
    env.reset(options={"condition": LIFTED})
    observation = seen(env, plan_from_ee=(0.010, -0.004, 0.006), object_velocity=(0.1, 0.0, 0.0))
    feedback = FeedbackResidual(env, proportional=0.5, integral=5.0, lead=0.1, upward=False)
    assert env.task.residual.translation == (0.15, 0.06, 0.15)
    np.testing.assert_allclose(feedback(observation), (0.020 / 0.15, -0.004 / 0.06, 0, 0, 0), atol=1e-6)
    np.testing.assert_allclose(feedback(observation), (0.025 / 0.15, -0.006 / 0.06, 0, 0, 0), atol=1e-6)


def test_feedback_sees_the_offset_of_the_hand_from_the_planners_target(env: ResidualEnv) -> None:
    observation, _ = env.reset(options={"condition": LIFTED})
    offset = env.executor.action.target.pose.position - env.world.state.ee.position
    np.testing.assert_allclose(
        env.executor.frame.rotation @ env.observer.read("plan_from_ee", observation), offset, atol=1e-6
    )


def test_generators_survive_pickling() -> None:
    for generator in (PlannerOnly(), ResidualGenerator(RESIDUAL, policy_hash="abc"), Oracle(m=3)):
        assert pickle.loads(pickle.dumps(generator)).name == generator.name


def test_exploring_adds_noise_of_its_sigma_and_repeats_itself() -> None:
    observations = np.random.default_rng(0).normal(size=(4000, 3)).astype(np.float32)
    exploring = ExploringPolicy(ConstantResidual(np.array([0.1, -0.2], np.float32)), 0.2)
    actions = np.array([exploring(observation) for observation in observations])
    np.testing.assert_allclose(actions.mean(axis=0), [0.1, -0.2], atol=0.02)
    np.testing.assert_allclose(actions.std(axis=0), 0.2, atol=0.02)
    assert np.array_equal(exploring(observations[0]), actions[0])
