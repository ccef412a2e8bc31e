"""The parts of rl_zoo3 and Stable-Baselines3 that are replaced while a script of rl_zoo3 runs."""

from __future__ import annotations

import contextlib
import difflib
import functools
import inspect
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from dynaforge.registration import ENV_NAMES, env_id
from dynaforge.zoo.checks import check_schedules

ACTION_NOISE = ("noise_type", "noise_std")  # hyperparameters that rl_zoo3 converts after the check


class ZooProcess:
    """Replaces parts of rl_zoo3 and Stable-Baselines3 with ours; `close` restores all of them.

    Args:
        script: The script of rl_zoo3.
        flags: Its flags.
        own_envs: Whether the env is one of ours.

    Attributes:
        learning: Whether training or a search has begun; a failure before that is a mistake in the command line.
    """

    def __init__(self, script: str, flags: list[str], *, own_envs: bool) -> None:
        from rl_zoo3.exp_manager import ExperimentManager
        from rl_zoo3.utils import StoreDict
        from stable_baselines3.common.base_class import BaseAlgorithm

        self.learning = False
        self._script = script
        self._new_folders: list[Path] = []
        self._envs: list[Any] = []
        self._undo = contextlib.ExitStack()
        self._put(sys, "argv", [f"dynaforge {script}", *flags])
        self._wrap(BaseAlgorithm, "_update_current_progress_remaining", _never_below_zero)
        self._wrap(StoreDict, "__call__", self._one_line_for_pairs)
        manager = ExperimentManager
        self._wrap(manager, "_preprocess_schedules", _reading_all_schedules, static=True)
        self._wrap(manager, "_preprocess_hyperparams", _refusing_unknown_names)
        self._wrap(manager, "create_log_folder", self._noting_folders)
        self._wrap(manager, "create_envs", self._noting_envs)
        self._wrap(manager, "_load_pretrained_agent", _saying_what_is_continued)
        self._wrap(manager, "save_trained_model", _saving_the_policy)
        for name in ("learn", "hyperparameters_optimization"):
            self._wrap(manager, name, self._noting_the_start)
        if own_envs and script == "train":
            self._wrap(manager, "create_envs", _monitoring_success)
            self._wrap(manager, "create_envs", _noting_the_task)
        if script == "record_training":
            self._put(subprocess, "call", _calling_our_recorder(subprocess.call))
            self._undo.enter_context(_ffmpeg_on_path())

    def put(self, name: str, value: Any) -> None:
        """Replace an attribute of rl_zoo3's manager."""
        from rl_zoo3.exp_manager import ExperimentManager

        self._put(ExperimentManager, name, value)

    def clear(self) -> None:
        """Close the envs and remove the new folders of a run that did not begin."""
        for env in self._envs:
            env.close()
        for path in self._new_folders:
            if path == self._new_folders[0]:
                shutil.rmtree(path, ignore_errors=True)
            else:
                with contextlib.suppress(OSError):  # another process may have put something there
                    path.rmdir()

    def close(self) -> None:
        """Restore everything."""
        self._undo.close()

    def _put(self, owner: Any, name: str, value: Any) -> None:
        previous = inspect.getattr_static(owner, name)
        setattr(owner, name, value)
        self._undo.callback(setattr, owner, name, previous)

    def _wrap(self, owner: Any, name: str, wrapper: Callable[[Any], Any], *, static: bool = False) -> None:
        function = getattr(owner, name)
        wrapped = functools.wraps(function)(wrapper(function))
        self._put(owner, name, staticmethod(wrapped) if static else wrapped)

    def _noting_the_start(self, run: Callable[..., Any]) -> Callable[..., Any]:
        def started(*args: Any, **kwargs: Any) -> Any:
            self.learning = True
            return run(*args, **kwargs)

        return started

    def _noting_folders(self, create: Callable[[Any], None]) -> Callable[[Any], None]:
        def create_log_folder(manager: Any) -> None:
            run = Path(manager.save_path)
            self._new_folders = [path for path in (run, *run.parents) if not path.exists()]
            create(manager)

        return create_log_folder

    def _noting_envs(self, create: Callable[..., Any]) -> Callable[..., Any]:
        def create_envs(manager: Any, *args: Any, **kwargs: Any) -> Any:
            self._envs.append(create(manager, *args, **kwargs))
            return self._envs[-1]

        return create_envs

    def _one_line_for_pairs(self, store: Callable[..., None]) -> Callable[..., None]:
        def call(action: Any, parser: Any, namespace: Any, values: list[str], option_string: Any = None) -> None:
            try:
                if wrong := [pair for pair in values if not all(pair.partition(":")[::2])]:
                    raise ValueError(f"{wrong[0]!r} is no pair")
                store(action, parser, namespace, values, option_string)
            except Exception as error:
                raise SystemExit(
                    f"dynaforge {self._script}: {option_string} {' '.join(values)}: {' '.join(str(error).split())}; "
                    "write NAME:VALUE, the value as in Python, a word in quotes within quotes: \"policy:'MlpPolicy'\""
                ) from error

        return call


def _never_below_zero(update: Callable[..., None]) -> Callable[..., None]:
    """Keep the remaining progress at 0 or above: below it, rl_zoo3's schedules return negative rates."""

    def _update_current_progress_remaining(model: Any, num_timesteps: int, total_timesteps: int) -> None:
        update(model, num_timesteps, total_timesteps)
        model._current_progress_remaining = max(0.0, model._current_progress_remaining)

    return _update_current_progress_remaining


