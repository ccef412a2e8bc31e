"""Pages about tasks, generated from their data, with a picture of each skill."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

from dynaforge.files.atomic import atomic_write
from dynaforge.registration import env_id
from dynaforge.reports.video import contact_sheet, encode_png
from dynaforge.tasks import Task
from dynaforge.tasks.phase import Phase

PICTURE_CONDITIONS = 64  # of `val`, searched for one on which the planner succeeds


def description(task: Task) -> str:
    """Return the page about a task, in Markdown."""
    lines = [f"# {task.env_name}: {task.skill}", "", f"Env id `{env_id(task.name)}`.", ""]
    lines += [f"**Motion.** {task.motion}", "", f"**Randomisation.** {task.randomisation}", ""]
    lines += [f"**Success.** {task.goal}", "", f"**In words.** {task.instruction}", ""]
    lines += ["| phase | mode | residual | timeout | fails with |", "|---|---|---|---|---|"]
    lines += [_phase_row(phase) for phase in task.phases]
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


def _phase_row(phase: Phase) -> str:
    gate = "-"
    if phase.gate:
        gate = "on" if phase.residual_share == 1 else f"x {phase.residual_share:g}"
    reasons = ", ".join(dict.fromkeys((phase.failure, *(reason for reason, _ in phase.fails))))
    return f"| {phase.name} | {phase.mode} | {gate} | {phase.timeout:g} s | {reasons} |"


def page_with_picture(task: Task) -> str:
    """Return the page for a file, with a link to the picture beside it below the headline."""
    head, _, rest = description(task).partition("\n")
    return f"{head}\n\n![{task.env_name}]({task.name}.png)\n{rest}\n"


def write_task_pages(tasks: Sequence[Task], folder: Path) -> Iterator[Path]:
    """Write a page and a picture for each task, and a contact sheet if there are several; yield each when written.

    Args:
        tasks: The tasks.
        folder: Where they are written; made if missing.
    """
    from dynaforge.reports.film import skill_picture  # only here, because a page without a picture needs no physics

    folder.mkdir(parents=True, exist_ok=True)
    pictures = []
    for task in tasks:
        picture = skill_picture(task, islice(task.conditions.stream("val", n_strata=8), PICTURE_CONDITIONS))
        pictures.append(picture)
        atomic_write(folder / f"{task.name}.png", encode_png(picture))
        page = folder / f"{task.name}.md"
        atomic_write(page, page_with_picture(task).encode())
        yield page
    if len(tasks) > 1:
        sheet = folder / "tasks.png"
        labels = [f"{task.env_name}: {task.skill}" for task in tasks]
        atomic_write(sheet, contact_sheet(pictures, labels, columns=3))
        yield sheet
