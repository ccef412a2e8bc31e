from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from trajectory_hash import Traced, TrajectoryHash, action, condition, lifted, run

from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.observation import residual_sizes
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.envs.world import World
from dynaforge.geometry import Pose
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome, Phase, Task, get_task
from dynaforge.tasks.digest import task_digest
from dynaforge.tasks.targets import Raised

TASK = get_task("can")
MANY = [condition(0, 5), condition(0), condition(4), condition(7)]


@pytest.fixture(scope="module")
def skip():
    env = Traced(ResidualEnv("can"))
    yield env
    env.close()


@pytest.fixture(scope="module")
def mask():
    env = Traced(ResidualEnv("can", gate_mode="mask"))
    yield env
    env.close()


def drive_planner_only(which: Condition) -> tuple[str, Outcome]:
    """Run prior and physics with no residual anywhere; this is what `ResidualEnv.step(0)` must equal."""
    world = World(TASK)
    trace = TrajectoryHash(world)
    executor = PhaseExecutor(TASK, world.planner, control_dt=TASK.scene.control_dt)
    executor.reset(world.reset(which), which, world.reference)
    while executor.outcome is None:
        state = world.execute(executor.action, None)
        executor.advance(state, world.reference)
    world.close()
    return trace.hex, executor.outcome


@pytest.mark.parametrize("which", MANY, ids=lambda c: f"{c.difficulty:.2f}")
def test_zero_residual_is_planner_only_bit_for_bit(which: Condition, skip: Traced, mask: Traced) -> None:
    planner_only, outcome = drive_planner_only(which)
    for env in (skip, mask):
        digest, info = run(env, which, scale=0.0)
        assert digest == planner_only
        assert Outcome.of_info(info) == outcome


def test_a_residual_changes_the_episode(skip: Traced) -> None:
    assert run(skip, lifted())[0] != run(skip, lifted(), scale=0.0)[0]


def gated_decisions(env: Traced, which: Condition, *, noise: float = 0.0) -> tuple[list[np.ndarray], str, float]:
    """Apply `action(k)` at the k-th gated decision and anything at the others; return what was seen at the gated."""
    seen, k, done, rng = [], 0, False, np.random.default_rng(0)
    observation, _ = env.reset(options={"condition": which})
    while not done:
        gated = env.unwrapped.executor.action.gate
        if gated:
            seen.append(observation)
        chosen = action(k) if gated else (noise * rng.uniform(-1, 1, 5)).astype(np.float32)
        k += gated
        observation, reward, done, _, info = env.step(chosen)
        assert info["residual_mask"] == float(gated)
    return [*seen, observation], info["trajectory"], reward


@pytest.mark.parametrize("which", MANY, ids=lambda c: f"{c.difficulty:.2f}")
def test_both_gate_modes_give_the_same_gated_decisions(which: Condition, skip: Traced, mask: Traced) -> None:
    seen_skip, trajectory_skip, reward_skip = gated_decisions(skip, which)
    seen_mask, trajectory_mask, reward_mask = gated_decisions(mask, which)
    assert trajectory_skip == trajectory_mask
    assert reward_skip == reward_mask
    assert len(seen_skip) > 3
    np.testing.assert_array_equal(seen_skip, seen_mask)


def test_actions_behind_a_closed_gate_have_no_effect(mask: Traced) -> None:
    quiet, loud = gated_decisions(mask, lifted()), gated_decisions(mask, lifted(), noise=1.0)
    assert quiet[1] == loud[1]
    np.testing.assert_array_equal(quiet[0], loud[0])


@pytest.mark.parametrize("mode", ["skip", "mask"])
def test_the_residual_drops_to_zero_the_moment_the_gate_closes(mode: str, request: pytest.FixtureRequest) -> None:
    env: Traced = request.getfixturevalue(mode)
    gated_decisions(env, lifted())
    steps = env.trace.steps
    assert {step.planned.phase for step in steps} == set(range(5))
    for step in steps:
        assert step.residual.any() == step.planned.gate
        moved = not np.array_equal(step.requested.pose.position, step.planned.target.pose.position)
        assert moved == step.planned.gate


@pytest.mark.parametrize("mode", ["skip", "mask"])
def test_an_ik_phase_without_a_gate_gets_no_residual(mode: str) -> None:
    """The residual of the gated phase before must not live on in it."""
    phases = tuple(replace(phase, gate=phase.name in ("track", "close")) for phase in TASK.phases)
    env = Traced(ResidualEnv(replace(TASK, phases=phases), gate_mode=mode))
    gated_decisions(env, condition(0, 5))
    assert {step.planned.phase for step in env.trace.steps} >= {1, 2}
    for step in env.trace.steps:
        assert step.residual.any() == step.planned.gate
    env.close()


