"""A command line of rl_zoo3, from its flags to its script: `dynaforge train`, `enjoy`, `record_video` and so on.

Flags, log folders and output are rl_zoo3's own; a run ends in `logs/<algo>/<env>_<run>/` unless `-f` says otherwise.
What is added: the algorithms "frontier_grpo" and "grpo", hyperparameters from `dynaforge.zoo_configs` where they list
the env, worker processes for the DynaForge envs unless `--vec-env` is given, `policy.safetensors` beside the trained
model, which `evaluate` and `collect` take as `--policy`, and `--trusted`. Scripts that play a model look in
`logs/`, where `train` writes, unless `-f` is given.
"""

from __future__ import annotations

import argparse
import runpy
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

from dynaforge.sampling.processes import worker_environment
from dynaforge.zoo.algorithm import config_file, register_with_zoo
from dynaforge.zoo.checks import check_configuration, check_flags
from dynaforge.zoo.envs import import_packages, named_env, reading_our_settings
from dynaforge.zoo.flags import PLAYERS, PLOTTERS, SCRIPTS, zoo_parser
from dynaforge.zoo.process import ZooProcess
from dynaforge.zoo.refusals import (
    ZooFailure,
    check_algorithm,
    check_display,
    check_env,
    check_statistics,
    check_trust,
    one_line,
)


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
    return _plot(script, flags, asked) if script in PLOTTERS else _work(script, flags, asked)


def _work(script: str, flags: list[str], asked: argparse.Namespace) -> int:
    """Run a script that trains or plays a model."""
    if not asked.help:
        flags = flags + _checked(script, flags, asked)
    if script in PLAYERS and asked.folder is None:
        flags = [*flags, "-f", "logs"]
    register_with_zoo()
    config = None
    if not asked.help:
        check_env(asked.env)  # again: rl_zoo3 has registered envs of others meanwhile
        if script == "train":
            check_statistics(asked)
            config = config_file(asked.algo, asked.env) if asked.conf_file is None else None
    if config is not None:
        flags = [*flags, "--conf-file", str(config)]
    own_env = asked.env.startswith("DynaForge/")
    own_workers = own_env and asked.vec_env is None
    arranged = _zoo_process(script, flags, own_env=own_env, own_workers=own_workers, config=config)
    with worker_environment(), arranged:
        _run(script)
    return 0


def _checked(script: str, flags: list[str], asked: argparse.Namespace) -> list[str]:
    """Refuse what can be refused before rl_zoo3 is imported; returns the flags that name the env to rl_zoo3.

    Raises:
        SystemExit: The first mistake, in one line.
    """
    check_algorithm(asked.algo)
    check_trust(script, asked)
    more = _name_env(script, asked)
    with one_line(script):
        check_flags(script, asked, named_env=asked.env_given is not None)
    if asked.env.startswith("DynaForge/"):
        check_env(asked.env)
    check_display(script, asked, [*flags, *more])
    with one_line(script):
        if asked.conf_file is not None:
            check_configuration(asked.conf_file, asked.env)
    return more


def _parse(script: str, flags: list[str]) -> argparse.Namespace:
    """Read the flags; rl_zoo3 parses them again, with its own defaults and help.

    Raises:
        SystemExit: A flag is unknown or its value is wrong; the message names it.
    """
    wants_help = bool({"-h", "--help"} & set(flags))
    with one_line(script):
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


def _name_env(script: str, asked: argparse.Namespace) -> list[str]:
    """Resolve the env that is asked for; returns the flags that tell rl_zoo3, which knows nothing but ids."""
    try:
        import_packages(asked.gym_packages)
        env = named_env(asked.env)
    except ValueError as error:
        raise SystemExit(f"dynaforge {script}: {error}") from error
    changed, asked.env = env != asked.env, env
    return ["--env", env] if changed else []


@contextmanager
def _zoo_process(
    script: str, flags: list[str], *, own_env: bool, own_workers: bool, config: Path | None
) -> Iterator[None]:
    """Arrange, while rl_zoo3 runs, what it reads from the process and what it does to our envs."""
    from rl_zoo3.exp_manager import ExperimentManager

    from dynaforge.sampling.vector_env import SharedMemoryVecEnv

    with one_line(script), closing(ZooProcess(script, flags, own_envs=own_env)) as process:
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


def _plot(script: str, flags: list[str], asked: argparse.Namespace) -> int:
    """Run a script that plots; it looks for parts of folder names, in which rl_zoo3 writes "-" for "/"."""
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
