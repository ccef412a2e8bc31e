from __future__ import annotations

import pickle

import numpy as np
import pytest

from dynaforge.demos import Episode
from dynaforge.demos.schema import validate_steps
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import ConstantResidual, ExploringPolicy, Oracle, PlannerOnly, ResidualGenerator
from dynaforge.generators.oracle import PhaseResidual, _policy
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


def test_the_oracle_finds_what_some_constant_residual_can_win(env: ResidualEnv) -> None:
    """The planner misses this can; one of the first constant residuals lifts it."""
    missed = condition(1, 4)
    assert not PlannerOnly().attempt(env, missed).success
    found = Oracle(m=64).attempt(env, missed)
    assert found.success
    assert found.steps["residual_action"].any()


def test_every_other_residual_of_the_oracle_is_redrawn_for_each_phase(env: ResidualEnv) -> None:
    which = condition(1, 4)
    zero, constant, redrawn = (_policy(k, env, which) for k in range(3))
    assert isinstance(zero, ConstantResidual)
    assert isinstance(constant, ConstantResidual)
    assert isinstance(redrawn, PhaseResidual)
    assert not zero.action.any()
    assert constant.action.any()
    assert len(np.unique(redrawn.actions, axis=0)) == len(env.task.phases)
    env.reset(options={"condition": which})
    np.testing.assert_array_equal(redrawn(np.zeros(1, np.float32)), redrawn.actions[env.executor.index])
    np.testing.assert_array_equal(_policy(2, env, which).actions, redrawn.actions)  # type: ignore[attr-defined]


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
