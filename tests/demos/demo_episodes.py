"""Small episodes for the tests of this folder."""

from __future__ import annotations

import numpy as np

from dynaforge.demos import Episode
from dynaforge.sim import Condition
from dynaforge.tasks import Outcome


def make_episode(seed: int = 0, *, success: bool = True, task: str = "can", steps: int = 20) -> Episode:
    rng = np.random.default_rng(seed)
    condition = Condition(task, seed, 0.4, {"speed": 0.4})
    recorded = {
        "time": np.arange(steps) / 30.0,
        "q": rng.normal(size=(steps, 7)),
        "gate": rng.random(steps) < 0.5,
        "phase": np.zeros(steps, dtype=int),
        "object/can/position": rng.normal(size=(steps, 3)),
        "planner_action": rng.normal(size=(steps, 8)),
        "requested_action": rng.normal(size=(steps, 8)),
    }
    failure = "" if success else "timeout in close"
    meta = {"phases": ["track", "close"], "versions": {"numpy": np.__version__}, "policy_hash": "p", "task_hash": "t"}
    outcome = Outcome(success=success, checkpoint=4 if success else 2, failure=failure, phase="lift")
    return Episode(condition=condition, generator="planner", outcome=outcome, duration=0.66, steps=recorded, meta=meta)
