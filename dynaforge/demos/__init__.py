"""Demonstrations: episodes, their files, the ledger of attempts, datasets."""

from dynaforge.demos.dataset import DemonstrationDataset
from dynaforge.demos.episode import Attempt, Episode
from dynaforge.demos.ledger import Ledger
from dynaforge.demos.untrusted import DamagedFileError

__all__ = [
    "Attempt",
    "DamagedFileError",
    "DemonstrationDataset",
    "Episode",
    "Ledger",
]
