"""rl_zoo3 with FrontierGRPO and the DynaForge envs registered: `dynaforge train`, `enjoy`, `record_video` and so on.

Flags, log folders and output are rl_zoo3's own; a run ends in `logs/<algo>/<env>_<run>/` unless `-f` says otherwise.
What is added: the algorithms "frontier_grpo" and "grpo", hyperparameters from `dynaforge.zoo_configs` where they list
the env, worker processes for the DynaForge envs unless `--vec-env` is given, `policy.safetensors` beside the trained
model, which `evaluate` and `collect` take as `--policy`, and `--trusted`. What plays a model looks in logs/, where
`train` writes, unless `-f` is given.
"""

from __future__ import annotations

import argparse
import difflib
import runpy
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import yaml

from dynaforge.sampling.processes import worker_environment
from dynaforge.tasks import what_was_meant
from dynaforge.training import settings
from dynaforge.zoo.checks import check_configuration, check_flags
from dynaforge.zoo.envs import import_packages, named_env, reading_our_settings
from dynaforge.zoo.flags import zoo_algorithms, zoo_parser
from dynaforge.zoo.process import ZooProcess

ALGORITHMS = ("frontier_grpo", "grpo")
"""Names under which rl_zoo3 finds FrontierGRPO; "grpo" is the vanilla variant by its zoo_configs file alone."""

PLAYERS = ("enjoy", "record_video", "record_training")
"""Scripts of rl_zoo3 that load a trained model."""

PLOTTERS = ("plot_train", "all_plots", "plot_from_file")
"""Scripts of rl_zoo3 that read logs."""

SCRIPTS = ("train", *PLAYERS, *PLOTTERS)
"""Of rl_zoo3."""

NET_ARCHS = {"small": [64, 64], "medium": [128, 128], "large": [256, 256]}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a script of rl_zoo3 on arguments as the shell gives them, by default those of this process.

    Raises:
        SystemExit: An unknown script, env, algorithm or configuration file, an untrusted checkpoint, or no rl_zoo3;
            its message is one line.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] not in SCRIPTS:
        given = repr(arguments[0]) if arguments else "nothing"
        known = f"{', '.join(map(repr, SCRIPTS[:-1]))} or {SCRIPTS[-1]!r}"
        raise SystemExit(f"dynaforge: expected {known} and its flags, was given {given}")
    script, *flags = arguments
    asked = _parse(script, flags)
    flags = [flag for flag in flags if not (flag[:3] == "--t" and "--trusted".startswith(flag))]
    if script in PLOTTERS:
        return _plot(script, flags, asked)
    if not asked.help:
        _check_algorithm(asked.algo)
        _check_files(script, asked)
        flags += _name_env(script, asked)
        with _one_line(script):
            check_flags(script, asked, named_env=asked.env_given is not None)
        if asked.env.startswith("DynaForge/"):
            _check_env(asked.env)
        _check_display(script, asked, flags)
        with _one_line(script):
            if asked.conf_file is not None:
                check_configuration(asked.conf_file, asked.env)
    if script in PLAYERS and asked.folder is None:
        flags += ["-f", "logs"]
    register_with_zoo()
    config = None
    if not asked.help:
        _check_env(asked.env)
        if script == "train":
            _check_statistics(asked)
            config = config_file(asked.algo, asked.env) if asked.conf_file is None else None
    flags += ["--conf-file", str(config)] if config else []
    own_env = asked.env.startswith("DynaForge/")
    own_workers = own_env and asked.vec_env is None
    arranged = _zoo_process(script, flags, own_env=own_env, own_workers=own_workers, config=config)
    with worker_environment(), arranged:
        _run(script)
    return 0


def register_with_zoo() -> None:
    """Make FrontierGRPO known to rl_zoo3, for training, loading and hyperparameter search.

    rl_zoo3 imports its dictionaries by name in several modules: they are changed in place, never replaced.

    Raises:
        SystemExit: rl_zoo3, or what its tools need, is not installed.
    """
    try:
        from rl_zoo3 import ALGOS
        from rl_zoo3.hyperparams_opt import HYPERPARAMS_CONVERTER, HYPERPARAMS_SAMPLER
    except ModuleNotFoundError as error:
        raise SystemExit(
            f"dynaforge: {', '.join(SCRIPTS)} need {error.name}, missing here; pip install 'dynaforge[zoo]'"
        ) from error
    from dynaforge.algos import FrontierGRPO

    for name in ALGORITHMS:
        ALGOS[name] = FrontierGRPO
        HYPERPARAMS_SAMPLER[name] = sample_hyperparameters
        HYPERPARAMS_CONVERTER[name] = convert_hyperparameters


