"""All commands by name, in the order of `dynaforge --help`."""

from __future__ import annotations

from dynaforge.cli.arguments import (
    bench,
    collect,
    compare,
    describe,
    evaluate,
    export,
    forge,
    info,
    render,
    report,
    table1,
    table2,
    verify,
    view,
)

COMMANDS = {
    "forge": forge.COMMAND,
    "list": describe.LIST,
    "describe": describe.COMMAND,
    "evaluate": evaluate.COMMAND,
    "collect": collect.COMMAND,
    "info": info.COMMAND,
    "render": render.COMMAND,
    "view": view.COMMAND,
    "export": export.COMMAND,
    "verify": verify.COMMAND,
    "compare": compare.COMMAND,
    "table1": table1.COMMAND,
    "table2": table2.COMMAND,
    "report": report.COMMAND,
    "bench": bench.COMMAND,
}
"""Commands with arguments of our own."""

ZOO = {
    "train": "rl_zoo3's train, with FrontierGRPO and the DynaForge envs registered",
    "enjoy": "rl_zoo3's enjoy: play a trained policy",
    "record_video": "rl_zoo3's record_video: an MP4 of it",
    "record_training": "rl_zoo3's record_training: an MP4 of all its checkpoints",
    "plot_train": "rl_zoo3's plot_train: reward, length or success in training",
    "all_plots": "rl_zoo3's all_plots: evaluations of several runs",
    "plot_from_file": "rl_zoo3's plot_from_file: what all_plots has stored",
}
"""Commands of rl_zoo3, which parses their arguments."""
