"""The commands: what each does, takes and is called like."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from dynaforge.cli import arguments, dataset_arguments
from dynaforge.cli.task_arguments import chosen_tasks
from dynaforge.options.values import Parser
from dynaforge.training.forge_folder import default_folder


def _nothing(_: argparse.ArgumentParser | argparse.Namespace) -> None:
    """Add no argument; find no fault."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command with arguments of its own.

    Attributes:
        text: What it does, in one line.
        examples: Command lines that teach, without "dynaforge".
        add: Adds its arguments to a parser.
        check: Looks at the arguments together.
        out: What --out is where it is not given, seen to be as good as if it had been.
        module: Of `dynaforge.cli`, where its `run` is; "" where the name is the command's.
    """

    text: str
    examples: tuple[str, ...]
    add: Callable[[argparse.ArgumentParser], None] = field(default=_nothing, kw_only=True)
    check: Callable[[argparse.Namespace], None] = field(default=_nothing, kw_only=True)
    out: Callable[[argparse.Namespace], str | Path] | None = field(default=None, kw_only=True)
    module: str = field(default="", kw_only=True)

    def parser(self, name: str) -> Parser:
        """Return the parser of its arguments."""
        examples = [f"dynaforge {line}" for line in self.examples]
        parser = Parser(prog=f"dynaforge {name}", description=f"{self.text}.", examples=examples)
        self.add(parser)
        return parser

    def read(self, name: str, arguments: Sequence[str]) -> argparse.Namespace:
        """Return the options that arguments mean, each alone and all together as they must be.

        Raises:
            ValueError: They are not; the message names the option.
        """
        parser = self.parser(name)
        options: argparse.Namespace = parser.parse_args(arguments)
        if "task" in options:
            chosen_tasks(options)
        if "folder" in options:
            dataset_arguments.open_dataset(options)
        self.check(options)
        if self.out is not None and options.out is None:
            options.out = parser.parse_args([f"--out={self.out(options)}", *arguments]).out
        return options


COMMANDS = {
    "forge": Command(
        "from nothing to demonstrations: measure the prior, train, measure again, collect, report",
        ("forge --task can", "forge --task peach --budget 30m --demos 200 --out runs/peach"),
        add=arguments.forge,
        check=arguments.check_forge,
        out=default_folder,
    ),
    "list": Command("the tasks", ("list",), module="describe"),
    "describe": Command(
        "one task: motion, randomisation, phases, success",
        ("describe can", "describe all --out docs/tasks"),
        add=arguments.describe,
    ),
    "evaluate": Command(
        "demonstration generation rate of a generator on stored condition streams",
        (
            "evaluate --task can --generator planner_only residual",
            "evaluate --task all --stream test --attempts 200",
            "evaluate --task can --learner my_policy.py:load",
        ),
        add=arguments.evaluate,
        check=arguments.check_evaluate,
        out=lambda options: f"runs/evaluate/{'+'.join(options.generator)}-{options.stream}.json",
    ),
    "collect": Command(
        "demonstrations into a folder, on all cores; resumes",
        ("collect --task can --demos 100", "collect --task peach --policy runs/peach/policy.safetensors --shard 0/4"),
        add=arguments.collect,
        check=arguments.check_collect,
        out=arguments.collecting_folder,
    ),
    "info": Command(
        "what a folder of demonstrations holds: rates, lengths, ranges, size",
        ("info data/can",),
        add=dataset_arguments.on_dataset,
    ),
    "render": Command(
        "pictures and point clouds of collected episodes, in a second pass; resumes",
        ("render data/can", "render data/can --cameras front --size 84 84 --points 1024"),
        add=dataset_arguments.render,
        check=dataset_arguments.check_render,
        out=lambda options: options.folder / "observations",
    ),
    "view": Command(
        "one HTML page to look through a folder of demonstrations: clips, plots, filters",
        ("view data/can", "view data/can --no-clips --limit 200 --out can.html"),
        add=dataset_arguments.view,
        check=dataset_arguments.check_view,
        out=lambda options: options.folder / "view.html",
    ),
    "export": Command(
        "demonstrations as LeRobot, robomimic, DP3's zarr or Minari data, with a card",
        ("export data/can --format lerobot", "export data/can --format robomimic --actions joint --out can-robomimic"),
        add=dataset_arguments.export,
        check=dataset_arguments.check_export,
        out=lambda options: (folder := options.folder.resolve()).with_name(f"{folder.name}-{options.format}"),
    ),
    "verify": Command(
        "check a folder of demonstrations: bytes, values, outcomes; --replay simulates them again",
        ("verify data/can", "verify data/can --replay --audit"),
        add=dataset_arguments.verify,
    ),
    "compare": Command(
        "train several algorithms on the same tasks and seeds, measure and report; resumes",
        ("compare --task can --algos grpo frontier_grpo", "compare --algos grpo --vary learning_rate 5e-4 1e-3"),
        add=arguments.compare,
        check=arguments.check_compare,
    ),
    "bench": Command(
        "the project's figures: speed, determinism, limits",
        ("bench", "bench --only reset control-steps --rounds 9 --out results/bench.json"),
        add=arguments.bench,
    ),
}
"""Commands with arguments of our own, by name."""

ZOO = {
    "train": "rl_zoo3's train, with FrontierGRPO and the DynaForge envs registered",
    "enjoy": "rl_zoo3's enjoy: play a trained policy",
    "record_video": "rl_zoo3's record_video: an MP4 of it",
    "record_training": "rl_zoo3's record_training: an MP4 of all its checkpoints",
    "plot_train": "rl_zoo3's plot_train: reward, length or success in training",
    "all_plots": "rl_zoo3's all_plots: evaluations of several runs",
    "plot_from_file": "rl_zoo3's plot_from_file: what all_plots has stored",
}
"""Commands of rl_zoo3, which reads their arguments."""