def config_file(algo: str, env_id: str) -> Path | None:
    """Return the installed hyperparameter file of an algorithm, or None where rl_zoo3's own is the better choice.

    Ours are taken when they list the env, or a default for all envs; rl_zoo3 has files of its own for PPO and the like.
    """
    path = settings.config_file(algo)
    if path is None or settings.entry_of(yaml.safe_load(path.read_text(encoding="utf-8")), env_id) is None:
        return None
    return path


def sample_hyperparameters(trial: Any, n_actions: int, n_envs: int, additional_args: dict[str, Any]) -> dict[str, Any]:
    """Sample the options of FrontierGRPO for an Optuna trial, as rl_zoo3's samplers do.

    `log_std_init` reaches from gSDE's -4.5 of each weight to white noise's -0.7 of each component.
    """
    return convert_hyperparameters(
        {
            "learning_rate": trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True),
            "n_epochs": trial.suggest_categorical("n_epochs", [1, 2, 4]),
            "group_size": trial.suggest_categorical("group_size", [4, 8, 16]),
            "max_grad_norm": trial.suggest_float("max_grad_norm", 0.3, 2.0),
            "log_std_init": trial.suggest_float("log_std_init", -4.5, -0.7),
            "net_arch": trial.suggest_categorical("net_arch", sorted(NET_ARCHS)),
        }
    )


def convert_hyperparameters(sampled: dict[str, Any]) -> dict[str, Any]:
    """Turn sampled values into constructor arguments: the learning rate decays, noise and net_arch are the policy's."""
    from stable_baselines3.common.utils import LinearSchedule

    options = dict(sampled)
    policy = {"log_std_init": options.pop("log_std_init"), "net_arch": NET_ARCHS[options.pop("net_arch")]}
    decaying = LinearSchedule(start=options.pop("learning_rate"), end=0.0, end_fraction=1.0)
    return {**options, "learning_rate": decaying, "policy_kwargs": policy}


def _parse(script: str, flags: list[str]) -> argparse.Namespace:
    """Read the flags; rl_zoo3 parses them again, with its own defaults and help.

    Raises:
        SystemExit: One is unknown, or its value is none; the message names it.
    """
    wants_help = bool({"-h", "--help"} & set(flags))
    with _one_line(script):
        try:
            parser = zoo_parser(script, complete=not wants_help)
        except ModuleNotFoundError:
            register_with_zoo()  # says what to install
            raise
        asked: argparse.Namespace = parser.parse_args(["--help"] if wants_help else flags)
    if script not in PLOTTERS:
        asked.env_given, asked.env, asked.algo = asked.env, asked.env or "CartPole-v1", asked.algo or "ppo"
        asked.folder = asked.log_folder if script == "train" else asked.folder
    for name, missing in (("conf_file", None), ("trained_agent", ""), ("vec_env", None), ("gym_packages", [])):
        setattr(asked, name, getattr(asked, name, None) or missing)
    return asked


def _check_files(script: str, asked: argparse.Namespace) -> None:
    """Refuse to load an SB3 checkpoint unasked: unpickling runs what its author put in."""
    if (script != "train" or asked.trained_agent) and not asked.trusted:
        what = asked.trained_agent or "an rl_zoo3 checkpoint"
        raise SystemExit(
            f"dynaforge {script}: loading {what} can run code stored in it; add --trusted if it is your own"
        )


def _name_env(script: str, asked: argparse.Namespace) -> list[str]:
    """Resolve the env that is asked for; returns the flags that tell rl_zoo3, which knows nothing but ids."""
    try:
        import_packages(asked.gym_packages)
        env = named_env(asked.env)
    except ValueError as error:
        raise SystemExit(f"dynaforge {script}: {error}") from error
    changed, asked.env = env != asked.env, env
    return ["--env", env] if changed else []


