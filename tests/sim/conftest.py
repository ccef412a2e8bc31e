from __future__ import annotations

from collections.abc import Iterator

import pytest

from dynaforge.sim import SimScene
from dynaforge.tasks import get_task


@pytest.fixture(scope="module")
def scene() -> Iterator[SimScene]:
    """The scene of Can, one for all tests of a file."""
    scene = SimScene(get_task("can").scene)
    yield scene
    scene.close()
