"""`dynaforge compare`: train arms on tasks with several seeds, measure all on the same conditions, report."""

from __future__ import annotations

import argparse
import json
import queue
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tqdm import tqdm

from dynaforge.cli.arguments.tasks import chosen_tasks
from dynaforge.registration import env_id
from dynaforge.reports import write_comparison
from dynaforge.tasks import task_source
from dynaforge.training import model as training
from dynaforge.training.comparison import Comparison
from dynaforge.training.forge_folder import make_folder
from dynaforge.training.run import END_WITH_STDIN, Exam, RunSpec
from dynaforge.training.settings import arms
from dynaforge.training.varied import parsed_value


def run(options: argparse.Namespace) -> int:
    """Run what is missing, then write table and report."""
    specs = matrix(options)
    if options.report_only and not any(spec.finished for spec in specs):
        raise ValueError(
            f"--report-only finds none of these runs finished in {options.out}; leave it out to start them."
        )
    for spec in specs:
        _refuse_links(spec.folder, options.out)
        spec.check()
    make_folder(options.out)
    missing = [spec for spec in specs if not spec.finished]
    print(f"{len(specs)} runs, {len(specs) - len(missing)} finished; stored in {options.out}")
    complete = not missing
    if missing and not options.report_only:
        complete = Crew(missing, options.workers, seconds=60 * (options.budget or float("inf"))).work()
    comparison = Comparison.load(options.out, [spec.folder for spec in specs if spec.finished])
    if not comparison.runs:
        print("nothing is finished yet, so there is nothing to report")
        return 1
    date = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    page = write_comparison(options.out, comparison, command=options.command, date=date)
    print(f"\n{comparison.table()}\n")
    print(f"report {page}")
    if not complete and not options.report_only:
        print("not finished: the same command goes on where it stopped")
    return 0 if complete or options.report_only else 1


def matrix(options: argparse.Namespace) -> list[RunSpec]:
    """Spell out the runs, seed by seed, so that what is finished at any moment compares.

    Raises:
        ValueError: Something unknown or out of range, said before any run is started.
    """
    tasks = {task.name: task_source(task) for task in chosen_tasks(options)}
    exam = Exam(options.stream, options.seeds, options.attempts)
    known = arms()
    crew: dict[str, tuple[str, dict[str, Any]]] = {}
    for arm in options.algos:
        settings = dict(known[arm])
        algo = settings.pop("config")
        for name, changes in _varied(arm, settings, options.vary):
            crew[name] = (algo, changes)
    for algo, changes in crew.values():
        try:
            _check_settings(algo, changes, next(iter(tasks)))
        except ValueError as error:
            raise ValueError(f"--vary: {error}" if options.vary else str(error)) from error
    specs = [
        RunSpec(source, "planner_only", "", {}, 0, 0, exam, options.out / name / "planner_only")
        for name, source in tasks.items()
    ]
    for seed in range(options.train_seeds):
        for name, source in tasks.items():
            for arm, (algo, changes) in crew.items():
                folder = options.out / name / arm / f"seed-{seed}"
                specs.append(RunSpec(source, arm, algo, changes, seed, int(options.steps), exam, folder))
    return specs


def _refuse_links(folder: Path, out: Path) -> None:
    """Refuse to write through links of a folder that may be a stranger's: they lead anywhere.

    Raises:
        ValueError: Names the link.
    """
    below = folder.relative_to(out).parts
    for depth in range(1, len(below) + 1):
        path = out.joinpath(*below[:depth])
        if path.is_symlink():
            raise ValueError(
                f"{path} is a link, and runs are not written through one. Remove it, or choose another --out."
            )


def _varied(arm: str, settings: dict[str, Any], vary: Sequence[str] | None) -> list[tuple[str, dict[str, Any]]]:
    if not vary:
        return [(arm, settings)]
    setting, *values = vary
    return [(f"{arm}+{setting}={value}", settings | {setting: parsed_value(value)}) for value in values]


