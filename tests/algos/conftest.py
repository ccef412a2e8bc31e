from __future__ import annotations

import pytest
from stable_baselines3.common.logger import configure


@pytest.fixture
def logged(tmp_path):
    """Return a function that gives a model a logger and hands back the values logged at the last dump."""

    def attach(model) -> dict:
        logger = configure(str(tmp_path), [])
        values = {}
        dump = logger.dump
        logger.dump = lambda step=0: (values.update(logger.name_to_value), dump(step))
        model.set_logger(logger)
        return values

    return attach
