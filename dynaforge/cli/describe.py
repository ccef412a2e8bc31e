"""`dynaforge list` and `dynaforge describe`: what the task data says."""

from __future__ import annotations

import argparse
from itertools import islice
from pathlib import Path

from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.files.atomic import atomic_write
from dynaforge.registration import ENV_NAMES, env_id
from dynaforge.tasks import Task, get_task


def run(options: argparse.Namespace) -> int:
    """Print one task, or all of them a line each; with `--out`, write pages and pictures."""
    if "task" not in options:
        for name in ENV_NAMES:
            task = get_task(name)
            print(f"{name:<12} {env_id(name):<24} {task.skill:<16} {task.goal}")
        return 0
    tasks = chosen_tasks(options)
    if options.out is not None:
        return _write(tasks, options.out)
    print("\n\n".join(description(task) for task in tasks))
    return 0


def description(task: Task) -> str:
    """Return a page about a task, Markdown, made from its data alone."""
    lines = [f"# {task.env_name}: {task.skill}", "", f"Env id `{env_id(task.name)}`.", ""]
    lines += [f"**Motion.** {task.motion}", "", f"**Randomisation.** {task.randomisation}", ""]
    lines += [f"**Success.** {task.goal}", "", f"**In words.** {task.instruction}", ""]
    lines += ["| phase | mode | residual | timeout | fails with |", "|---|---|---|---|---|"]
    for phase in task.phases:
        gate = (
            f"x {phase.residual_share:g}" if phase.gate and phase.residual_share != 1 else "on" if phase.gate else "-"
        )
        reasons = ", ".join(dict.fromkeys((phase.failure, *(reason for reason, _ in phase.fails))))
        lines.append(f"| {phase.name} | {phase.mode} | {gate} | {phase.timeout:g} s | {reasons} |")
    always = ", ".join(dict.fromkeys(reason for reason, _ in task.endings))
    lines += ["", f"In every phase it may fail with: {always}.", ""]
    lines += ["| condition | from | to | unit |", "|---|---|---|---|"]
    for name, (low, high) in task.conditions.ranges.items():
        mark = " (difficulty)" if name == task.conditions.difficulty else ""
        unit = task.conditions.units.get(name, "")
        lines.append(f"| {name}{mark} | {low:.4g} | {high:.4g} | {unit or '-'} |")
    scales = ", ".join(f"{value:g}" for value in task.residual.scales)
    lines += ["", f"Residual scales (x, y, z in m; rotation x, y, z in rad; width in m): {scales};"]
    lines.append(f"{task.residual.frame} frame, one decision every {task.residual.decision_steps} control steps.")
    return "\n".join(lines)


def page_with_picture(task: Task) -> str:
    """Return the page as a file: the picture, which lies beside it, below the headline."""
    head, _, rest = description(task).partition("\n")
    return f"{head}\n\n![{task.env_name}]({task.name}.png)\n{rest}\n"


def _write(tasks: list[Task], folder: Path) -> int:
    from dynaforge.reports import contact_sheet, encode_png
    from dynaforge.reports.film import skill_picture

    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    for task in tasks:
        picture = skill_picture(task, islice(task.conditions.stream("val", n_strata=8), 64))
        pictures.append(picture)
        atomic_write(folder / f"{task.name}.png", encode_png(picture))
        atomic_write(folder / f"{task.name}.md", page_with_picture(task).encode())
        print(f"written to {folder / task.name}.md")
    if len(tasks) > 1:
        labels = [f"{task.env_name}: {task.skill}" for task in tasks]
        atomic_write(folder / "tasks.png", contact_sheet(pictures, labels, columns=3))
        print(f"written to {folder / 'tasks.png'}")
    return 0
