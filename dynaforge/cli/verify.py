"""`dynaforge verify`: checks of every byte, value and outcome and, with --replay, of every attempt."""

from __future__ import annotations

import argparse
from itertools import chain

from tqdm import tqdm

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.demos.folder_checks import read_notes, verify_folder
from dynaforge.demos.prescription import describe_dynamics
from dynaforge.generators.recording_checks import VerifyOptions, check_recordings
from dynaforge.reports.forces import force_lines


def run(options: argparse.Namespace) -> int:
    """Print every finding; return 1 when there is any."""
    dataset, task = open_dataset(options)
    notes, n_findings = read_notes(dataset), 0
    checks = VerifyOptions(
        folder=options.folder,
        task=task,
        notes=notes,
        replay=options.replay,
        audit=options.audit,
        pictures=options.pictures,
    )
    recordings = check_recordings(checks, notes.names, workers=checks.useful_workers(options.workers))
    checked = chain([verify_folder(dataset, notes, task)], recordings)
    for findings in tqdm(checked, total=len(notes.names) + 1, leave=False, unit="file"):
        for finding in findings:
            tqdm.write(str(finding))
        n_findings += len(findings)
    if said := describe_dynamics(attempt.dynamics for attempt in notes.attempts.values()):
        print(f"dynamics: {said}")
    if options.audit:
        demonstrations = [a for name in notes.names if (a := notes.attempts.get(name)) and a.success]
        for line in force_lines(demonstrations, task):
            print(line)
    treatment = "read and made again" if options.replay else "read"
    counts = f"{len(notes.names)} episodes {treatment}, {len(notes.attempts)} attempts in the ledger"
    print(f"{counts}: {n_findings or 'no'} problems")
    return 1 if n_findings else 0
