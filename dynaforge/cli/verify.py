"""`dynaforge verify`: is every byte, value, outcome and, with --replay, every attempt as it was recorded?"""

from __future__ import annotations

import argparse
from itertools import chain

from tqdm import tqdm

from dynaforge.cli.arguments.datasets import open_dataset
from dynaforge.demos.folder_checks import read_notes, verify_folder
from dynaforge.generators.recording_checks import VerifyOptions, check_recordings


def run(options: argparse.Namespace) -> int:
    """Check and print every finding; returns 1 when there is any."""
    dataset, task = open_dataset(options)
    notes, n_findings = read_notes(dataset), 0
    wanted = VerifyOptions(
        folder=options.folder,
        task=task,
        notes=notes,
        replay=options.replay,
        audit=options.audit,
        pictures=options.pictures,
    )
    recordings = check_recordings(wanted, notes.names, workers=wanted.useful_workers(options.workers))
    checked = chain([verify_folder(dataset, notes, task)], recordings)
    for findings in tqdm(checked, total=len(notes.names) + 1, leave=False, unit="file"):
        for finding in findings:
            tqdm.write(str(finding))
        n_findings += len(findings)
    how = "read and made again" if options.replay else "read"
    counts = f"{len(notes.names)} episodes {how}, {len(notes.attempts)} attempts in the ledger"
    print(f"{counts}: {n_findings or 'no'} problems")
    return 1 if n_findings else 0
