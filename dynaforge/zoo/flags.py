"""The flags of rl_zoo3's scripts, read from their source: importing them takes seconds, refusing a typo should not."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from dynaforge.options.parser import Parser
from dynaforge.options.refusal import Refused
from dynaforge.options.words import Choice
from dynaforge.sim.checks import quoted
from dynaforge.sim.setting import Setting

PLAYERS = ("enjoy", "record_video", "record_training")
"""Scripts of rl_zoo3 that load a trained model."""

PLOTTERS = ("plot_train", "all_plots", "plot_from_file")
"""Scripts of rl_zoo3 that read logs."""

SCRIPTS = ("train", *PLAYERS, *PLOTTERS)
"""Scripts of rl_zoo3 that run here."""

AT_LEAST_ONE = {"n_envs", "n_eval_envs", "eval_episodes", "n_trials", "n_evaluations", "fontsize", "episode_window"}
"""Numbers that must not be 0, since the scripts divide by them or never end."""

NEEDED = {"all_plots": ("algos", "env", "exp_folders"), "plot_from_file": ("input",)}
"""Flags without which a script raises although it does not declare them as required."""


def zoo_parser(script: str, *, complete: bool = True) -> Parser:
    """Return a parser of the flags of a script of rl_zoo3, and of --trusted; the script applies its own defaults.

    Args:
        script: Name of the script.
        complete: Whether the flags that the script requires must be given.

    Raises:
        ModuleNotFoundError: rl_zoo3 is not installed.
    """
    parser = Parser(prog=f"dynaforge {script}", add_help=False)
    for call in _calls(_source(script), "add_argument"):
        names = [_value(name) for name in call.args]
        keywords = {word.arg: word.value for word in call.keywords}
        name = names[-1].lstrip("-").replace("-", "_")
        meaning = _meaning(keywords, name)
        if "required" in meaning:
            meaning["required"] = complete and (meaning["required"] or name in NEEDED.get(script, ()))
        parser.add_argument(*names, **meaning)
    if script not in PLOTTERS:
        for name in Setting.__slots__:
            parser.add_argument(f"--{name}", type=partial(_meant_for_the_env, name))
    parser.add_argument("--trusted", action="store_true")
    parser.add_argument("-h", "--help", action="store_true")
    return parser


def _meant_for_the_env(name: str, text: str) -> str:
    """Refuse a part of the setting, which other commands take as a flag, and say how rl_zoo3 takes it."""
    value = text if re.fullmatch(r"[0-9.]+", text) else quoted(text)
    raise Refused(f'is an argument of the env here: --env-kwargs "{name}:{value}".')


def zoo_algorithms() -> list[str]:
    """Return the names of rl_zoo3's own algorithms."""
    for node in ast.walk(_source("utils")):
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "ALGOS" and isinstance(node.value, ast.Dict):
            return [_value(key) for key in node.value.keys]
    from rl_zoo3 import ALGOS  # another version, with another source

    return list(ALGOS)


def _source(script: str) -> ast.Module:
    spec = find_spec("rl_zoo3")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("No module named 'rl_zoo3'", name="rl_zoo3")
    package = Path(spec.submodule_search_locations[0])
    path = next(path for path in (package / f"{script}.py", package / "plots" / f"{script}.py") if path.exists())
    return ast.parse(path.read_text(encoding="utf-8"))


def _calls(tree: ast.Module, method: str) -> Iterator[ast.Call]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == method:
            yield node


def _meaning(keywords: dict[str | None, ast.expr], name: str) -> dict[str, Any]:
    """Return keywords of `add_argument` for those in the script, as far as they can be read without running it."""
    if _value(keywords.get("action")) == "store_true":
        return {"action": "store_true"}
    kind = keywords.get("type")
    meaning: dict[str, Any] = {
        "nargs": _value(keywords.get("nargs")),
        "required": _value(keywords.get("required")) is True,
    }
    if isinstance(choices := _value(keywords.get("choices")), list):
        meaning["type"] = Choice("choice", choices)
    elif isinstance(kind, ast.Name) and kind.id in ("int", "float"):
        meaning["type"] = _PythonNumber(int if kind.id == "int" else float, positive=name in AT_LEAST_ONE)
    return meaning


def _value(node: ast.expr | None) -> Any:
    """Return the value of a constant or of a list of constants; None for anything else."""
    try:
        return None if node is None else ast.literal_eval(node)
    except ValueError:
        return None


class _PythonNumber:
    """A number as Python, and so rl_zoo3, parses it."""

    def __init__(self, kind: type[int] | type[float], *, positive: bool) -> None:
        self.kind, self.positive = kind, positive

    def __call__(self, text: str) -> float:
        """Return the number."""
        try:
            value = self.kind(text)
        except ValueError:
            expected = "a whole number" if self.kind is int else "a number"
            raise Refused(f"is {quoted(text)}; it must be {expected}.") from None
        if self.positive and value < 1:
            raise Refused(f"is {quoted(text)}; it must be at least 1.")
        return value
