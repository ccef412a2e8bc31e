from __future__ import annotations

from dynaforge.benchmarks.prefix import shared_prefix


def test_sharing_is_measured_on_rollouts_that_are_the_same() -> None:
    (figure,) = shared_prefix(tasks=("pen",), n_groups=1, group_size=3)
    assert figure.raw["equal"] == 3
    seconds = figure.raw["cpu_seconds"]["pen"]
    assert 0.0 < seconds["shared"] < seconds["alone"]
