"""The pages do what they show."""

from __future__ import annotations

import inspect
import re
import shlex
from pathlib import Path

import gymnasium
import pytest

from dynaforge.algos import FrontierGRPO
from dynaforge.cli.main import main
from dynaforge.demos.schema import schema_markdown
from dynaforge.reports.task_pages import page_with_picture
from dynaforge.sim.hidden import HIDDEN
from dynaforge.sim.reflex import REFLEX_NAMES, THRESHOLDS
from dynaforge.tasks import TASK_NAMES, get_task

DOCS = Path(__file__).parents[1] / "docs"


def blocks(language: str, page: str = "add_a_task.md") -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)


BALL = "\n\n".join(blocks("python"))


@pytest.fixture
def folder(ball: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(ball.parent)
    return ball.parent


def test_the_page_on_adding_a_task_makes_one_that_works(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands = [line for block in blocks("console") for line in block.splitlines()]
    assert len(commands) == 2
    for line in commands:
        program, *arguments = shlex.split(line)
        assert program == "dynaforge"
        assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "planner_only" in printed
    assert (folder / "pages" / "ball.md").read_text().startswith("# Ball: grasp")
    assert (folder / "pages" / "ball.png").stat().st_size > 10_000
    assert (folder / "ball-planner.json").exists()
    env = gymnasium.make("DynaForge/Ball-v0")
    rewards = []
    for k in range(4):
        env.reset(options={"condition": env.unwrapped.condition_sampler.draw(_rng(k), 0, 8)})
        done = False
        while not done:
            _, reward, done, _, _ = env.step(0.0 * env.action_space.sample())
        rewards.append(reward)
    env.close()
    assert 1.0 in rewards, "the planner alone wins a slow ball"


ROWS = re.findall(r"^\| `(.+?)` \| `(.+?)` \| `(.+)` \|$", (DOCS / "add_a_task.md").read_text(), re.MULTILINE)


@pytest.mark.parametrize(("right", "wrong", "answer"), ROWS)
def test_the_mistakes_that_the_page_shows_are_answered_as_it_says(
    folder: Path, capsys: pytest.CaptureFixture[str], right: str, wrong: str, answer: str
) -> None:
    assert right in BALL
    (folder / "ball.py").write_text(BALL.replace(right, wrong, 1))
    assert main(["describe", "ball.py"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "ball.py, line " in said
    for part in answer.split("` ... `"):
        assert part in said


def test_the_page_shows_a_refusal_as_it_is_printed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert len(ROWS) >= 8
    (block,) = (text for text in blocks("text") if "describe" in text)
    (folder / "ball.py").write_text(BALL.replace(*ROWS[0][:2], 1))
    assert main(shlex.split(block.splitlines()[0])[2:]) == 2
    assert capsys.readouterr().err.replace(str(folder), "/home/me").splitlines() == block.splitlines()[1:]


def _rng(seed: int):
    import numpy as np

    return np.random.default_rng(seed)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "No task file"),
        ("TASK = 1", "must define TASK, a Task: TASK is 1"),
        (BALL.replace("TASK =", "BALL ="), "must define TASK, a Task: rename BALL to TASK"),
        ("", "must define TASK, a Task: the file defines none"),
        ("class Odd(BaseException): pass\nraise Odd('a\\nb')", r"mine_\w+\.py, line 2: Odd: a b$"),
        ("from dynaforge.tasks.can import TASK", "is that of a task of the package"),
        ("import numpy\nTASK = (1,\n", r"mine_\w+\.py, line 2: '\(' was never closed\.$"),
        ("import numpy\n\nTASK = numpy.zeroes(3)", r"mine_\w+\.py, line 3: AttributeError: .*zeroes"),
        ("def launch():\n    raise ValueError('no\\nwind')\nlaunch()", r"mine_\w+\.py, line 2: no wind$"),
        ("open('absent.txt')", r"mine_\w+\.py, line 1: .*absent\.txt"),
        ("import sys\nsys.exit(3)", r"mine_\w+\.py, line 2: it ends the program"),
        ("import abcent", r"mine_\w+\.py, line 1: ModuleNotFoundError: No module named 'abcent'"),
        (BALL.replace('env_name="Ball"', 'env_name="Can"'), "of another task"),
    ],
)
def test_a_file_that_is_no_task_is_refused_in_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], text: str | None, message: str
) -> None:
    name = f"mine_{abs(hash(message))}.py"
    if text is not None:
        (folder / name).write_text(text)
    with pytest.raises(ValueError, match=message):
        get_task(name)
    assert main(["describe", name]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_file_whose_name_cannot_be_imported_is_refused(folder: Path) -> None:
    (folder / "my.ball.py").write_text("")
    with pytest.raises(ValueError, match=r"rename it to my_ball\.py"):
        get_task("my.ball.py")


@pytest.mark.parametrize("name", TASK_NAMES)
def test_the_page_of_a_task_is_what_its_data_says(name: str) -> None:
    """After a change: `dynaforge describe all --out docs/tasks`."""
    page = (DOCS / "tasks" / f"{name}.md").read_text()
    assert page == page_with_picture(get_task(name))
    assert (DOCS / "tasks" / f"{name}.png").is_file()


@pytest.mark.filterwarnings("ignore")
def test_the_page_on_datasets_reads_what_its_commands_make(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every block but the one for LeRobot, which has a test of its own, in the order of the page."""
    monkeypatch.chdir(tmp_path)
    collect = ["collect", "--generator", "planner_only", "--task", "can", "--demos", "2", "--workers", "1"]
    assert main([*collect, "--out", "data/can"]) == 0
    small = ["--cameras", "front", "--size", "32", "24", "--points", "64", "--workers", "1"]
    assert main(["render", "data/can", *small]) == 0
    assert main(["export", "data/can", "--format", "robomimic"]) == 0
    capsys.readouterr()
    names: dict[str, object] = {}
    shown = [block for block in blocks("python", "datasets.md") if "lerobot" not in block]
    assert len(shown) == 4
    for block in shown:
        exec(block, names)
    printed = capsys.readouterr().out
    assert "(2, 64, 3) (16, 9)" in printed, "the pack's windows"


def test_the_page_on_datasets_holds_the_schema() -> None:
    assert schema_markdown() in (DOCS / "datasets.md").read_text()


def test_the_page_on_physics_has_the_ranges_of_the_hidden_fields() -> None:
    rows = re.findall(r"^\| `(\w+)` \| ([\d.]+)(?: s)? \| (.+?) \| (.+?) \|", physics_page(), re.MULTILINE)
    shown = {name: (float(nominal), *map(ends, ranges)) for name, nominal, *ranges in rows}
    assert shown == {name: (field.nominal, field.varied, field.wide) for name, field in HIDDEN.items()}


def test_the_page_on_physics_has_the_thresholds_of_the_reflex() -> None:
    shown = re.findall(r"^\| `(\w+)`.*? \| (\d+) N \| (\d+) Nm \| ([\d, ]+)", physics_page(), re.MULTILINE)
    assert [name for name, *_ in shown] == [name for name in REFLEX_NAMES if name != "off"]
    for name, force, moment, torques in shown:
        said = THRESHOLDS[name]
        assert (float(force), float(moment)) == (said.force, said.moment)
        assert set(map(float, torques.split(","))) == set(said.torque.tolist())


def physics_page() -> str:
    return (DOCS / "physics.md").read_text()


def ends(said: str) -> tuple[float, float]:
    low, high = said.removesuffix(" s").split(" to ")
    return float(low), float(high)


def test_the_page_on_the_algorithm_names_its_options_and_their_defaults() -> None:
    page = (DOCS / "frontier_grpo.md").read_text()
    rows = [[cell.strip() for cell in line.split("|")[1:3]] for line in page.splitlines() if line.startswith("| `")]
    shown = {
        name: value
        for names, values in rows
        for name, value in zip(re.findall(r"`(\w+)`", names), values.split(", "), strict=False)
    }
    parameters = inspect.signature(FrontierGRPO).parameters
    known = {name: str(p.default) for name, p in parameters.items() if p.kind is inspect.Parameter.KEYWORD_ONLY}
    infrastructure = {"stats_window_size", "tensorboard_log", "policy_kwargs", "verbose", "seed", "device"}
    assert set(known) - infrastructure - {"_init_setup_model"} <= set(shown)
    for name, value in shown.items():
        if name in known and name != "condition_sampler":
            default = known[name]
            assert value.strip('"') == default or float(value) == float(default), name
