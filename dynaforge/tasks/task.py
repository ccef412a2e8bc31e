"""What a task is: declarative data, one value a task."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from dynaforge.sim.spec import SceneSpec
from dynaforge.tasks.conditions import ConditionSpace
from dynaforge.tasks.predicates import Predicate, RobotStopped
from dynaforge.tasks.targets import Target


class Mode(StrEnum):
    """How a phase plans: one global trajectory at its entry, or object-centric IK at every control step."""

    GLOBAL = "global"
    IK = "ik"


@dataclass(frozen=True, slots=True)
class Phase:
    """One phase of the program.

    Attributes:
        name: Its name in records and reports.
        mode: Low-frequency global planning or high-frequency IK.
        target: Object-centric target of Eq. 3.
        width: Commanded opening between the fingers, metres.
        done: Success predicate; the phase advances once it held for `hold` seconds.
        timeout: Seconds after which the episode fails.
        failure: The reason recorded then.
        gate: The residual gate m of Eq. 5.
        hold: Seconds from the first to the last of the control steps at which `done` held without a break.
        track_until: Once this holds, the target freezes: the hand must not chase what it pushes.
        takes_hold: At its end the object in the hand is measured: the tool frame of targets that come after.
        residual_share: Share of the task's residual scales that the residual has in this phase.
        fails: (reason, predicate) pairs that end the episode at once while this phase runs.
    """

    name: str
    mode: Mode
    target: Target
    width: float
    done: Predicate
    timeout: float
    failure: str
    gate: bool = False
    hold: float = 0.0
    track_until: Predicate | None = None
    takes_hold: bool = False
    residual_share: float = 1.0
    fails: tuple[tuple[str, Predicate], ...] = ()

    def is_held(self, samples: int, control_dt: float) -> bool:
        """Tell whether `done`, true at the last `samples` control steps of `control_dt` seconds, held long enough."""
        return samples > 0 and (samples - 1) * control_dt >= self.hold - 1e-9


@dataclass(frozen=True, slots=True)
class ResidualSpec:
    """How a residual action in [-1, 1] becomes a change of the planned target, Eq. 5.

    Attributes:
        translation: Scale along x, y, z, metres.
        rotation: Scale of the rotation vector about x, y, z, radians.
        width: Scale of the gripper width, metres.
        frame: "target": along and about the heading frame of the phase's object; "world": the base frame.
        decision_steps: Control steps for which one residual is held.
    """

    translation: tuple[float, float, float] = (0.06, 0.06, 0.06)
    rotation: tuple[float, float, float] = (0.15, 0.15, 0.15)
    width: float = 0.02
    frame: str = "target"
    decision_steps: int = 3

    @property
    def scales(self) -> tuple[float, ...]:
        """All seven scales: translation, rotation, width; 0 switches a dimension off."""
        return (*self.translation, *self.rotation, self.width)


@dataclass(frozen=True, slots=True)
class Task:
    """A dynamic manipulation task: the whole of what is specific to it.

    The last phase's success is the task's success; with C phases, it is the C-th checkpoint of Eq. 6.

    Attributes:
        name: Lower-case name on the command line, e.g. "can".
        env_name: Name in env ids, e.g. "Can" in "DynaForge/Can-v0".
        skill: Dominant skill.
        motion: How the object moves, one sentence.
        randomisation: What a condition draws and from where, one sentence.
        goal: What counts as success, one sentence.
        scene: Bodies and launch.
        conditions: Ranges of the conditions.
        phases: The phase program.
        impossible: (reason, predicate) pairs: once one holds, success is impossible and the episode fails at once.
        residual: Scales and frame of the residual.
        camera: (eye, look-at) of the default camera, metres.
        instruction: What to do, as one would tell a language model, e.g. "pick up the rolling can"; by default made of
            the skill and the object.
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
    impossible: tuple[tuple[str, Predicate], ...]
    residual: ResidualSpec = field(default_factory=ResidualSpec)
    camera: tuple[tuple[float, float, float], tuple[float, float, float]] = ((1.2, -0.4, 0.62), (0.4, -0.02, 0.14))
    instruction: str = ""

    def __post_init__(self) -> None:
        if not self.instruction and self.scene.tracked:
            words = f"{self.skill.replace(' + ', ' and ')} the {self.manipulated.replace('_', ' ')}"
            object.__setattr__(self, "instruction", words)

    @property
    def manipulated(self) -> str:
        """The object that the hand acts on: the first free body, or the one fixture."""
        return self.scene.tracked[0]

    @property
    def endings(self) -> tuple[tuple[str, Predicate], ...]:
        """All (reason, predicate) pairs that end an episode at once: `impossible` and what holds for every task."""
        return (*self.impossible, ("robot stopped", RobotStopped()))

    @property
    def contact_phase(self) -> int:
        """Index of the phase that begins when contact is planned: the first that closes the hand, else the last."""
        widths = [phase.width for phase in self.phases]
        closing = (k for k in range(1, len(widths)) if widths[k] < widths[k - 1])
        return next(closing, len(widths) - 1)

    @property
    def n_checkpoints(self) -> int:
        """C of Eq. 6."""
        return len(self.phases)

    @property
    def time_limit(self) -> float:
        """Seconds after which an episode has surely ended: the sum of the phase timeouts."""
        return sum(phase.timeout for phase in self.phases)
