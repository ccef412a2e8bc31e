"""The pages say which function each equation of the paper is, and the functions say the same."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
ROWS = [
    (page.name, int(number), function)
    for page in PAGES
    for number, functions in re.findall(r"^\| Eq\. (\d+),[^|]*\| (.+) \|$", page.read_text(), re.MULTILINE)
    for function in re.findall(r"`([^`]+)`", functions)
]


def named_functions() -> list[Any]:
    """Pair every name with the file before it in its row."""
    cases, file = [], ""
    for page, number, name in ROWS:
        if name.endswith(".py"):
            file = name
        else:
            cases.append(pytest.param(number, file, name, id=f"{page}-{number}-{name}"))
    return cases


def test_the_readme_names_a_function_for_every_equation_of_the_paper() -> None:
    assert {number for page, number, _ in ROWS if page == "README.md"} == set(range(1, 11))


@pytest.mark.parametrize(("number", "file", "name"), named_functions())
def test_what_the_table_names_exists_and_names_the_equation(number: int, file: str, name: str) -> None:
    module = importlib.import_module(f"dynaforge.{file.removesuffix('.py').replace('/', '.')}")
    chain = [module]
    for part in name.split("."):
        chain.append(getattr(chain[-1], part))
    assert callable(chain[-1])
    told = "\n".join(inspect.getdoc(each) or "" for each in chain[1:])
    assert number in equations_in(told), f"the docstring of {name} does not name Eq. {number}"


def equations_in(text: str) -> set[int]:
    """Return every number that a text names: "Eq. 5", "Eq. 7-9", "Eq. 7 and 8"."""
    found = set()
    for first, joint, last in re.findall(r"Eq\. (\d+)(?:(-| and )(\d+))?", text):
        found |= {int(first)} if not joint else set(range(int(first), int(last) + 1))
    return found
