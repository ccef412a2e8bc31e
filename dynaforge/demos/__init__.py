"""Demonstrations: episodes, their files, the ledger of attempts, datasets."""

from dynaforge.demos.dataset import DemonstrationDataset
from dynaforge.demos.episode import Episode
from dynaforge.demos.ledger import Attempt, Ledger
from dynaforge.demos.untrusted import DamagedFileError

__all__ = [
    "Attempt",
    "DamagedFileError",
    "DemonstrationDataset",
    "Episode",
    "Ledger",
]
