"""Synchronised replay (DOMINO): a grasp of the object at rest, replayed while the object is driven into it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynaforge.demos import Episode
from dynaforge.demos.prescription import PRESCRIBED, prescription_of
from dynaforge.envs.executor import PlannedAction
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators.generator import episode_of
from dynaforge.generators.names import FASTEST, LEVELS, SHIPPED, SLOWEST, Level, Speed
from dynaforge.generators.object_paths import Ending, draw_path
from dynaforge.generators.recording import Recorder
from dynaforge.generators.static_scenes import StaticScene, check_supported, static_scene
from dynaforge.geometry import Pose
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_choice, check_number
from dynaforge.sim.prescribed import RELEASES, PrescribedMotion, Release
from dynaforge.tasks import Outcome, Task
from dynaforge.tasks.success import SuccessJudge

STREAM = 19  # of a condition's seed: what is drawn here is drawn from no other stream


@dataclass(frozen=True, slots=True, eq=False)
class DryRun:
    """The grasp of the object at rest.

    Attributes:
        actions: The planned action of every control step until the grasp is closed; its sample is the joint reference.
        hand: Pose of the hand when it is.
        failure: How it ended if the grasp failed; else None.
    """

    actions: list[PlannedAction]
    hand: Pose
    failure: Outcome | None = None


class SynchronisedReplay:
    """Grasps the object at rest in a dry run, then replays the arm's path while the object is driven to the same place.

    The object's motion is prescribed until the grasp is closed: nothing holds it up, and nothing that touches it moves
    it. From then on only physics moves it, and the planner goes on with the next phase. The episodes say so
    (`dynamics: prescribed`), and their conditions decide where the path ends and how it is drawn, but not how fast the
    object is launched. `docs/rivals.md` says what is faithful.

    Args:
        level: Shape of the path: 1, a constant velocity; 2, a polynomial; 3, two or three segments.
        release: When physics takes over: "end", at rest at the end of the path; "contact", at the first contact with
            the robot, as it moves.
        speed: Cap on the object's speed: "shipped", 0.1 m/s; "task", the difficulty of the condition, which is a speed
            in all supported tasks; or a number, m/s.

    Raises:
        ValueError: An option is unknown or out of range.
    """

    def __init__(self, *, level: Level = 1, release: Release = "end", speed: Speed = "shipped") -> None:
        check_choice("level", str(level), [str(known) for known in LEVELS])
        check_choice("release", release, RELEASES)
        if isinstance(speed, str):
            check_choice("speed", speed, ("shipped", "task"))
        else:
            check_number("speed", speed, least=SLOWEST, most=FASTEST)
        self.level, self.release = level, release
        self.speed = speed if isinstance(speed, str) else float(speed)

    @property
    def name(self) -> str:
        """The word replay, and the options that are not the default ones, so that attempts are not mixed up."""
        options = {f"level{self.level}": self.level != 1, self.release: self.release != "end"}
        cap = "task-speed" if self.speed == "task" else f"{self.speed}mps"
        options[cap] = self.speed != "shipped"
        return "-".join(["replay", *(name for name, given in options.items() if given)])

    def make_env(self, task: Task) -> ResidualEnv:
        """Return a new env for it to act in.

        Raises:
            ValueError: The task is not supported.
        """
        check_supported(task)
        return ResidualEnv(task, share_prefix=False)

    def attempt(self, env: ResidualEnv, condition: Condition) -> Episode:
        """Run one episode and record it.

        Raises:
            ValueError: The task is not supported.
        """
        recorder = Recorder(env.task, env.world.kinematics)
        static = static_scene(env.task, condition)
        with env.world.listening(recorder):
            motion = static.standing(env.task.manipulated)
            dry = self._dry_run(env, condition, motion)
            outcome = dry.failure
            if outcome is None:
                recorder.clear()
                motion = self._motion(env, condition, static, dry)
                outcome = self._replay(env, condition, motion, dry.actions) or self._go_on(env, condition)
        episode = episode_of(env, recorder, outcome, condition, generator=self.name, policy_hash="")
        return replace(episode, meta={**episode.meta, **self._marks(env, motion)})

    def _marks(self, env: ResidualEnv, motion: PrescribedMotion) -> dict[str, Any]:
        return {
            "dynamics": PRESCRIBED,
            "prescribed": {
                "options": {"level": self.level, "release": self.release, "speed": self.speed},
                "motion": motion.to_dict(),
                "until": env.world.scene.prescribed_until,
            },
        }

    @staticmethod
    def of(episode: Episode) -> SynchronisedReplay:
        """Return the generator that made an episode, with the options that it notes.

        Raises:
            ValueError: Its motion is not prescribed, or the notes are malformed.
        """
        prescription = prescription_of(episode)
        if prescription is None:
            raise ValueError("its motion is not prescribed")
        try:
            return SynchronisedReplay(**prescription.options)
        except TypeError as error:
            raise ValueError(f"its notes on the prescribed motion are malformed: {error}") from error

    def _dry_run(self, env: ResidualEnv, condition: Condition, standing: PrescribedMotion) -> DryRun:
        """Run the planner's program on the object at rest until the phase that closes the hand is done."""
        world, executor, last = env.world, env.executor, env.task.contact_phase
        state = world.reset(condition, prescribed=standing)
        executor.reset(state, condition, world.reference, sensed=world.sensed)
        actions: list[PlannedAction] = []
        while executor.outcome is None and executor.index <= last:
            planned = executor.action
            state = world.execute(planned, None)
            actions.append(replace(planned, sample=world.reference.joints))
            executor.advance(state, world.reference, sensed=world.sensed)
        failed = executor.outcome if executor.index <= last else None
        return DryRun(actions, state.ee, failed and replace(failed, failure=f"at rest: {failed.failure}"))

    def _motion(self, env: ResidualEnv, condition: Condition, static: StaticScene, dry: DryRun) -> PrescribedMotion:
        """Draw a path that ends when and where the grasp closes, and arrives between the open fingers."""
        ending = Ending(
            position=static.pose.position,
            direction=between_fingers(dry.hand, static.direction),
            duration=len(dry.actions) * env.task.scene.control_dt,
        )
        rng = np.random.default_rng((condition.seed, STREAM))
        cap = {"shipped": SHIPPED, "task": condition.difficulty}.get(str(self.speed), self.speed)
        assert not isinstance(cap, str)
        knots, pieces = draw_path(rng, self.level, ending, cap=max(cap, SLOWEST), is_free=static.is_free)
        standing = static.standing(env.task.manipulated)
        return replace(standing, knots=knots, pieces=pieces, release=self.release)

    def _replay(
        self, env: ResidualEnv, condition: Condition, motion: PrescribedMotion, actions: list[PlannedAction]
    ) -> Outcome | None:
        """Replay the arm's path; return the outcome if the robot stops, else None."""
        task, world = env.task, env.world
        judge = SuccessJudge(task, world.reset(condition, prescribed=motion))
        # What a task calls impossible does not hold for an object whose way is known; what stops the robot does.
        stops = task.endings[len(task.impossible) :]
        for planned in actions:
            state = world.execute(planned, None)
            judge.push(state)
            for reason, stopped in stops:
                if stopped(judge.view, state.ee):
                    return Outcome(
                        success=False,
                        checkpoint=planned.phase,
                        n_checkpoints=task.n_checkpoints,
                        failure=reason,
                        phase=task.phases[planned.phase].name,
                    )
        return None

    def _go_on(self, env: ResidualEnv, condition: Condition) -> Outcome:
        """Go on with the planner's program after the grasp, now on the object that physics moves."""
        world, executor = env.world, env.executor
        first = env.task.contact_phase + 1
        executor.reset(world.state, condition, world.reference, sensed=world.sensed, first=first)
        while executor.outcome is None:
            state = world.execute(executor.action, None)
            executor.advance(state, world.reference, sensed=world.sensed)
        return executor.outcome


def between_fingers(hand: Pose, about: float) -> float:
    """Return the horizontal direction across that in which the fingers close, of the two the one nearer to an angle.

    Args:
        hand: `T_world_ee`; its fingers open along its y axis.
        about: The angle, radians from the world's x axis.
    """
    x, y, _ = hand.rotation[:, 1].tolist()
    across = math.atan2(x, -y)
    return across if math.cos(across - about) >= 0.0 else math.remainder(across + math.pi, math.tau)
