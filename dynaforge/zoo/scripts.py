"""The scripts of rl_zoo3 as commands: `dynaforge train`, `enjoy`, `record_video` and so on.

Flags, log folders and output are rl_zoo3's own; a run is stored in `logs/<algo>/<env>_<run>/` unless `-f` is given. We
add the algorithms "frontier_grpo", "grpo" and "residual_sac", hyperparameters from `dynaforge.zoo_configs` where they
list the env, worker processes for the DynaForge envs unless `--vec-env` is given, `policy.safetensors` beside the
trained model, which `evaluate` and `collect` accept as `--policy`, and `--trusted`. Scripts that play a model look in
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
    """Run a script of rl_zoo3.

    Args:
        argv: Script and flags; by default the arguments of this process.

    Raises:
        SystemExit: The script, env, algorithm or configuration file is unknown, a checkpoint is not trusted, or rl_zoo3
            is missing; the message is one line.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] not in SCRIPTS:
        given = repr(arguments[0]) if arguments else "nothing"
        known = f"{', '.join(map(repr, SCRIPTS[:-1]))} or {SCRIPTS[-1]!r}"
        raise SystemExit(f"dynaforge: expected {known} and its flags, was given {given}")
    script, *flags = arguments
    options = _parse(script, flags)
    flags = [flag for flag in flags if not (flag[:3] == "--t" and "--trusted".startswith(flag))]
    return _plot(script, flags, options) if script in PLOTTERS else _work(script, flags, options)


def _work(script: str, flags: list[str], options: argparse.Namespace) -> int:
    """Run a script that trains or plays a model."""
    if not options.help:
        flags = flags + _checked(script, flags, options)
    if script in PLAYERS and options.folder is None:
        flags = [*flags, "-f", "logs"]
    register_with_zoo()
    config = None
    if not options.help:
        check_env(options.env)  # again, since rl_zoo3 has registered envs of other packages
        if script == "train":
            check_statistics(options)
            config = config_file(options.algo, options.env) if options.conf_file is None else None
    if config is not None:
        flags = [*flags, "--conf-file", str(config)]
    own_env = options.env.startswith("DynaForge/")
    own_workers = own_env and options.vec_env is None
    process = _zoo_process(script, flags, own_env=own_env, own_workers=own_workers, config=config)
    with worker_environment(), process:
        _run(script)
    return 0


def _checked(script: str, flags: list[str], options: argparse.Namespace) -> list[str]:
    """Check what can be checked before rl_zoo3 is imported, and return the flags that name the env to rl_zoo3.

    Raises:
        SystemExit: The first mistake, in one line.
    """
    check_algorithm(options.algo)
    check_trust(script, options)
    more = _name_env(script, options)
    with one_line(script):
        check_flags(script, options, named_env=options.env_given is not None)
    if options.env.startswith("DynaForge/"):
        check_env(options.env)
    check_display(script, options, [*flags, *more])
    with one_line(script):
        if options.conf_file is not None:
            check_configuration(options.conf_file, options.env)
    return more


def _parse(script: str, flags: list[str]) -> argparse.Namespace:
    """Parse the flags; rl_zoo3 parses them again, with its own defaults and help.

    Raises:
        SystemExit: A flag is unknown or its value is wrong; the message names it.
    """
    wants_help = bool({"-h", "--help"} & set(flags))
    with one_line(script):
        try:
            parser = zoo_parser(script, complete=not wants_help)
        except ModuleNotFoundError:
            register_with_zoo()  # raises with the name of the missing package
            raise
        options: argparse.Namespace = parser.parse_args(["--help"] if wants_help else flags)
    if script not in PLOTTERS:
        options.env_given, options.env, options.algo = options.env, options.env or "CartPole-v1", options.algo or "ppo"
        options.folder = options.log_folder if script == "train" else options.folder
    for name, default in (("conf_file", None), ("trained_agent", ""), ("vec_env", None), ("gym_packages", [])):
        setattr(options, name, getattr(options, name, None) or default)
    return options


def _name_env(script: str, options: argparse.Namespace) -> list[str]:
    """Resolve the env that was given, and return the flags that name it to rl_zoo3, which accepts only ids."""
    try:
        import_packages(options.gym_packages)
        env = named_env(options.env)
    except ValueError as error:
        raise SystemExit(f"dynaforge {script}: {error}") from error
    changed, options.env = env != options.env, env
    return ["--env", env] if changed else []


@contextmanager
def _zoo_process(
    script: str, flags: list[str], *, own_env: bool, own_workers: bool, config: Path | None
) -> Iterator[None]:
    """Replace parts of rl_zoo3 while one of its scripts runs."""
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


def _plot(script: str, flags: list[str], options: argparse.Namespace) -> int:
    """Run a script that plots; it looks for parts of folder names, in which rl_zoo3 writes "-" instead of "/"."""
    if script == "plot_from_file" and not options.help and not options.trusted:
        raise SystemExit("dynaforge plot_from_file: it unpickles a file of all_plots; add --trusted if it is your own")
    flags = [flag.replace("DynaForge/", "DynaForge-") for flag in flags]
    register_with_zoo()
    with _zoo_process(script, flags, own_env=False, own_workers=False, config=None):
        _run(script)
    return 0


def _run(script: str) -> None:
    """Run one of rl_zoo3's scripts, imported only now since that takes seconds."""
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