def _check_settings(algo: str, changes: dict[str, Any], task: str) -> None:
    """Build the model once, on a single env.

    Raises:
        ValueError: A setting that the algorithm does not know or refuses.
    """
    import gymnasium as gym

    env = gym.make(env_id(task))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # PPO's batch does not suit a single env
            training.build_model(task, env, algo=algo, **changes)
    except (TypeError, AssertionError) as error:  # SB3 asserts that a schedule is one
        raise ValueError(f"{algo} with {changes}: {str(error).rstrip('.')}.") from error
    finally:
        env.close()


class Crew:
    """Processes that make runs, as many at a time as there are cores.

    Args:
        specs: Runs to make, in order.
        size: Processes at a time.
        seconds: Wall time after which they are stopped; what is stored stays.
    """

    def __init__(self, specs: Sequence[RunSpec], size: int, *, seconds: float) -> None:
        self._waiting = list(specs)
        self._size = size
        self._deadline = time.monotonic() + seconds
        self._news: queue.Queue[tuple[RunSpec, dict[str, Any] | None]] = queue.Queue()
        self._running: dict[str, tuple[RunSpec, subprocess.Popen[str]]] = {}
        self._steps: dict[str, int] = {}
        self._texts: dict[str, str] = {}
        self._lost: list[str] = []

    def work(self) -> bool:
        """Make the runs.

        Returns:
            Whether all were finished: not when the time was up, at Ctrl-C, or when a run failed.
        """
        total, n_runs, finished = sum(spec.steps for spec in self._waiting), len(self._waiting), 0
        with tqdm(total=total, unit="step", unit_scale=True, smoothing=0.02, dynamic_ncols=True, mininterval=1) as bar:
            try:
                while self._waiting or self._running:
                    while self._waiting and len(self._running) < self._size:
                        self._start(self._waiting.pop(0))
                    try:
                        spec, news = self._news.get(timeout=min(5.0, max(0.0, self._deadline - time.monotonic())))
                    except queue.Empty:
                        if time.monotonic() >= self._deadline:
                            return False
                        continue
                    if news is None:
                        finished += self._end(spec, bar)
                    else:
                        self._hear(spec, news, bar)
                    bar.set_description_str(f"{finished} of {n_runs} runs", refresh=False)
                    bar.set_postfix_str(" | ".join(self._texts.values()), refresh=False)
                    bar.update(0)
            except KeyboardInterrupt:
                return False
            finally:
                self._stop()
        for line in self._lost:
            print(line, file=sys.stderr)
        return not self._lost

    def _start(self, spec: RunSpec) -> None:
        spec.folder.mkdir(parents=True, exist_ok=True)
        path = spec.folder / "log.txt"
        path.unlink(missing_ok=True)  # a link would lead out of the folder, which may be a stranger's
        with path.open("x") as log:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "dynaforge.training.run", spec.to_json(), END_WITH_STDIN],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, start_new_session=True,
            )  # fmt: skip
        self._running[str(spec.folder)] = spec, process
        threading.Thread(target=self._listen, args=(spec, process), daemon=True).start()

    def _listen(self, spec: RunSpec, process: subprocess.Popen[str]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        with process.stdin, process.stdout as lines:
            for line in lines:
                if line.startswith("{"):
                    self._news.put((spec, json.loads(line)))
        self._news.put((spec, None))

    def _hear(self, spec: RunSpec, news: dict[str, Any], bar: Any) -> None:
        key = str(spec.folder)
        steps = news.get("steps", self._steps.get(key, 0))
        bar.update(steps - self._steps.get(key, 0))
        self._steps[key] = steps
        self._texts[key] = f"{Path(spec.task).stem}/{spec.arm}/{spec.seed} {news['text']}"

    def _end(self, spec: RunSpec, bar: Any) -> bool:
        _, process = self._running.pop(str(spec.folder))
        self._texts.pop(str(spec.folder), None)
        process.wait()
        log = spec.folder / "log.txt"
        if process.returncode == 0:
            log.unlink()
            return True
        last = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:] or ["no message"]
        self._lost.append(f"{spec.folder} failed with status {process.returncode}: {last[0]} (all of it in {log})")
        bar.write(self._lost[-1])
        return False

    def _stop(self) -> None:
        for _, process in self._running.values():
            process.terminate()
        for _, process in self._running.values():
            process.wait()
