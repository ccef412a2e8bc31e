"""The phase program, driven with states and plans written by hand."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from trajectory_hash import TrajectoryHash, condition

from dynaforge.envs.executor import PhaseExecutor
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import JointState, JointTrajectory, Pose
from dynaforge.planning import JointReference, PlanFailure
from dynaforge.sim import BodyState, SceneState
from dynaforge.sim.contacts import Contacts, Press
from dynaforge.tasks import Mode, Outcome, Phase, Task, get_task
from dynaforge.tasks.predicates import Fallen, Grasped, Lifted, Not, Reached, Touched
from dynaforge.tasks.targets import DOWN_ALONG_X, Above
from dynaforge.tasks.view import PhaseView

CAN = get_task("can")
DT = CAN.scene.control_dt
CONDITION = condition(3)
REFERENCE = JointReference(JointState(np.zeros(7), np.full(7, 0.1), np.full(7, 0.2)), 0.08, 0.0)


def scene(x: float = 0.5, z: float = 0.033, *, touching: tuple[bool, bool] = (False, False), vx: float = 0.0):
    body = BodyState(Pose(np.eye(3), np.array((x, 0.0, z))), np.array((vx, 0.0, 0.0)), np.zeros(3))
    hand = Pose(DOWN_ALONG_X, np.array((0.5, 0.0, 0.2)))
    return SceneState(
        time=0.0,
        q=np.zeros(7),
        dq=np.zeros(7),
        ee=hand,
        width=0.08,
        objects={"can": body},
        touching={"can": touching},
        on_table={"can": True},
        contacts=Contacts(fingers={"can": tuple(Press(20.0, 20.0) if finger else Press() for finger in touching)}),
    )


GRASPED = scene(touching=(True, True))
UP = scene(z=0.133, touching=(True, True))


@dataclass
class FakePlanner:
    """Counts its calls and answers with a motion of three samples, or fails."""

    fails: bool = False
    calls: list[tuple[JointState, Pose, float]] = field(default_factory=list)

    def plan(self, start: JointState, target: Pose, *, rng: np.random.Generator) -> JointTrajectory:
        self.calls.append((start, target, float(rng.random())))
        if self.fails:
            raise PlanFailure("unreachable", "nowhere near")
        rows = np.arange(3.0)[:, None] * np.ones(7)
        return JointTrajectory(DT, rows, rows + 10, rows + 20)


def phase(name: str, done, mode: Mode = Mode.IK, *, hold: float = 0.0, timeout: float = 1.0, **more) -> Phase:
    return Phase(
        name,
        mode,
        Above("can", 0.0),
        width=0.08,
        done=done,
        timeout=timeout,
        failure=f"{name} took too long",
        hold=hold,
        **more,
    )


def program(*phases: Phase) -> Task:
    """These phases as a task, which needs an open gate: where the hand tracks, else in a phase after them."""
    if not any(p.mode is Mode.IK for p in phases):
        phases = (*phases, phase("after", Fallen("can")))
    if not any(p.gate for p in phases):
        phases = tuple(replace(p, gate=p.mode is Mode.IK) for p in phases)
    return replace(CAN, phases=phases, impossible=(("dropped", Fallen("can")),))


def start(task: Task, planner: FakePlanner | None = None) -> PhaseExecutor:
    executor = PhaseExecutor(task, planner or FakePlanner(), control_dt=DT)  # type: ignore[arg-type]
    executor.reset(scene(), CONDITION, REFERENCE)
    return executor


TOUCH_GRASP_LIFT = program(
    phase("touch", Touched("can")), phase("grasp", Grasped("can")), phase("lift", Lifted("can", 0.1), hold=0.25)
)


def failed(checkpoint: int, failure: str, phase: str) -> Outcome:
    return Outcome(success=False, checkpoint=checkpoint, failure=failure, phase=phase)


def test_phases_advance_in_order_one_a_control_step_at_most() -> None:
    executor = start(TOUCH_GRASP_LIFT)
    names = [executor.phase.name]
    for _ in range(2):
        executor.advance(UP, REFERENCE)  # the predicates of all phases hold
        names.append(executor.phase.name)
    assert names == ["touch", "grasp", "lift"]
    assert executor.outcome is None


def test_a_later_phase_does_not_count_before_its_turn() -> None:
    executor = start(TOUCH_GRASP_LIFT)
    for _ in range(10):
        executor.advance(scene(z=0.5), REFERENCE)  # lifted, never touched
    assert executor.phase.name == "touch"


def test_success_is_the_last_checkpoint_and_is_worth_one() -> None:
    executor = start(TOUCH_GRASP_LIFT)
    for _ in range(2 + 9):
        if executor.outcome is None:
            executor.advance(UP, REFERENCE)
    assert executor.outcome == Outcome(success=True, checkpoint=3, phase="lift")
    assert executor.outcome.episodic_return() == 1.0


def test_success_held_for_less_than_a_quarter_of_a_second_is_none() -> None:
    executor = start(TOUCH_GRASP_LIFT)
    for state in [UP, UP, *[UP] * 7, scene(), *[UP] * 7]:  # 7 samples span a fifth of a second
        executor.advance(state, REFERENCE)
    assert executor.outcome is None


@pytest.mark.parametrize(
    "near_miss", [scene(z=0.123, touching=(True, True)), scene(z=0.5), scene(z=0.133, touching=(True, False))]
)
def test_a_near_miss_of_the_can_never_becomes_a_success(near_miss: SceneState) -> None:
    executor = PhaseExecutor(CAN, FakePlanner(), control_dt=DT)  # type: ignore[arg-type]
    executor.reset(scene(), CONDITION, REFERENCE)
    executor._true.push(scene(touching=(True, True)))
    executor._enter(4, REFERENCE)
    while executor.outcome is None:
        executor.advance(near_miss, REFERENCE)
    assert executor.outcome == failed(4, "slipped", "lift")


def test_a_hold_starts_anew_when_it_breaks() -> None:
    executor = start(program(phase("grasp", Grasped("can"), hold=0.1), phase("lift", Lifted("can", 0.1))))
    for state in (*[GRASPED] * 3, scene(), *[GRASPED] * 3):  # 0.1 s are four samples
        executor.advance(state, REFERENCE)
    assert executor.phase.name == "grasp"
    executor.advance(GRASPED, REFERENCE)
    assert executor.phase.name == "lift"


def test_a_timeout_fails_with_the_reason_of_its_phase() -> None:
    """0.2 s are six control steps."""
    executor = start(program(phase("touch", Touched("can")), phase("grasp", Grasped("can"), timeout=0.2)))
    executor.advance(scene(touching=(True, False)), REFERENCE)
    for _ in range(5):
        executor.advance(scene(), REFERENCE)
    assert executor.outcome is None
    assert executor.phase_time_left == pytest.approx(1 / 6)
    executor.advance(scene(), REFERENCE)
    assert executor.outcome == failed(1, "grasp took too long", "grasp")


def test_what_makes_success_impossible_ends_the_episode_at_once() -> None:
    executor = start(TOUCH_GRASP_LIFT)
    executor.advance(GRASPED, REFERENCE)
    executor.advance(scene(z=-0.2, touching=(True, True)), REFERENCE)
    assert executor.outcome == failed(1, "dropped", "grasp")


def test_a_robot_that_stopped_itself_ends_the_episode_even_in_success() -> None:
    executor = start(program(phase("touch", Touched("can"))))
    executor.advance(replace(UP, stopped=True), REFERENCE)
    assert executor.outcome == failed(0, "robot stopped: speed", "touch")


def test_a_failed_plan_is_an_outcome_with_its_reason() -> None:
    executor = start(program(phase("touch", Touched("can"), Mode.GLOBAL)), FakePlanner(fails=True))
    assert executor.outcome == failed(0, "plan failed: unreachable", "touch")
    later = program(phase("touch", Touched("can")), phase("lift", Lifted("can", 0.1), Mode.GLOBAL))
    executor = start(later, FakePlanner(fails=True))
    executor.advance(GRASPED, REFERENCE)
    assert executor.outcome == failed(1, "plan failed: unreachable", "lift")
    assert executor.action.phase == 1


def test_a_global_phase_plans_once_from_where_the_command_stands() -> None:
    planner = FakePlanner()
    executor = start(program(phase("touch", Touched("can"), Mode.GLOBAL)), planner)
    for x in (0.51, 0.52, 0.53, 0.54):
        executor.advance(scene(x), REFERENCE)
    ((start_of_plan, target, _),) = planner.calls
    assert start_of_plan is REFERENCE.joints
    assert target.position[0] == 0.5  # the object's place at entry
    assert executor.action.target.pose is target


def test_a_global_phase_follows_the_samples_in_turn_and_stays_at_the_last() -> None:
    executor = start(program(phase("touch", Touched("can"), Mode.GLOBAL)))
    samples = []
    for _ in range(4):
        assert executor.action.sample is not None
        samples.append((executor.action.sample.q[0], executor.action.sample.dq[0], executor.action.sample.ddq[0]))
        executor.advance(scene(), REFERENCE)
    assert samples == [(1, 11, 21), (2, 12, 22), (2, 12, 22), (2, 12, 22)]


def test_the_plan_draws_from_the_seed_of_the_condition_and_the_phase() -> None:
    def draw(seed: int) -> list[float]:
        planner = FakePlanner()
        task = program(phase("touch", Touched("can"), Mode.GLOBAL), phase("lift", Lifted("can", 0.1), Mode.GLOBAL))
        executor = PhaseExecutor(task, planner, control_dt=DT)  # type: ignore[arg-type]
        executor.reset(scene(), replace(CONDITION, seed=seed), REFERENCE)
        executor.advance(GRASPED, REFERENCE)
        return [call[-1] for call in planner.calls]

    assert draw(1) == draw(1)
    assert len({*draw(1), *draw(2)}) == 4


def test_an_ik_phase_never_plans_globally_and_follows_the_object() -> None:
    planner = FakePlanner()
    executor = start(program(phase("touch", Touched("can"))), planner)
    for x in (0.51, 0.52):
        executor.advance(scene(x), REFERENCE)
        assert executor.action.target.pose.position[0] == x
        assert executor.action.sample is None
    assert planner.calls == []


def test_the_target_freezes_when_a_finger_touches() -> None:
    task = program(phase("grasp", Grasped("can"), track_until=Touched("can")), phase("lift", Lifted("can", 0.1)))
    executor = start(task)
    executor.advance(scene(0.51), REFERENCE)
    assert not executor.frozen
    executor.advance(scene(0.52, touching=(False, True)), REFERENCE)
    assert executor.frozen
    for x in (0.53, 0.54):
        executor.advance(scene(x), REFERENCE)  # pushed away, no longer touched: still no chase
        assert executor.action.target.pose.position[0] == 0.52
    executor.advance(scene(0.55, touching=(True, True)), REFERENCE)
    assert executor.phase.name == "lift"
    assert not executor.frozen
    assert executor.action.target.pose.position[0] == 0.55


def test_without_track_until_the_target_never_freezes() -> None:
    executor = start(program(phase("grasp", Grasped("can"))))
    executor.advance(scene(0.52, touching=(False, True)), REFERENCE)
    executor.advance(scene(0.53), REFERENCE)
    assert executor.action.target.pose.position[0] == 0.53


def test_lead_time_shifts_the_target_by_velocity_times_lead() -> None:
    executor = start(replace(program(phase("touch", Touched("can"))), lead_time=0.1))
    executor.advance(scene(0.5, vx=0.7), REFERENCE)
    assert executor.action.target.pose.position[0] == pytest.approx(0.57)


def test_the_gate_and_the_width_are_those_of_the_running_phase() -> None:
    task = program(phase("touch", Touched("can"), gate=True), replace(phase("lift", Lifted("can", 0.1)), width=0.0))
    executor = start(task)
    assert (executor.action.gate, executor.action.target.width, executor.action.phase) == (True, 0.08, 0)
    executor.advance(GRASPED, REFERENCE)
    assert (executor.action.gate, executor.action.target.width, executor.action.phase) == (False, 0.0, 1)


def test_a_reset_forgets_the_episode_before() -> None:
    executor = start(TOUCH_GRASP_LIFT)
    executor.advance(GRASPED, REFERENCE)
    executor.advance(scene(z=-0.2), REFERENCE)
    executor.reset(scene(), CONDITION, REFERENCE)
    assert executor.outcome is None
    assert executor.phase.name == "touch"
    assert executor.phase_time_left == 1.0


def test_a_real_success_holds_its_predicate_at_the_end() -> None:
    env = ResidualEnv("can")
    trace = TrajectoryHash(env.world)
    env.reset(options={"condition": condition(0, 7)})
    done, info = False, {}
    while not done:
        _, _, done, _, info = env.step(np.zeros(5, np.float32))
    assert info["is_success"]
    start_height = trace.steps[0].before.objects["can"].pose.position[2]
    for step in trace.steps[-7:]:
        assert all(step.after.touching["can"])
        assert step.after.objects["can"].pose.position[2] - start_height >= 0.10
    phases = [step.planned.phase for step in trace.steps]
    assert phases == sorted(phases)
    env.close()


def test_a_reason_of_a_phase_counts_only_while_it_runs() -> None:
    lost = (("slipped", Fallen("can", depth=-0.05)),)  # below 5 cm above the table
    task = program(phase("touch", Touched("can")), phase("carry", Lifted("can", 0.3), fails=lost))
    executor = start(task)
    executor.advance(scene(), REFERENCE)
    assert executor.outcome is None
    executor.advance(scene(z=0.2, touching=(True, False)), REFERENCE)
    executor.advance(scene(z=0.06), REFERENCE)
    assert executor.outcome is None
    executor.advance(scene(z=0.04), REFERENCE)
    assert executor.outcome == failed(1, "slipped", "carry")


def test_the_object_in_the_hand_is_measured_where_a_phase_takes_hold() -> None:
    task = program(
        phase("grasp", Grasped("can"), takes_hold=True), phase("lift", Lifted("can", 0.1)), phase("keep", Fallen("can"))
    )
    executor = start(task)
    assert executor._seen.view().grasp is None
    executor.advance(GRASPED, REFERENCE)
    executor.advance(UP, REFERENCE)
    assert executor.phase.name == "keep"
    assert executor._seen.view().grasp is GRASPED
    executor.reset(scene(), CONDITION, REFERENCE)
    assert executor._seen.view().grasp is None, "an episode does not inherit the grasp of the one before"


def on_target(executor: PhaseExecutor, state: SceneState) -> SceneState:
    """Return a scene in which the hand is where it was told to go."""
    return replace(state, ee=executor.action.target.pose)


def heights(executor: PhaseExecutor, *, x: float = 0.5, steps: int) -> list[float]:
    found = []
    for _ in range(steps):
        found.append(float(executor.action.target.pose.position[2]))
        executor.advance(on_target(executor, scene(x)), REFERENCE)
    return found


def descent(**more) -> Task:
    """From 10 cm above the can onto it at 0.6 m/s, 2 cm a control step."""
    above = replace(phase("touch", Touched("can")), target=Above("can", 0.1))
    return program(above, phase("descend", Reached(0.005), timeout=2.0, ramp=0.6, **more))


def test_a_ramp_takes_the_target_steadily_from_the_phase_before_to_its_own() -> None:
    executor = start(descent())
    executor.advance(on_target(executor, scene(touching=(True, False))), REFERENCE)
    assert executor.phase.name == "descend"
    np.testing.assert_allclose(heights(executor, steps=7), 0.033 + np.array((8, 6, 4, 2, 0, 0, 0)) / 100)


def test_a_target_that_goes_down_waits_for_a_hand_that_trails() -> None:
    """The hand stays at 20 cm, so the target stays two control steps of its ramp below, instead of at 3.3 cm."""
    executor = start(descent())
    executor.advance(scene(touching=(True, False)), REFERENCE)
    for _ in range(20):
        executor.advance(scene(), REFERENCE)
    np.testing.assert_allclose(executor.action.target.pose.position, (0.5, 0.0, 0.2 - 0.6 * 2 / 30))


def test_a_ramp_turns_with_the_heading_of_its_object_and_follows_it() -> None:
    behind = replace(phase("touch", Touched("can")), target=Shifted("can", -0.1))
    executor = start(program(behind, phase("follow", Reached(0.005), ramp=0.6)))
    executor.advance(on_target(executor, scene(touching=(True, False))), REFERENCE)
    turned = on_target(executor, scene(0.6))
    turned.objects["can"].velocity[:2] = (0.0, 0.5)  # it moved 10 cm and now goes to the left
    executor.advance(turned, REFERENCE)
    np.testing.assert_allclose(executor.action.target.pose.position, (0.6, -0.06, 0.033), atol=1e-12)


def test_done_refers_to_where_the_ramp_ends() -> None:
    executor = start(descent())
    executor.advance(scene(touching=(True, False)), REFERENCE)
    there = replace(scene(), ee=executor.action.target.pose)  # on the ramp, 8 cm above its end
    executor.advance(there, REFERENCE)
    assert executor.outcome is None


@dataclass(frozen=True)
class Shifted:
    """A target behind an object on its x axis."""

    object: str
    by: float

    def __call__(self, view: PhaseView) -> Pose:
        frame = view.frames[self.object]
        return Pose(DOWN_ALONG_X, frame.apply(np.array((self.by, 0.0, 0.0))))


LOW = Not(Lifted("can", 0.05))
TRY_AGAIN = program(
    phase("track", Lifted("can", 0.05), timeout=0.5), phase("press", Touched("can"), timeout=0.3, retry=("track", LOW))
)


def test_a_retry_goes_back_and_keeps_the_checkpoint_and_the_time_that_was_spent() -> None:
    executor = start(TRY_AGAIN)
    executor.advance(scene(z=0.1), REFERENCE)
    assert (executor.phase.name, executor.phase_time_left) == ("press", 1.0)
    executor.advance(scene(), REFERENCE)
    assert executor.phase.name == "track"
    assert executor.phase_time_left == pytest.approx(1 - 1 / 15)
    for _ in range(14):
        executor.advance(scene(), REFERENCE)
    assert executor.outcome == failed(1, "track took too long", "track")


def test_retries_end_with_the_time_of_their_phases_and_earn_no_checkpoint_twice() -> None:
    executor, states, visits = start(TRY_AGAIN), [scene(z=0.1), scene()], 0
    while executor.outcome is None:
        executor.advance(states[visits % 2], REFERENCE)
        visits += 1
    assert executor.outcome == failed(1, "press took too long", "press")
    assert visits == 18, "nine of 0.3 s in press, one in track before each"


def test_a_retry_that_succeeds_is_a_success() -> None:
    executor = start(TRY_AGAIN)
    for state in (scene(z=0.1), scene(), scene(z=0.1), scene(z=0.1, touching=(True, False))):
        executor.advance(state, REFERENCE)
    assert executor.outcome == Outcome(success=True, checkpoint=2, phase="press")
