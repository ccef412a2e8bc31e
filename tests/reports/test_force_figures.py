from __future__ import annotations

from dataclasses import replace

import pytest

from dynaforge.demos import Attempt
from dynaforge.reports.forces import describe_peaks, describe_reflex, force_lines
from dynaforge.sim import Condition
from dynaforge.sim.loads import Loads
from dynaforge.sim.setting import Reflex
from dynaforge.tasks import Outcome, get_task

SOFT = Loads(peak_force=12.0, force=8.0, contact=0.08, standard=0.2, strict=0.4)
FIRM = Loads(peak_force=90.0, force=44.0, contact=0.44, standard=1.1, strict=2.2)


def attempt(seed: int, loads: Loads | None) -> Attempt:
    outcome = Outcome(success=True, checkpoint=5, phase="lift")
    return Attempt(
        condition=Condition("can", seed, 0.3, {}), generator="planner_only", outcome=outcome, duration=1.0, loads=loads
    )


def test_each_demonstration_has_its_peaks_and_what_they_exceed_the_hardest_first() -> None:
    soft, firm, old = attempt(0, SOFT), attempt(1, FIRM), attempt(2, None)
    lines = force_lines([soft, old, firm], get_task("can"))
    assert lines[2:5] == [
        f"  {firm.id}:  90.0 N,  44.0 N; exceeds standard, strict",
        f"  {soft.id}:  12.0 N,   8.0 N; exceeds none",
        f"  {old.id}: not recorded",
    ]
    assert lines[5] == (
        "3 demonstrations: median 51 N, 90 % 82 N, greatest 90 N in a substep; "
        "median 26 N, 90 % 40 N, greatest 44 N as the mean of two control steps; "
        "contact would stop 0 of 2, standard would stop 1 of 2, strict would stop 1 of 2; "
        "not recorded in 1"
    )
    assert force_lines([], get_task("can")) == []


@pytest.mark.parametrize(
    ("reflex", "told"),
    [("contact", "contact"), ("strict", "strict"), (50.0, "standard"), (10.0, ""), ("off", "contact")],
)
def test_only_thresholds_within_the_reflex_of_the_demonstrations_are_told(reflex: Reflex, told: str) -> None:
    """After the robot stopped, what would have come is not known."""
    stopped = [
        name for name in ("contact", "standard", "strict") if f"{name} would stop" in describe_peaks([SOFT], reflex)
    ]
    assert stopped[:1] == ([told] if told else [])
    lines = force_lines([attempt(0, replace(SOFT))], get_task("can").under(reflex=reflex))
    assert lines[1].endswith(", ".join(stopped) or "none that is named")


def test_a_reflex_is_described_by_its_thresholds() -> None:
    assert describe_reflex("standard").startswith(
        "standard: above 40 N or 35 Nm on the hand, or 24 to 35 Nm at a joint"
    )
    assert describe_reflex(50.0).startswith("above 50 N or 100 Nm on the hand, or 100 Nm at a joint")
    assert describe_reflex("off") == "off: no force stops the robot"
    assert describe_peaks([None], "off") == "not recorded"
