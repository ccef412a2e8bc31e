from __future__ import annotations

from collections.abc import Callable

import pytest

from dynaforge.options.numbers import Number, WholeNumber, minutes, shard


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        (WholeNumber(0), "007", 7),
        (WholeNumber(-5), "-5", -5),
        (WholeNumber(), "+3", 3),
        (WholeNumber(0, 2**32 - 1), "4294967295", 2**32 - 1),
        (Number(), "-1.5e-3", -0.0015),
        (Number(0.0), "0", 0.0),
        (Number(above=0.0), ".5", 0.5),
        (Number(), "3.", 3.0),
        (minutes, "90s", 1.5),
        (minutes, "1.5h", 90.0),
        (minutes, "10", 10.0),
        (shard, "0/1", (0, 1)),
    ],
)
def test_numbers_are_read(kind: Callable[[str], object], text: str, value: object) -> None:
    assert kind(text) == value
