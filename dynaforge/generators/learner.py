"""The generator that runs a policy learned from an export: `dynaforge evaluate --learner module:function`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

from numpy.typing import ArrayLike, NDArray

from dynaforge.demos import Episode
from dynaforge.demos.observations import ObservationSettings
from dynaforge.generators.bridge import EXPORTED, ExportBridge
from dynaforge.generators.generator import episode_of
from dynaforge.generators.recording import Recorder
from dynaforge.sim import Condition
from dynaforge.sim.checks import check_callable, check_kind
from dynaforge.tasks import Task
from dynaforge.tasks.action import ActionLayout
from dynaforge.tasks.user_code import in_one_line, module_of_file


class Learner(Protocol):
    """Maps the observation of a control step, as an export contains it, to an action.

    It may have an attribute `layout`, an `ActionLayout`, if the export was not made with the default one, and a method
    `reset()`, called before each episode, if it has a memory such as a queue of actions.
    """

    def __call__(self, observation: Mapping[str, NDArray[Any]]) -> ArrayLike:
        """Return the action, shape (d,)."""
        ...


class LearnerGenerator:
    """Attempts conditions with a learned policy in the task's env, without the planner.

    Args:
        source: "module:function" or "file.py:function"; the function takes the task's name and returns a `Learner`. It
            is called in every worker.
        settings: Settings of the pictures and points that it was trained on; None for none.

    Raises:
        ValueError: The source is not of that form, or has no such function.
    """

    name = "learner"

    def __init__(self, source: str, *, settings: ObservationSettings | None = None) -> None:
        load_function(source)
        self.source = source
        self.settings = settings
        self._learner: Learner | None = None

    def make_env(self, task: Task) -> ExportBridge:
        """Load the policy, and return a new env for it to act in.

        Raises:
            ValueError: The function fails, or what it returns is no policy.
        """
        load, option = load_function(self.source), f"--learner {self.source}"
        try:
            self._learner = load(task.name)
        except (Exception, SystemExit) as error:  # the user's code may raise anything
            raise ValueError(f"{option}: {in_one_line(error)}") from error
        check_callable(f"{option}: what it returns", self._learner, expected="a function of an observation")
        layout = getattr(self._learner, "layout", EXPORTED)
        check_kind(f"{option}: the policy's layout", layout, ActionLayout)
        return ExportBridge(task, layout, settings=self.settings)

    def attempt(self, env: ExportBridge, condition: Condition) -> Episode:
        """Run one episode and record it."""
        assert self._learner is not None
        task, world = env.env.task, env.env.world
        recorder = Recorder(task, world.kinematics)
        with world.listening(recorder):
            observation = env.reset(condition)
            if reset := getattr(self._learner, "reset", None):
                reset()
            done = False
            while not done:
                observation, _, done, _, _ = env.step(self._learner(observation))
        assert env.env.outcome is not None
        return episode_of(env.env, recorder, env.env.outcome, condition, generator=self.name, policy_hash="")


def load_function(source: str) -> Callable[[str], Learner]:
    """Import "module:function" or "file.py:function"; a module in the working folder is found too.

    Raises:
        ValueError: The form is another, the module, file or function does not exist, or its code fails.
    """
    module_name, _, name = source.rpartition(":")
    if not module_name or not name.isidentifier():
        raise ValueError(f"--learner is {source!r}; write module:function or file.py:function.")
    path = Path(module_name if module_name.endswith(".py") else f"{module_name}.py").resolve()
    if path.is_file():
        module = module_of_file(path)
    elif module_name.endswith(".py"):
        raise ValueError(f"--learner: no file {module_name}.")
    else:
        module = _import(module_name)
    function = getattr(module, name, None)
    if not callable(function):
        raise ValueError(f"--learner: {module_name} has no function {name!r}.")
    return function  # type: ignore[no-any-return]


def _import(name: str) -> ModuleType:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise ValueError(f"--learner: no module {error.name!r} here or installed.") from error
    except (Exception, SystemExit) as error:  # the user's code may raise anything
        raise ValueError(f"--learner {name}: {in_one_line(error)}") from error