def test_a_residual_is_repeated_for_its_control_steps_and_cut_where_the_gate_changes(mask: Traced) -> None:
    lengths: list[tuple[bool, bool, int]] = []
    mask.reset(options={"condition": lifted()})
    done, k = False, 0
    while not done:
        gate, before = mask.unwrapped.executor.action.gate, len(mask.trace.steps)
        _, _, done, _, _ = mask.step(action(k))
        k += gate
        changed = not done and mask.unwrapped.executor.action.gate != gate
        lengths.append((done, changed, len(mask.trace.steps) - before))
    assert all(n == TASK.residual.decision_steps for done, changed, n in lengths if not (done or changed))
    assert all(1 <= n <= TASK.residual.decision_steps for *_, n in lengths)
    assert sum(changed for _, changed, _ in lengths) == 2


def test_the_residual_is_scaled_and_turned_into_the_frame_of_the_object(skip: Traced) -> None:
    """Eq. 5 by hand: one unit along the first dimension is one scale along the object's heading."""
    skip.reset(options={"condition": condition(4)})
    heading = skip.unwrapped.executor.frame.rotation[:, 0]
    skip.step(np.array((1, 0, 0, 0, 0), np.float32))
    first = skip.trace.steps[-TASK.residual.decision_steps]
    np.testing.assert_allclose(first.residual[:3], TASK.residual.translation[0] * heading, atol=1e-12)
    offset = first.requested.pose.position - first.planned.target.pose.position
    np.testing.assert_allclose(offset, first.residual[:3], atol=1e-12)


def test_a_kept_residual_turns_with_its_frame_at_every_control_step() -> None:
    """The clock turns by up to 10 degrees a control step; the action is the same, and so its residual turns alike."""
    env = Traced(ResidualEnv("alarmclock"))
    clock = env.unwrapped.task
    which = clock.conditions.draw(np.random.default_rng(0), 7, 8)  # of the fastest
    env.reset(options={"condition": which})
    env.step(np.array((1, 0, 0), np.float32))
    steps = env.trace.steps[-clock.residual.decision_steps :]
    headings = [each.before.objects["alarmclock"].velocity[:2] for each in steps]
    for step, heading in zip(steps, headings, strict=True):
        ahead = clock.residual.translation[0] * heading / np.linalg.norm(heading)
        np.testing.assert_allclose(step.residual[:2], ahead, atol=1e-9)
    assert np.linalg.norm(steps[-1].residual - steps[0].residual) > 1e-3
    env.close()


def test_the_width_residual_changes_the_width_alone(skip: Traced) -> None:
    skip.reset(options={"condition": condition(4)})
    skip.step(np.array((0, 0, 0, 0, -1), np.float32))
    step = skip.trace.steps[-1]
    np.testing.assert_array_equal(step.requested.pose.position, step.planned.target.pose.position)
    np.testing.assert_array_equal(step.requested.pose.rotation, step.planned.target.pose.rotation)
    assert step.requested.width == pytest.approx(step.planned.target.width - TASK.residual.width)


def test_the_world_frame_is_a_named_choice_and_part_of_the_task() -> None:
    env = Traced(ResidualEnv("can", residual_frame="world"))
    assert task_digest(env.unwrapped.task) == task_digest(replace(TASK, residual=replace(TASK.residual, frame="world")))
    env.reset(options={"condition": condition(4)})
    env.step(np.array((1, 0, 0, 0, 0), np.float32))
    np.testing.assert_allclose(env.trace.steps[-1].residual[:3], (TASK.residual.translation[0], 0, 0))
    env.close()


def test_actions_beyond_the_box_are_clipped(skip: Traced) -> None:
    digests = []
    for size in (1.0, 7.0):
        skip.reset(options={"condition": condition(6)})
        done, info = False, {}
        while not done:
            _, _, done, _, info = skip.step(np.full(5, size, np.float32))
        digests.append(info["trajectory"])
    assert digests[0] == digests[1]


