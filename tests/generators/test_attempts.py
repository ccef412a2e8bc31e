from __future__ import annotations

import itertools
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from faulty import Faulty, Unmade

from dynaforge.generators import NoWorkers, PlannerOnly, Result, attempt_once, run_attempts
from dynaforge.sim import Condition
from dynaforge.tasks import get_task

TASK = get_task("can")
SPACE = TASK.conditions
CONDITIONS = list(itertools.islice(SPACE.stream("val", n_strata=8), 6))


def ids(*indices: int) -> frozenset[str]:
    return frozenset(CONDITIONS[k].id for k in indices)


def attempt_all(generator: Faulty, *, workers: int = 2) -> list[Result]:
    return list(run_attempts(TASK, generator, CONDITIONS, workers=workers, block=7))


def test_an_exception_is_a_failed_attempt_with_its_reason_and_the_order_stays() -> None:
    """The first condition is the slowest: its result still comes first."""
    results = attempt_all(Faulty(raises=ids(1, 4), slow=ids(0)))
    assert [r.attempt.condition for r in results] == CONDITIONS
    assert [r.attempt.success for r in results] == [True, False, True, True, False, True]
    assert results[1].attempt.failure == "exception: RuntimeError: the marked condition"
    assert results[1].episode is None
    assert results[0].episode is not None
    assert {r.attempt.block for r in results} == {7}
    assert {r.attempt.generator for r in results} == {"faulty"}
    assert all(r.attempt.wall_seconds > 0.0 for r in results)


def test_an_attempt_knows_the_processor_time_that_it_took_even_if_it_raised() -> None:
    class Busy:
        name = "busy"

        def attempt(self, env: Any, condition: Condition) -> Any:
            time.sleep(0.2)
            begin = time.process_time()
            while time.process_time() < begin + 0.1:
                pass
            raise RuntimeError

    attempt = attempt_once(None, Busy(), CONDITIONS[0]).attempt
    assert attempt.cpu_seconds is not None
    assert 0.1 <= attempt.cpu_seconds < 0.2  # what it slept is no processor time
    assert attempt.wall_seconds >= 0.3


def test_a_generator_that_cannot_be_made_in_the_workers_says_why() -> None:
    with pytest.raises(NoWorkers, match="RuntimeError: no weights for can"):
        list(run_attempts(TASK, Unmade(), CONDITIONS[:1], workers=1))


def test_an_attempt_that_ends_the_program_is_a_failed_attempt() -> None:
    assert "SystemExit" in attempt_once(None, Unmade(), CONDITIONS[0]).attempt.failure


def test_a_dead_worker_is_a_failed_attempt_and_the_others_go_on() -> None:
    results = attempt_all(Faulty(dies=ids(2)), workers=1)
    assert [r.attempt.condition for r in results] == CONDITIONS
    assert [r.attempt.success for r in results] == [True, True, False, True, True, True]
    assert results[2].attempt.failure.startswith("worker lost")


def test_a_dead_worker_costs_no_other_condition_its_attempt() -> None:
    results = attempt_all(Faulty(dies=ids(1), slow=ids(0)))
    assert [r.attempt.success for r in results] == [True, False, True, True, True, True]


def test_a_worker_that_dies_while_the_caller_is_busy_does_not_end_the_run() -> None:
    results = []
    for result in run_attempts(TASK, Faulty(dies=ids(1)), CONDITIONS, workers=1):
        results.append(result)
        if len(results) == 1:
            time.sleep(1.0)  # as when an episode is written
    assert [r.attempt.success for r in results] == [True, False, True, True, True, True]


def test_attempts_in_workers_are_those_of_this_process() -> None:
    from dynaforge.envs.residual_env import ResidualEnv

    env = ResidualEnv("can")
    here = [PlannerOnly().attempt(env, condition) for condition in CONDITIONS[:3]]
    env.close()
    there = [result.episode for result in run_attempts(TASK, PlannerOnly(), CONDITIONS[:3], workers=1)]
    assert [e.content_hash() for e in there if e] == [e.content_hash() for e in here]


@pytest.mark.slow
def test_a_script_that_workers_cannot_import_is_reported(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from itertools import islice\nfrom dynaforge.generators import PlannerOnly, run_attempts\n"
        "from dynaforge.tasks import get_task\ntask = get_task('can')\n"
        "list(run_attempts(task, PlannerOnly(), islice(task.conditions.stream('val'), 2), workers=1))\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "needs `if __name__ == '__main__':` around" in done.stderr.splitlines()[-1]