def _check_statistics(asked: argparse.Namespace) -> None:
    """Refuse to unpickle unasked what rl_zoo3 takes for a run's statistics, in this folder if it goes on with none."""
    name = asked.env.rpartition(":")[2].replace("/", "-")
    statistics = Path(asked.trained_agent).parent / name / "vecnormalize.pkl"
    if statistics.exists() and not asked.trusted:
        raise SystemExit(
            f"dynaforge train: rl_zoo3 loads {statistics}, which can run code stored in it; add --trusted if it is "
            "your own, or start elsewhere"
        )


def _check_display(script: str, asked: argparse.Namespace, flags: list[str]) -> None:
    """Refuse to play an episode in a window where there is none, before anything is loaded."""
    if (
        script != "enjoy"
        or not asked.env.startswith("DynaForge/")
        or "--no-render" in flags
        or any("render_mode" in flag for flag in flags)
    ):
        return
    from dynaforge.sim.bullet import missing_display

    if problem := missing_display():
        raise SystemExit(
            f"dynaforge enjoy: it opens a window, but {problem}; add --no-render, or make a film with record_video"
        )


def _check_algorithm(algo: str) -> None:
    """Refuse an unknown algorithm."""
    known = (*zoo_algorithms(), *ALGORITHMS)
    if algo not in known:
        close = difflib.get_close_matches(algo, known, n=1, cutoff=0.5)
        hint = f" Did you mean {close[0]!r}?" if close else f" Known are {', '.join(known)}."
        raise SystemExit(f"dynaforge: no algorithm {algo!r}.{hint}")


def _check_env(env: str) -> None:
    """Refuse an unknown env; those of others are known once rl_zoo3 is imported."""
    import gymnasium as gym

    if env not in gym.registry:
        raise SystemExit(f"dynaforge: no env {env!r}. {what_was_meant(env, among=gym.registry)}")


@contextmanager
def _zoo_process(
    script: str, flags: list[str], *, own_env: bool, own_workers: bool, config: Path | None
) -> Iterator[None]:
    """Arrange for as long as rl_zoo3 runs what it reads from the process, and what it does to our envs."""
    from rl_zoo3.exp_manager import ExperimentManager

    from dynaforge.sampling.vector_env import SharedMemoryVecEnv

    with _one_line(script), closing(ZooProcess(script, flags, own_envs=own_env)) as process:
        if own_workers and script == "train":
            process.put("default_vec_env_cls", SharedMemoryVecEnv)
        if config is not None:
            process.put("read_hyperparameters", reading_our_settings(ExperimentManager.read_hyperparameters))
        try:
            yield
        except Exception as error:
            if process.learning and not isinstance(error, (ValueError, OSError, ArithmeticError)):
                raise
            if not process.learning:
                process.clear()
            raise ZooFailure(error) from error


class ZooFailure(Exception):  # noqa: N818 - it stands for one of any kind
    """What a script of rl_zoo3 ended with: a mistake in the command line, or an error that explains itself."""

    def __str__(self) -> str:
        error = self.args[0]
        kind = "" if isinstance(error, (ValueError, AssertionError, OSError)) else f"{type(error).__name__}: "
        return kind + (str(error) or type(error).__name__)


@contextmanager
def _one_line(script: str) -> Iterator[None]:
    """Let a mistake end the process with one line.

    Raises:
        SystemExit: With that line.
    """
    try:
        yield
    except (ValueError, ZooFailure) as error:
        raise SystemExit(f"dynaforge {script}: {' '.join(str(error).split())}") from error


def _plot(script: str, flags: list[str], asked: argparse.Namespace) -> int:
    """Run a script that plots; it looks for parts of folder names, in which "/" is written "-"."""
    if script == "plot_from_file" and not asked.help and not asked.trusted:
        raise SystemExit("dynaforge plot_from_file: it unpickles a file of all_plots; add --trusted if it is your own")
    flags = [flag.replace("DynaForge/", "DynaForge-") for flag in flags]
    register_with_zoo()
    with _zoo_process(script, flags, own_env=False, own_workers=False, config=None):
        _run(script)
    return 0


def _run(script: str) -> None:
    """Run one of rl_zoo3's scripts, imported only now since each takes a while."""
    if script == "train":
        from rl_zoo3.train import train

        train()
    elif script == "enjoy":
        from rl_zoo3.enjoy import enjoy

        enjoy()
    elif script in PLOTTERS:
        import rl_zoo3.plots

        getattr(rl_zoo3.plots, script)()
    else:
        runpy.run_module(f"rl_zoo3.{script}", run_name="__main__")
