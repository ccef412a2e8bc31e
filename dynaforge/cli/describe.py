"""`dynaforge list` and `dynaforge describe`: what the task data says."""

from __future__ import annotations

import argparse

from dynaforge.registration import env_id
from dynaforge.tasks import TASK_NAMES, Task, get_task


def add_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Add the options of `list` or `describe`."""
    if command == "describe":
        parser.add_argument("task", help=f"one of {', '.join(TASK_NAMES)}")


def run(options: argparse.Namespace) -> int:
    """Print one task, or all of them a line each."""
    if "task" in options:
        print(description(get_task(options.task)))
        return 0
    for name in TASK_NAMES:
        task = get_task(name)
        print(f"{name:<12} {env_id(name):<24} {task.skill:<16} {task.goal}")
    return 0


def description(task: Task) -> str:
    """Return a page about a task, Markdown, made from its data alone."""
    lines = [f"# {task.env_name}: {task.skill}", "", f"Env id `{env_id(task.name)}`.", ""]
    lines += [f"**Motion.** {task.motion}", "", f"**Randomisation.** {task.randomisation}", ""]
    lines += [
        f"**Success.** {task.goal}",
        "",
        "| phase | mode | residual | timeout | fails with |",
        "|---|---|---|---|---|",
    ]
    for phase in task.phases:
        gate = "on" if phase.gate else "-"
        lines.append(f"| {phase.name} | {phase.mode} | {gate} | {phase.timeout:g} s | {phase.failure} |")
    lines += ["", "| condition | from | to |", "|---|---|---|"]
    for name, (low, high) in task.conditions.ranges.items():
        mark = " (difficulty)" if name == task.conditions.difficulty else ""
        lines.append(f"| {name}{mark} | {low:.4g} | {high:.4g} |")
    scales = ", ".join(f"{value:g}" for value in task.residual.scales)
    lines += ["", f"Residual scales (x, y, z in m; rotation x, y, z in rad; width in m): {scales};"]
    lines.append(f"{task.residual.frame} frame, one decision every {task.residual.decision_steps} control steps.")
    return "\n".join(lines)
