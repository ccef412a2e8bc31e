"""`dynaforge table1`: the paper's first table, measured pair by pair; an interruption costs only the pair under way."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence

from dynaforge.algos.policy_file import POLICY_FILE
from dynaforge.cli.arguments.setting import chosen_parts, setting_lines
from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.cli.engine import on_ray
from dynaforge.files.atomic import make_folder
from dynaforge.generators import Generator
from dynaforge.generators.by_name import make_generator, setting_line
from dynaforge.generators.measure import Until, ends_when_decided, never
from dynaforge.generators.measurements import Measurement
from dynaforge.generators.names import GRPO
from dynaforge.generators.pairs import Pair
from dynaforge.generators.ray_engine import run_attempts_on_ray
from dynaforge.reports.extras import load_extra
from dynaforge.reports.table1 import RESIDUAL, is_unpaired, reference_of
from dynaforge.reports.table1_files import terminal_text, write_table1
from dynaforge.reports.table1_folder import Refused, note_refused, pair_path, read_table
from dynaforge.tasks import Task
from dynaforge.training.matrix import refuse_links


def run(options: argparse.Namespace) -> int:
    """Measure the pairs that are missing, then print and write the table."""
    load_extra("matplotlib")  # which the picture needs at the end
    started, names = time.monotonic(), [task.name for task in chosen_tasks(options)]
    if not options.report_only:
        measure_missing(options)
    table = read_table(options.out, names, options.generators, sequential=options.sequential)
    print(f"\n{terminal_text(table)}")
    seconds = sum(a.cpu_seconds or a.wall_seconds for found in table.measured.values() for a in found.attempts)
    for path in write_table1(options.out, table, command=options.command, minutes=seconds / 60):
        print(f"written to {path}")
    if not options.report_only:
        print(f"took {(time.monotonic() - started) / 60:.1f} minutes")
    return 0


def measure_missing(options: argparse.Namespace) -> None:
    """Measure what is not stored yet.

    Raises:
        ValueError: As `plan`; or nothing can be measured, or something else is stored. Nothing is measured then.
        GaveUp: A generator only raises, so that there is nothing to measure.
    """
    tasks, out = chosen_tasks(options), options.out
    pairs, refused = plan(tasks, options)
    if not pairs:
        raise ValueError(f"None of the generators does any of the tasks: {'; '.join(refused.values())}")
    for pair in pairs:
        refuse_links(pair.path, out)
        pair.stored()
    engine = run_attempts_on_ray if on_ray(options) else None
    made = [(task, [pair.generator for pair in pairs if pair.task is task]) for task in tasks]
    print(*setting_lines((task.name, setting_line(task, found)) for task, found in made), sep="\n")
    make_folder(out)
    note_refused(out, refused, [task.name for task in tasks], options.generators)
    print(f"{len(pairs)} pairs of generator and task; stored in {out}")
    measured: dict[tuple[str, str], Measurement] = {}
    for pair in pairs:
        until = _until(pair, measured) if options.sequential else never
        found = pair.measure(workers=options.workers, engine=engine, until=until)
        measured[pair.row, pair.task.name] = found
        print(f"{pair.task.name}, {pair.row}: {sum(found.success)} of {len(found.success)} attempts succeed")


def plan(tasks: Sequence[Task], options: argparse.Namespace) -> tuple[list[Pair], Refused]:
    """Return the pairs to measure, task by task, and why the others are not.

    On each task, what the others are compared with comes first where comparisons may end early.

    Raises:
        ValueError: A policy that was given by its folder does not fit its task.
    """
    pairs: list[Pair] = []
    refused: Refused = {}
    for task in tasks:
        made: dict[str, Generator] = {}
        for row in options.generators:
            try:
                made[row] = _generator(row, task, options)
            except _NotDoneError as reason:
                refused[row, task.name] = str(reason)
        first = reference_of([row for row in made if not is_unpaired(row)])
        for row in sorted(made, key=lambda row: row != first) if options.sequential else made:
            path = pair_path(options.out, row, task.name)
            asked = {"stream": options.stream, "blocks": options.seeds, "attempts": options.attempts}
            pairs.append(Pair(task=task, row=row, generator=made[row], path=path, **asked))
    return pairs, refused


class _NotDoneError(ValueError):
    """A generator does not do a task."""


def _generator(row: str, task: Task, options: argparse.Namespace) -> Generator:
    flag, folder = {GRPO: ("--grpo-policies", options.grpo_policies), RESIDUAL: ("--policies", options.policies)}.get(
        row, ("", None)
    )
    policy = None
    if folder is not None:
        places = [folder / task.name / POLICY_FILE]
        if row == GRPO:
            places.append(folder / task.name / GRPO / "seed-0" / POLICY_FILE)
        policy = next((path for path in places if path.is_file()), None)
        if policy is None:
            raise _NotDoneError(f"{folder} has no policy for {task.name}")
    try:
        return make_generator(RESIDUAL if row == GRPO else row, task, policy=policy, chosen=chosen_parts(options))
    except ValueError as error:
        if policy is not None:
            raise ValueError(f"{flag}: {error}") from error
        raise _NotDoneError(str(error)) from error


def _until(pair: Pair, measured: Mapping[tuple[str, str], Measurement]) -> Until:
    """Return what ends a pair early: the test against what was measured first on its task, if both are paired."""
    found = next((other for (_, task), other in measured.items() if task == pair.task.name), None)
    if found is None or is_unpaired(pair.row) or is_unpaired(found.row):
        return never
    return ends_when_decided(found.attempts)