def test_a_prediction_changes_the_prior_only_where_it_is_asked_for(skip: Traced) -> None:
    led = Traced(ResidualEnv("can", lead_time=0.1))
    assert run(led, condition(4), scale=0.0)[0] != run(skip, condition(4), scale=0.0)[0]
    assert task_digest(led.unwrapped.task) != task_digest(skip.unwrapped.task)
    led.close()


def with_first_phase(**changes: Any) -> Task:
    first: Phase = replace(TASK.phases[0], **changes)
    return replace(TASK, phases=(first, *TASK.phases[1:]))


class NowhereNear(Raised):
    """A target far outside the reach of the arm."""

    def __call__(self, view: Any) -> Pose:
        return Pose(view.entry.ee.rotation, np.array((3.0, 0.0, 0.5)))


@pytest.mark.parametrize("mode", ["skip", "mask"])
@pytest.mark.parametrize(
    ("task", "failure"),
    [
        (with_first_phase(timeout=0.2), "not reached"),
        (with_first_phase(target=NowhereNear("can", 0.0)), "plan failed: unreachable"),
    ],
    ids=["times out", "no plan"],
)
def test_an_episode_that_ends_before_its_gate_ends_with_its_first_steps(mode: str, task: Task, failure: str) -> None:
    env = ResidualEnv(task, gate_mode=mode)
    for _ in range(2):  # the second time, nothing of the first episode may show
        observation, info = env.reset(options={"condition": lifted()})
        assert observation in env.observation_space
        assert info == {"condition_id": lifted().id}
        done, steps = False, 0
        while not done:
            observation, reward, done, truncated, info = env.step(np.ones(5, np.float32))
            steps += 1
            assert info["residual_mask"] == 0.0
            assert observation in env.observation_space
        assert steps == 1 or mode == "mask"
        assert (reward, truncated) == (0.0, False)
        assert (info["is_success"], info["checkpoint"], info["failure"]) == (False, 0, failure)
    env.close()


def test_a_failed_plan_leaves_no_observation_of_the_episode_before() -> None:
    used, new = (ResidualEnv(with_first_phase(target=NowhereNear("can", 0.0))) for _ in range(2))
    used.reset(options={"condition": condition(7)})
    first, _ = used.reset(options={"condition": lifted()})
    np.testing.assert_array_equal(first, new.reset(options={"condition": lifted()})[0])
    used.close()
    new.close()


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"task": "cann"}, r"No task 'cann'\. Did you mean 'can'\?"),
        ({"gate_mode": "skp"}, "gate_mode is 'skp'; it must be one of 'skip', 'mask'"),
        ({"render_mode": "rgb"}, "render_mode is 'rgb'; it must be one of None, 'rgb_array', 'human'"),
        ({"residual_frame": "hand"}, "residual_frame is 'hand'; it must be one of None, 'target', 'world'"),
    ],
)
def test_a_wrong_choice_is_named_at_the_door(kwargs: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ResidualEnv(**kwargs)


def test_a_phase_may_take_a_share_of_the_residual() -> None:
    phases = tuple(replace(phase, residual_share=0.25) for phase in TASK.phases)
    env = Traced(ResidualEnv(replace(TASK, phases=phases)))
    env.reset(options={"condition": condition(4)})
    heading = env.unwrapped.executor.frame.rotation[:, 0]
    env.step(np.array((1, 0, 0, 0, 0), np.float32))
    first = env.trace.steps[-TASK.residual.decision_steps]
    np.testing.assert_allclose(first.residual[:3], 0.25 * TASK.residual.translation[0] * heading, atol=1e-12)
    env.close()


def test_a_longer_history_shows_more_of_the_past() -> None:
    longer = replace(TASK, residual=replace(TASK.residual, history=6))
    condition = TASK.conditions.stream("val", 0).__next__()
    envs = [ResidualEnv(task, share_prefix=False) for task in (TASK, longer)]
    seen = [env.reset(options={"condition": condition})[0] for env in envs]
    n_step = 9  # numbers of each past step
    assert seen[1].size == seen[0].size + 2 * n_step == residual_sizes(longer)[0]
    action = np.full(envs[0].action_space.shape, 0.3, np.float32)
    for _ in range(3):
        past = seen
        seen = [env.step(action)[0] for env in envs]
        np.testing.assert_array_equal(seen[1][: 4 * n_step], seen[0][: 4 * n_step])
        np.testing.assert_array_equal(seen[1][6 * n_step :], seen[0][4 * n_step :])
    assert not np.array_equal(seen[1][4 * n_step : 6 * n_step], past[1][4 * n_step : 6 * n_step])
