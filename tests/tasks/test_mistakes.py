"""A mistake in a task is named where it is written."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.geometry import Pose
from dynaforge.sim import BodySpec, Drive, FixtureSpec, Launch, Placement, Spring
from dynaforge.tasks import ConditionSpace, Mode, Task, get_task
from dynaforge.tasks.predicates import Aligned, All, Clicked, Fallen, Grasped, Near, Not, OnTable, Reached, Within
from dynaforge.tasks.targets import Above, Over, Raised

CAN, PEACH, CLOCK, CAR = (get_task(name) for name in ("can", "peach", "alarmclock", "toycar"))
NAN = math.nan
STILL = np.zeros(3)


def can(**changes: Any) -> Task:
    return replace(CAN, **changes)


def track(**changes: Any) -> Task:
    """Can with another second phase, one that tracks."""
    first, second, *rest = CAN.phases
    return can(phases=(first, replace(second, **changes), *rest))


def reach(**changes: Any) -> Task:
    """Can with another first phase, a global one."""
    first, *rest = CAN.phases
    return can(phases=(replace(first, **changes), *rest))


def scene(**changes: Any) -> Task:
    return can(scene=replace(CAN.scene, **changes))


def ranges(**changes: Any) -> ConditionSpace:
    return replace(CAN.conditions, ranges={**CAN.conditions.ranges, **changes})


def residual(**changes: Any) -> Task:
    return can(residual=replace(CAN.residual, **changes))


def launching(start: Callable[[Any], Any], task: Task = CAN) -> Task:
    return replace(task, scene=replace(task.scene, launch=start))


def bowl(**changes: Any) -> FixtureSpec:
    return replace(PEACH.scene.fixtures[0], **changes)


@dataclass(frozen=True)
class Faster:
    """A user-defined predicate."""

    thing: str
    speed: float

    def __call__(self, view: Any, target: Pose) -> bool:
        return bool(np.linalg.norm(view.state.objects[self.thing].velocity) > self.speed)


@dataclass(frozen=True)
class AnyOf:
    """A user-defined composition."""

    words: tuple[Any, ...]

    def __call__(self, view: Any, target: Pose) -> bool:
        return any(word(view, target) for word in self.words)


class Either:
    """A user-defined composition that is not a dataclass."""

    def __init__(self, one: Any, other: Any) -> None:
        self.one, self.other, self.itself = one, other, self

    def __call__(self, view: Any, target: Pose) -> bool:
        return self.one(view, target) or self.other(view, target)


def far(view: Any, target: Pose) -> bool:
    return view.state.objects["cann"].pose.position[0] > 1.0


def wrong_launch(condition: Any) -> Any:
    return {"can": Launch(Pose.identity(), STILL, STILL, condition.values["mas"])}


def peach_without_bowl(condition: Any) -> Any:
    return {"peach": PEACH.scene.launch(condition)["peach"]}


def started(**changes: Any) -> Launch:
    return replace(Launch(Pose.identity(), STILL, STILL, 0.1), **changes)


SEEN = "the scene has 'can'. Did you mean 'can'?"

MISTAKES: dict[str, tuple[Callable[[], Any], tuple[str, ...]]] = {
    # names of objects
    "target": (lambda: track(target=Above("cann", 0.1)), (f"Phase 'track' aims at 'cann'; {SEEN}",)),
    "raised": (lambda: track(target=Raised("cann", 0.1)), ("Phase 'track' aims at 'cann'",)),
    "held": (lambda: track(target=Over("can", "cnn", 0.1)), ("'track'", "in target", "'cnn'", SEEN)),
    "done": (lambda: track(done=Grasped("cann")), ("Phase 'track' names 'cann' in done", SEEN)),
    "nested": (lambda: track(done=All((Reached(0.1), Not(All((Near("cann", 0.1),)))))), ("'track'", "Near", SEEN)),
    "other": (lambda: track(done=Within("can", "pad", 0.1, 0.1)), ("'track'", "names 'pad'", "'can'")),
    "track_until": (lambda: track(track_until=Grasped("cann")), ("in track_until", SEEN)),
    "retry": (lambda: track(retry=("pregrasp", Grasped("cann"))), ("Phase 'track'", "in retry", SEEN)),
    "retry of a later phase": (
        lambda: track(retry=("descend", Grasped("can"))),
        ("Phase 'track': retry goes back to 'descend', which is no phase before it; those are 'pregrasp'.",),
    ),
    "retry of no pair": (lambda: track(retry="pregrasp"), ("Phase 'track': retry is 'pregrasp'; it must be a pair",)),
    "ramp": (lambda: track(ramp=-0.1), ("Phase 'track': ramp is -0.1; it must be",)),
    "lowest": (lambda: track(lowest=NAN), ("Phase 'track': lowest is nan; it must be",)),
    "ramp of a plan": (lambda: reach(ramp=0.1), ("ramp has no effect in Mode.GLOBAL",)),
    "fails": (lambda: track(fails=(("dropped", Fallen("cann")),)), ("Phase 'track'", "in fails", SEEN)),
    "impossible": (lambda: can(impossible=(("dropped", Fallen("cann")),)), ("Task", "in impossible", SEEN)),
    "own word": (lambda: track(done=Faster("cann", 1.0)), ("'track'", "in done, Faster", SEEN)),
    "own composition": (lambda: track(done=AnyOf((Reached(0.1), Near("cann", 0.1)))), ("'track'", "Near", SEEN)),
    "own class": (lambda: track(done=Either(Not(Grasped("can")), Near("cann", 0.1))), ("'track'", "Near", SEEN)),
    "function": (lambda: track(done=far), ("'track'", "'cann' in done, <function far>; the", SEEN)),
    "not on a table": (
        lambda: replace(PEACH, impossible=(("dropped", OnTable("bowl")),)),
        ("impossible (dropped)", "OnTable(object='bowl')", "'bowl'", "free bodies ('peach')"),
    ),
    "no spring": (lambda: track(done=Clicked("can", 0.01, 0.01)), ("'track'", "Clicked", "with a spring (none)")),
    # launch
    "forgets": (lambda: launching(lambda condition: {}), ("launch", "forgets 'can'")),
    "forgets a fixture": (lambda: launching(peach_without_bowl, PEACH), ("peach_without_bowl", "forgets 'bowl'")),
    "unknown": (lambda: launching(lambda condition: {"cann": started()}), ("launch", "starts 'cann'", SEEN)),
    "field": (lambda: launching(wrong_launch), ("wrong_launch", "KeyError", "Did you mean 'mass'?")),
    "returns a list": (
        lambda: launching(lambda condition: [started()]),
        ("What launch (", "returns is [", "a mapping"),
    ),
    "placed": (lambda: launching(lambda condition: {"can": Placement(Pose.identity())}), ("body 'can'", "Launch")),
    "launched": (
        lambda: launching(lambda condition: {**PEACH.scene.launch(condition), "bowl": started()}, PEACH),
        ("fixture 'bowl'", "Placement"),
    ),
    "drive": (
        lambda: launching(lambda condition: {"alarmclock": Placement(Pose.identity(), {"press": Drive()})}, CLOCK),
        ("Fixture 'alarmclock' drives ('turn', 'offset'), not ['press']",),
    ),
    "variant": (
        lambda: launching(lambda condition: {"alarmclock": Placement(Pose.identity(), variant=1)}, CLOCK),
        ("Fixture 'alarmclock' has no variant 1; it has 1",),
    ),
    "wheel": (
        lambda: launching(lambda condition: {CAR.manipulated: started(joint_speeds={"whel": 1.0})}, CAR),
        ("has no joints ['whel']", ".urdf has ["),
    ),
    "mass": (lambda: started(mass=-0.1), ("Launch: mass is -0.1", "above 0")),
    "velocity": (lambda: started(velocity=np.array((0.0, NAN, 0.0))), ("Launch: velocity", "nan")),
    "pose": (lambda: started(pose=Pose(np.zeros((3, 3)), STILL)), ("Launch: pose.rotation", "not a rotation matrix")),
    "pose place": (lambda: Placement(Pose(np.eye(3), np.zeros(2))), ("Placement: pose.position", "(3,)")),
    "swing": (lambda: Drive(rate=NAN), ("Drive: rate is nan",)),
    "drives": (lambda: Placement(Pose.identity(), {"turn": 3.0}), ("Placement: drives['turn'] is 3.0", "Drive")),
    # phases
    "global gate": (lambda: reach(gate=True), ("Phase 'pregrasp': gate has no effect in Mode.GLOBAL", "Mode.IK")),
    "global track": (lambda: reach(track_until=Grasped("can")), ("'pregrasp': track_until has no effect",)),
    "twice": (lambda: can(phases=(*CAN.phases, CAN.phases[1])), ("two phases are called 'track'",)),
    "none": (lambda: can(phases=()), ("Task 'can' has no phase",)),
    "lone phase": (lambda: can(phases=CAN.phases[1]), ("phases is Phase(", "its comma")),
    "no gate": (lambda: can(phases=(CAN.phases[0], CAN.phases[-1])), ("no phase has gate=True",)),
    "hold": (lambda: track(hold=2.5), ("Phase 'track': hold 2.5 s is not below its timeout 2.5 s",)),
    "hold a step": (lambda: track(hold=2.49), ("Phase 'track': hold 2.49 s leaves no control step of 0.03333 s",)),
    "negative hold": (lambda: track(hold=-0.1), ("Phase 'track': hold is -0.1", "at least 0")),
    "timeout": (lambda: track(timeout=0.0), ("Phase 'track': timeout is 0.0", "above 0")),
    "timeout nan": (lambda: track(timeout=NAN), ("Phase 'track': timeout is nan",)),
    "endless": (lambda: track(timeout=math.inf), ("Phase 'track': timeout is inf",)),
    "timeout text": (lambda: track(timeout="2"), ("Phase 'track': timeout is '2'",)),
    "width": (lambda: track(width=0.085), ("Phase 'track': width is 0.085", "at most 0.08")),
    "share": (lambda: track(residual_share=0.0), ("Phase 'track': residual_share is 0.0", "above 0")),
    "mode": (lambda: track(mode="gobal"), ("Phase 'track': mode is 'gobal'", "Did you mean 'global'?")),
    "phase name": (lambda: track(name=""), ("Phase: name is ''",)),
    "failure": (lambda: track(failure=""), ("Phase 'track': failure is ''",)),
    "gate text": (lambda: track(gate="no"), ("Phase 'track': gate is 'no'", "True or False")),
    "class": (lambda: track(done=Grasped), ("'track': done is the class Grasped", "an instance")),
    "no predicate": (lambda: track(done=None), ("Phase 'track': done is None",)),
    "swapped": (lambda: track(target=Grasped("can")), ("Phase 'track': target, Grasped", "TypeError")),
    "swapped too": (lambda: track(done=Above("can", 0.1)), ("Phase 'track': done, Above", "TypeError")),
    "returns none": (lambda: track(done=lambda view, target: None), ("'track': done", "returns None, neither True")),
    "no object": (lambda: track(target=lambda view: view.state.ee), ("Phase 'track': target", "no `object`")),
    "lone ending": (lambda: track(fails=("dropped", Fallen("can"))), ("Phase 'track': fails", "tuple of pairs")),
    "lone part": (lambda: All(Grasped("can")), ("All: parts is Grasped", "All((Reached(0.03),))")),
    "size": (lambda: track(done=Reached(-0.03)), ("Phase 'track': done, Reached: distance is -0.03", "at least 0")),
    "nan in a word": (lambda: track(done=Aligned("can", 0.01, height=NAN)), ("Aligned: height is nan",)),
    "size or none": (lambda: track(done=Aligned("can", 0.01, -0.1)), ("Aligned: across is -0.1", "at least 0")),
    "share beyond 1": (lambda: track(residual_share=3), ("Phase 'track': residual_share is 3", "at most 1")),
    "upper-case mode": (lambda: track(mode="IK"), ("Phase 'track': mode is 'IK'", "Did you mean 'ik'?")),
    "grip": (lambda: track(target=Above("can", 0.1, "along")), ("'track': target, Above: grip is 'along'", "Grip")),
    # residual
    "scales": (lambda: residual(translation=(0, 0, 0), rotation=(0, 0, 0), width=0), ("all seven scales are 0",)),
    "negative": (lambda: residual(translation=(0.1, -0.1, 0)), ("ResidualSpec: translation[1] is -0.1", "at least 0")),
    "nan scale": (lambda: residual(rotation=(0, NAN, 0)), ("ResidualSpec: rotation[1] is nan",)),
    "two scales": (lambda: residual(rotation=(0, 0.1)), ("ResidualSpec: rotation is (0, 0.1)", "3 numbers")),
    "wide": (lambda: residual(width=0.2), ("ResidualSpec: width is 0.2", "at most 0.08")),
    "frame": (lambda: residual(frame="targt"), ("frame is 'targt'", "'world'", "Did you mean 'target'?")),
    "steps": (lambda: residual(decision_steps=0), ("ResidualSpec: decision_steps is 0",)),
    "one step of history": (lambda: residual(history=1), ("ResidualSpec: history is 1",)),
    "half a step": (lambda: residual(decision_steps=1.5), ("decision_steps is 1.5", "whole")),
    # scene
    "control_dt": (lambda: scene(control_dt=1 / 31), ("control_dt 0.0322581 s is 7.74194 times physics_dt",)),
    "faster than physics": (lambda: scene(control_dt=1 / 960), ("control_dt", "whole multiple")),
    "rate": (lambda: scene(control_dt=30), ("SceneSpec: control_dt is 30", "at most 1")),
    "physics_dt": (lambda: scene(physics_dt=0.0), ("SceneSpec: physics_dt is 0.0",)),
    "iterations": (lambda: scene(solver_iterations=0), ("SceneSpec: solver_iterations is 0",)),
    "fingers": (lambda: scene(finger_friction=-1.0), ("SceneSpec: finger_friction is -1.0",)),
    "launch": (lambda: scene(launch=None), ("SceneSpec: launch is None",)),
    "lone body": (lambda: scene(bodies=CAN.scene.bodies[0]), ("SceneSpec: bodies is BodySpec(", "its comma")),
    "two bodies": (lambda: scene(bodies=CAN.scene.bodies * 2), ("several bodies or fixtures are called 'can'",)),
    "one name": (lambda: scene(fixtures=(bowl(name="can"),)), ("several bodies or fixtures are called 'can'",)),
    "nothing": (lambda: scene(bodies=()), ("nothing in the scene moves",)),
    "nothing moves": (lambda: scene(bodies=(), fixtures=(bowl(driven=()),)), ("nothing in the scene moves",)),
    "urdf": (lambda: BodySpec("can", "can/cann.urdf"), ("Body 'can'", "can/cann.urdf", "Did you mean 'can/can.urdf'?")),
    "own urdf": (lambda: BodySpec("can", "/nowhere/can.urdf"), ("Body 'can'", "/nowhere/can.urdf")),
    "friction": (
        lambda: BodySpec("can", "can/can.urdf", lateral_friction=-0.1),
        ("Body 'can': lateral_friction is -0.1",),
    ),
    "body name": (lambda: BodySpec("my can", "can/can.urdf"), ("BodySpec: name is 'my can'", "'my_can' would do")),
    "path": (lambda: BodySpec("../can", "can/can.urdf"), ("BodySpec: name is '../can'",)),
    "table": (lambda: BodySpec("table", "can/can.urdf"), ("BodySpec: name is 'table', which is taken",)),
    "link": (lambda: bowl(link="bowll"), ("Fixture 'bowl'", "has no link 'bowll'", "'bowl'")),
    "joint": (lambda: bowl(driven=("slyde",)), ("Fixture 'bowl'", "has no joint 'slyde'", "'slide'")),
    "lone joint": (lambda: bowl(driven="slide"), ("Fixture 'bowl': driven is 'slide'", "('slide',)")),
    "spring joint": (lambda: bowl(spring=Spring("press", 1.0)), ("Fixture 'bowl'", "no joint 'press'")),
    "driven spring": (lambda: bowl(spring=Spring("turn", 1.0)), ("Fixture 'bowl'", "named twice")),
    "spring": (lambda: Spring("press", 0.0), ("Spring: force is 0.0",)),
    "no variants": (lambda: bowl(urdf=()), ("Fixture 'bowl' has no URDF",)),
    # conditions
    "difficulty": (lambda: replace(CAN.conditions, difficulty="sped"), ("difficulty is 'sped'", "mean 'speed'?")),
    "empty": (lambda: ranges(mass=(0.2, 0.2)), ("(0.2, 0.2) of 'mass'", "is empty")),
    "reversed": (lambda: ranges(speed=(1.5, 0.05)), ("(1.5, 0.05) of 'speed'", "is reversed")),
    "nan range": (lambda: ranges(mass=(NAN, 0.2)), ("the range of 'mass'[0] is nan",)),
    "one end": (lambda: ranges(mass=0.2), ("the range of 'mass' is 0.2", "2 numbers")),
    "no ranges": (lambda: replace(CAN.conditions, ranges={}, units={}), ("ranges is empty",)),
    "space's name": (lambda: replace(CAN.conditions, task="a can"), ("ConditionSpace: task is 'a can'",)),
    # the task
    "env_name": (lambda: can(env_name="Drink can"), ("Task 'can': env_name is 'Drink can'", "env id")),
    "task name": (lambda: can(name="drink can"), ("Task: name is 'drink can'", "'drink_can' would do")),
    "upper case": (lambda: can(name="Can"), ("Task: name is 'Can'", "'can'")),
    "all": (lambda: can(name="all"), ("Task: name is 'all', which is taken",)),
    "another's conditions": (lambda: can(name="tin"), ("Task 'tin'", "conditions are those of task 'can'")),
    "goal": (lambda: can(goal=""), ("Task 'can': goal is ''",)),
    "lines": (lambda: can(instruction="pick\nup"), ("Task 'can': instruction is 'pick\\nup'", "one line")),
    "camera": (lambda: can(camera=((1.0, 0.0, 1.0), (1.0, 0.0, 1.0))), ("Task 'can'", "looks straight up or down")),
    "eye": (lambda: can(camera=((1.0, NAN, 1.0), (0.0, 0.0, 0.0))), ("camera, eye[1] is nan",)),
    "scene": (lambda: can(scene=None), ("Task 'can': scene is None", "SceneSpec")),
    "ending": (lambda: can(impossible=(Fallen("can"),)), ("Task 'can': impossible", "tuple of pairs")),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_refused_where_it_is_written(name: str) -> None:
    make, words = MISTAKES[name]
    with pytest.raises((ValueError, FileNotFoundError)) as refusal:
        make()
    message = str(refusal.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_what_is_no_mistake_is_accepted() -> None:
    """Lists for tuples, names of modes for modes, a word that fails on a scene that was not simulated."""

    def slow(view: Any, target: Pose) -> bool:
        return bool(1.0 / view.state.time < 2.0)

    assert track(mode="ik").phases[1].mode is Mode.IK
    assert can(phases=list(CAN.phases)) == CAN
    assert track(done=slow).phases[1].done is slow
    assert Launch(Pose.identity(), (0.0, 1.0, 0.0), STILL, 1).velocity.shape == (3,)


def run_a_little(env: ResidualEnv) -> None:
    env.reset(seed=0)
    for _ in range(10):
        env.step(0.0 * env.action_space.sample())


@pytest.mark.parametrize(
    ("predicate", "words"),
    [
        (lambda view, target: 1 / (view.state.time < 0.05) < 0, "ZeroDivisionError"),
        (lambda view, target: [False][int(view.state.time > 0.05)], "IndexError"),
        (lambda view, target: None if view.state.time > 0.05 else False, "None, neither True nor False"),
        (lambda view, target: view.state.time > 0.05 and view.state.objects["cann"], SEEN),
    ],
)
def test_a_mistake_that_shows_only_as_the_task_runs_names_phase_and_predicate(predicate: Any, words: str) -> None:
    env = ResidualEnv(reach(done=predicate))
    with pytest.raises(ValueError, match=rf"Phase 'pregrasp'.* done.*{re.escape(words)}"):
        run_a_little(env)
    env.close()


def test_a_launch_that_forgets_only_some_conditions_says_so_at_reset() -> None:
    def launch(condition: Any) -> Any:
        return CAN.scene.launch(condition) if condition.seed == 0 else {}

    env = ResidualEnv(launching(launch))
    with pytest.raises(ValueError, match=r"launch .*forgets 'can'"):
        env.reset(seed=0)
    env.close()
