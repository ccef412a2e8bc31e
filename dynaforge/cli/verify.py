"""`dynaforge verify`: is every byte, value, outcome and, with --replay, every bit of physics as it was recorded?"""

from __future__ import annotations

import argparse

from tqdm import tqdm

from dynaforge.cli.dataset_arguments import open_dataset
from dynaforge.demos.replay import Replayer
from dynaforge.demos.verification import verify
from dynaforge.generators.repeat import Repeater


def run(options: argparse.Namespace) -> int:
    """Check and print every finding; returns 1 when there is any."""
    dataset, task = open_dataset(options)
    again = Repeater(task) if options.replay else None
    replayer = Replayer(task) if options.replay else None
    n, found = len(dataset), 0
    for findings in tqdm(
        verify(dataset, task=task, again=again, replayer=replayer, audited=options.audit),
        total=n + 1,
        leave=False,
        unit="file",
    ):
        for finding in findings:
            tqdm.write(str(finding))
        found += len(findings)
    how = "read and simulated again" if options.replay else "read"
    print(f"{n} episodes {how}, {len(dataset.ledger.attempts())} attempts in the ledger: {found or 'no'} problems")
    return 1 if found else 0