def _reading_all_schedules(read: Callable[[dict[str, Any]], dict[str, Any]]) -> Callable[[dict[str, Any]], Any]:
    """Make rl_zoo3 read "lin_0.28" as a schedule for `clip_range_high`, as it does for `clip_range`."""

    def _preprocess_schedules(hyperparams: dict[str, Any]) -> dict[str, Any]:
        check_schedules(hyperparams)
        high = hyperparams.get("clip_range_high")
        if isinstance(high, str):
            hyperparams["clip_range_high"] = read({"clip_range": high})["clip_range"]
        return read(hyperparams)

    return _preprocess_schedules


def _refusing_unknown_names(preprocess: Callable[[Any, dict[str, Any]], Any]) -> Callable[[Any, dict[str, Any]], Any]:
    """Refuse a hyperparameter that the algorithm does not know, and name the closest one that it does."""

    def _preprocess_hyperparams(manager: Any, hyperparams: dict[str, Any]) -> Any:
        from rl_zoo3.utils import ALGOS

        processed = preprocess(manager, hyperparams)
        known = [*_options_of(ALGOS[manager.algo]), *ACTION_NOISE]
        if unknown := [name for name in processed[0] if name not in known]:
            close = difflib.get_close_matches(unknown[0], known, n=1, cutoff=0.5)
            hint = f" Did you mean {close[0]!r}?" if close else ""
            raise ValueError(f"{manager.algo} has no hyperparameter {unknown[0]!r}.{hint}")
        return processed

    return _preprocess_hyperparams


def _options_of(algorithm: type) -> Iterator[str]:
    """Yield the names of an algorithm's options; one that takes others by **kwargs has those of its base class too."""
    for kind in algorithm.__mro__:
        parameters = inspect.signature(kind).parameters
        yield from parameters
        if not any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters.values()):
            return


def _monitoring_success(create: Callable[..., Any]) -> Callable[..., Any]:
    """Make monitor files say which episodes succeeded, for `plot_train -y success`."""

    def create_envs(manager: Any, *args: Any, **kwargs: Any) -> Any:
        manager.monitor_kwargs = {"info_keywords": ("is_success",)} | manager.monitor_kwargs
        return create(manager, *args, **kwargs)

    return create_envs


def _noting_the_task(create: Callable[..., Any]) -> Callable[..., Any]:
    """Keep the task with the setting of the envs: they are closed when the policy is saved."""

    def create_envs(manager: Any, *args: Any, **kwargs: Any) -> Any:
        env = create(manager, *args, **kwargs)
        manager.task = env.get_attr("task")[0]
        return env

    return create_envs


def _saying_what_is_continued(load: Callable[..., Any]) -> Callable[..., Any]:
    """Print what is continued of the earlier run: rl_zoo3 counts steps from 0 again, and may find no statistics."""

    def _load_pretrained_agent(manager: Any, *args: Any) -> Any:
        model = load(manager, *args)
        print(f"Continuing from the weights of {manager.trained_agent}; steps and schedules start again from 0.")
        statistics = Path(manager.trained_agent).parent / str(manager.env_name) / "vecnormalize.pkl"
        if manager.normalize and not statistics.exists():
            print(f"There is no {statistics}: the statistics that normalise observations start again too.")
        return model

    return _load_pretrained_agent


def _saving_the_policy(save: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """Make rl_zoo3 write `policy.safetensors` beside a trained model, where the env is that of a task."""

    def save_trained_model(manager: Any, model: Any) -> None:
        save(manager, model)
        if not any(env_id(task) == manager.env_name.gym_id for task in ENV_NAMES):
            return
        from dynaforge.algos.policy_file import POLICY_FILE
        from dynaforge.training.model import policy_file

        try:
            updates = model._n_updates // getattr(model, "n_epochs", 1)
            policy = policy_file(model, manager.task, algo=manager.algo, seed=manager.seed, updates=updates)
        except ValueError as error:
            print(f"No policy.safetensors: {error}")
            return
        path = Path(manager.save_path) / POLICY_FILE
        policy.save(path)
        print(f"Policy for evaluate and collect: --policy {path}")

    return save_trained_model


def _calling_our_recorder(call: Callable[..., int]) -> Callable[..., int]:
    """Make record_training start record_video with this interpreter, and with our algorithm and envs."""
    theirs = ["python", "-m", "rl_zoo3.record_video"]

    def ours(command: Any, *args: Any, **kwargs: Any) -> int:
        if isinstance(command, list) and command[:3] == theirs:
            command = [sys.executable, "-m", "dynaforge.zoo", "record_video", "--trusted", *command[3:]]
        return call(command, *args, **kwargs)

    return ours


@contextlib.contextmanager
def _ffmpeg_on_path() -> Iterator[None]:
    """Put `ffmpeg`, which record_training calls, on the path: the system's, else the one that imageio-ffmpeg has."""
    if shutil.which("ffmpeg"):
        yield
        return
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError as error:
        raise ValueError("record_training needs ffmpeg; pip install imageio-ffmpeg brings one") from error
    before = os.environ["PATH"]
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "ffmpeg").symlink_to(get_ffmpeg_exe())
        os.environ["PATH"] = os.pathsep.join((folder, before))
        try:
            yield
        finally:
            os.environ["PATH"] = before
