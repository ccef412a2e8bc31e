"""What a task is: declarative data, one value per task."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

from dynaforge.sim.checks import (
    check_choice,
    check_kind,
    check_number,
    check_numbers,
    check_task_name,
    check_text,
    check_tuple,
    check_whole,
    close_match,
    quoted,
)
from dynaforge.sim.hidden import hidden_ranges
from dynaforge.sim.robot import HAND_WIDTH
from dynaforge.sim.setting import Physics, Reflex, Sensing, Setting
from dynaforge.sim.spec import SceneSpec
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.dry_run import dry_run
from dynaforge.tasks.phase import Ending, Mode, Phase, check_endings
from dynaforge.tasks.predicates import Overloaded, RobotStopped
from dynaforge.tasks.words import check_word, unknown_name_message

__all__ = ["FRAMES", "Frame", "Mode", "Phase", "ResidualSpec", "Task"]

_ENV_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
Frame = Literal["target", "world"]
FRAMES: tuple[Frame, ...] = get_args(Frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualSpec:
    """How a residual action in [-1, 1] becomes a change of the planned target, Eq. 5.

    Attributes:
        translation: Scale along x, y, z, metres.
        rotation: Scale of the rotation vector about x, y, z, radians.
        width: Scale of the gripper width, metres.
        frame: "target": along and about the heading frame of the phase's object; "world": the base frame.
        decision_steps: Control steps for which one residual is kept.
        history: Control steps, the latest included, whose states the residual policy sees: h_t of Eq. 4.

    Raises:
        ValueError: A field of the wrong type or out of range, or all seven scales are 0.
    """

    translation: tuple[float, float, float] = (0.06, 0.06, 0.06)
    rotation: tuple[float, float, float] = (0.15, 0.15, 0.15)
    width: float = 0.02
    frame: Frame = "target"
    decision_steps: int = 3
    history: int = 4

    def __post_init__(self) -> None:
        check_numbers("ResidualSpec: translation", self.translation, 3, least=0.0)
        check_numbers("ResidualSpec: rotation", self.rotation, 3, least=0.0)
        check_number("ResidualSpec: width", self.width, least=0.0, most=HAND_WIDTH)
        check_choice("ResidualSpec: frame", self.frame, FRAMES)
        check_whole("ResidualSpec: decision_steps", self.decision_steps, least=1)
        check_whole("ResidualSpec: history", self.history, least=2)
        if not any(self.scales):
            raise ValueError("ResidualSpec: all seven scales are 0, so a residual could change nothing; switch one on.")

    @property
    def scales(self) -> tuple[float, ...]:
        """All seven scales: translation, rotation, width; 0 switches a dimension off."""
        return (*self.translation, *self.rotation, self.width)


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A dynamic manipulation task: everything that is specific to it.

    The end of the last phase is the task's success; with C phases, it is the C-th checkpoint of Eq. 6.

    Attributes:
        name: Lower-case name on the command line, e.g. "can".
        env_name: Name in env ids, e.g. "Can" in "DynaForge/Can-v0".
        skill: Main skill, e.g. "grasp + place".
        motion: How the object moves, one sentence.
        randomisation: What conditions vary and in which ranges, one sentence.
        goal: What counts as success, one sentence.
        scene: Bodies and launch.
        conditions: Ranges of the conditions.
        phases: The phase program.
        impossible: (reason, predicate) pairs; the episode fails as soon as one of them holds, because success is then
            impossible.
        residual: Scales and frame of the residual.
        camera: (eye, look-at) of the default camera, metres.
        instruction: What to do, as one would tell a language model, e.g. "pick up the rolling can"; made of the skill
            and the object by default.
        setting: When the robot stops, how far hidden physics varies and what is sensed. It determines the hidden ranges
            of `conditions`; `under` returns the same task in another setting.
        lead_time: Seconds of constant-velocity prediction in the planner's targets; the paper's has none.

    Raises:
        ValueError: A field of the wrong type or out of range, fields that contradict each other, or a mistake that the
            dry run found in `launch`, a target or a predicate.
    """

    name: str
    env_name: str
    skill: str
    motion: str
    randomisation: str
    goal: str
    scene: SceneSpec
    conditions: ConditionSpace
    phases: tuple[Phase, ...]
    impossible: tuple[Ending, ...]
    residual: ResidualSpec = field(default_factory=ResidualSpec)
    camera: tuple[tuple[float, float, float], tuple[float, float, float]] = ((1.2, -0.4, 0.62), (0.4, -0.02, 0.14))
    instruction: str = ""
    setting: Setting = field(default_factory=Setting)
    lead_time: float = 0.0

    def __post_init__(self) -> None:
        check_task_name("Task: name", self.name)
        place = f"Task {self.name!r}"
        for name, kind in (("scene", SceneSpec), ("conditions", ConditionSpace), ("residual", ResidualSpec)):
            check_kind(f"{place}: {name}", getattr(self, name), kind)
        check_kind(f"{place}: setting", self.setting, Setting)
        check_number(f"{place}: lead_time", self.lead_time, least=0.0)
        hidden = hidden_ranges(
            self.setting.physics, mass=bool(self.scene.bodies) and "mass" not in self.conditions.ranges
        )
        object.__setattr__(self, "conditions", replace(self.conditions, hidden=hidden))
        object.__setattr__(self, "phases", check_tuple(f"{place}: phases", self.phases, Phase))
        object.__setattr__(self, "impossible", check_endings(f"{place}: impossible", self.impossible))
        if isinstance(self.instruction, str) and not self.instruction:
            words = f"{self.skill} the {self.manipulated}".replace(" + ", " and ").replace("_", " ")
            object.__setattr__(self, "instruction", words)
        self._check_descriptions(place)
        self._check_program(place)
        self._check_words()
        dry_run(self)

    def _check_descriptions(self, place: str) -> None:
        if not isinstance(self.env_name, str) or not _ENV_NAME.fullmatch(self.env_name):
            raise ValueError(
                f"{place}: env_name is {quoted(self.env_name)}; it becomes part of an env id, as Can does of "
                "DynaForge/Can-v0, and must consist of letters, digits and '_' and begin with a letter."
            )
        for name in ("skill", "motion", "randomisation", "goal", "instruction"):
            check_text(f"{place}: {name}", getattr(self, name))
        if not isinstance(self.camera, tuple) or len(self.camera) != 2:
            raise ValueError(
                f"{place}: camera is {quoted(self.camera)}; it must be (eye, look-at), three numbers each."
            )
        for name, point in zip(("eye", "look-at"), self.camera, strict=True):
            check_numbers(f"{place}: camera, {name}", point, 3)
        if tuple(self.camera[0][:2]) == tuple(self.camera[1][:2]):
            raise ValueError(f"{place}: the camera looks straight up or down, or at itself; move its eye aside.")
        if self.conditions.task != self.name:
            raise ValueError(
                f"{place}: its conditions are those of task {self.conditions.task!r}; give both the same name."
            )

    def _check_program(self, place: str) -> None:
        if not self.phases:
            raise ValueError(f"{place} has no phase; it needs at least one.")
        names = [phase.name for phase in self.phases]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"{place}: two phases are called {twice[0]!r}; every phase has its own name.")
        if not any(phase.gate for phase in self.phases):
            raise ValueError(
                f"{place}: no phase has gate=True, so a residual could never act; open the gate where the hand tracks."
            )
        dt = self.scene.control_dt
        for k, phase in enumerate(self.phases):
            if phase.retry is not None and phase.retry[0] not in names[:k]:
                raise ValueError(
                    f"Phase {phase.name!r}: retry goes back to {phase.retry[0]!r}, which is no phase before it; those "
                    f"are {', '.join(map(repr, names[:k])) or 'none'}.{close_match(phase.retry[0], names[:k])}"
                )
            if not phase.is_held(math.ceil((phase.timeout - 1e-9) / dt), dt):
                raise ValueError(
                    f"Phase {phase.name!r}: hold {phase.hold:g} s leaves no control step of {dt:.4g} s before its "
                    f"timeout {phase.timeout:g} s, so it can never be done."
                )

    def _check_words(self) -> None:
        names = self.scene.names
        for phase in self.phases:
            place, reference = f"Phase {phase.name!r}", getattr(phase.target, "object", None)
            if reference is None:
                raise ValueError(
                    f"{place}: target {quoted(phase.target)} has no `object`, the name of what it aims at."
                )
            if reference not in names:
                raise ValueError(unknown_name_message(place, f"aims at {quoted(reference)}", reference, names))
            for role in ("target", "done", "track_until", "retry", "fails"):
                check_word(place, role, getattr(phase, role), names)
        check_word("Task", "impossible", self.impossible, names)

    def under(
        self, *, reflex: Reflex | None = None, physics: Physics | None = None, sensing: Sensing | None = None
    ) -> Task:
        """Return this task in another setting; None keeps what it has.

        Args:
            reflex: When the robot stops: a named threshold, or newtons.
            physics: How far hidden physics varies.
            sensing: What planner and policy see.

        Raises:
            ValueError: A value is unknown or out of range.
        """
        asked: dict[str, Any] = {"reflex": reflex, "physics": physics, "sensing": sensing}
        setting = replace(self.setting, **{name: value for name, value in asked.items() if value is not None})
        return self if setting == self.setting else replace(self, setting=setting)

    @property
    def simulated(self) -> SceneSpec:
        """The scene as this setting simulates it: fine physics halves the substeps."""
        if self.setting.physics != "fine":
            return self.scene
        return replace(self.scene, physics_dt=self.scene.physics_dt / 2)

    @property
    def manipulated(self) -> str:
        """The object that the hand acts on: the first free body, or the one fixture."""
        return self.scene.tracked[0]

    @property
    def endings(self) -> tuple[Ending, ...]:
        """All (reason, predicate) pairs that end an episode at once: `impossible`, and those common to all tasks."""
        stops = (("robot stopped: force", Overloaded()), ("robot stopped: speed", RobotStopped()))
        return (*self.impossible, *stops)

    @property
    def contact_phase(self) -> int:
        """Index of the phase in which contact is planned to begin: the first that closes the hand, else the last."""
        widths = [phase.width for phase in self.phases]
        closing = (k for k in range(1, len(widths)) if widths[k] < widths[k - 1])
        return next(closing, len(widths) - 1)

    @property
    def n_checkpoints(self) -> int:
        """C of Eq. 6."""
        return len(self.phases)

    @property
    def time_limit(self) -> float:
        """Seconds after which every episode has ended: the sum of the phase timeouts."""
        return sum(phase.timeout for phase in self.phases)
