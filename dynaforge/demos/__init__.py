"""Demonstrations: episodes, their files, the ledger of attempts, datasets."""

from dynaforge.demos.dataset import DemonstrationDataset
from dynaforge.demos.episode import Episode, episode_id
from dynaforge.demos.episode_file import read_episode, write_episode
from dynaforge.demos.ledger import Attempt, Ledger
from dynaforge.demos.schema import SCHEMA, Field, schema_markdown
from dynaforge.demos.untrusted import DamagedFileError

__all__ = [
    "SCHEMA",
    "Attempt",
    "DamagedFileError",
    "DemonstrationDataset",
    "Episode",
    "Field",
    "Ledger",
    "episode_id",
    "read_episode",
    "schema_markdown",
    "write_episode",
]
