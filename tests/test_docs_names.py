"""The pages speak of what the code has, in lines of at most 120 columns."""

from __future__ import annotations

import ast
import configparser
import functools
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "dynaforge"
PAGES = ("architecture.md", "decisions.md", "physics.md", "glossary.md")
MARKDOWN = sorted(
    path
    for folder in (".", "docs", "docs/tasks", "examples", "results")
    for path in (ROOT / folder).glob("*.md")
    if path.is_file()
)
FENCE = re.compile(r"^ *```.*?^ *```$", re.DOTALL | re.MULTILINE)
PLACES = (ROOT, PACKAGE, ROOT / "docs")


@functools.cache
def sources() -> dict[Path, str]:
    files = [*PACKAGE.rglob("*.py"), *(ROOT / "zoo_configs").glob("*.yml"), *(ROOT / "examples").glob("*.py")]
    return {path: path.read_text(encoding="utf-8") for path in files}


@functools.cache
def words() -> frozenset[str]:
    return frozenset(re.findall(r"\w+", " ".join(sources().values())))


@functools.cache
def classes() -> dict[str, tuple[str, frozenset[str]]]:
    """Every class of the package by name: its module, and the names that its body and its methods set."""
    found: dict[str, tuple[str, frozenset[str]]] = {}
    for path, text in sources().items():
        if PACKAGE not in path.parents:
            continue
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for node in ast.parse(text).body:
            if isinstance(node, ast.ClassDef):
                members = {n.name for n in node.body if isinstance(n, ast.FunctionDef)}
                members |= {
                    n.target.id for n in ast.walk(node) if isinstance(n, ast.AnnAssign) and hasattr(n.target, "id")
                }
                members |= {
                    n.attr for n in ast.walk(node) if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)
                }
                found[node.name] = (module, frozenset(members))
    return found


def has_member(name: str, member: str) -> bool:
    module, members = classes()[name]
    return member in members or hasattr(getattr(importlib.import_module(module), name), member)


def has_attribute(dotted: str) -> bool:
    """Whether `module.attribute`, with or without the package's own name before it, can be imported."""
    *module, attribute = dotted.removeprefix("dynaforge.").split(".")
    for name in (".".join(("dynaforge", *module)), ".".join(("dynaforge", *module, attribute))):
        try:
            found = importlib.import_module(name)
        except ImportError:
            continue
        if name.endswith(f".{attribute}") or hasattr(found, attribute):
            return True
    return False


def fault(name: str) -> str:
    """Say what is wrong with a name in a page; "" where nothing is, or where it names nothing of the code."""
    if re.fullmatch(r"[\w./*-]*(/|\.(py|md|yml|cfg|toml|txt))", name) and not name.startswith("."):
        known = any(list(place.glob(name.rstrip("/"))) for place in PLACES)
        return "" if known else f"no file {name}"
    if match := re.fullmatch(r"([A-Z]\w*)\.(\w+)", name):
        if match[1] not in classes():
            return f"no class {match[1]}"
        return "" if has_member(match[1], match[2]) else f"class {match[1]} has no {match[2]}"
    if re.fullmatch(r"[a-z]\w*(\.\w+)+", name):
        return "" if has_attribute(name) or name.split(".")[0] in ("env", "info", "th", "torch") else f"no {name}"
    if re.fullmatch(r"[A-Z][a-z]\w*[A-Z]\w*|[a-z]\w*_\w+", name):
        return "" if name in words() else f"no {name} in the code"
    return ""


def names_in(page: str) -> set[str]:
    """Return what a page names: code in backquotes, and names with a dot in pictures."""
    prose = " ".join(FENCE.sub("", page).split())
    spans = {re.split(r"[(=]", span)[0].strip() for span in re.findall(r"`([^`]+)`", prose)}
    for picture in FENCE.findall(page):
        spans |= set(re.findall(r"\b[A-Z]\w+\.\w+\b", picture)) | set(re.findall(r"\b[A-Z][a-z]\w*[A-Z]\w*\b", picture))
        spans |= set(re.findall(r"\b[\w/]+\.(?:py|yml|md)\b", picture)) | set(re.findall(r"\b[a-z]+_\w+\b", picture))
    return {span for span in spans if not re.search(r"\s", span)}


@pytest.mark.parametrize("name", PAGES)
def test_a_page_names_what_the_code_has(name: str) -> None:
    names = names_in((ROOT / "docs" / name).read_text())
    assert names
    assert not [said for said in map(fault, sorted(names)) if said]


@pytest.mark.parametrize(
    "name",
    [
        "sim/nowhere.py",
        "Phase.no_such_field",
        "NoSuch.reset",
        "algos.advantages.nothing",
        "NoSuchClass",
        "no_such_word",
    ],
)
def test_a_name_that_the_code_does_not_have_is_a_fault(name: str) -> None:
    assert fault(name)


def test_the_picture_of_the_rooms_is_the_import_contract() -> None:
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    contract = config["importlinter:contract:layers"]["layers"].strip()
    page = (ROOT / "docs" / "architecture.md").read_text()
    assert f"```\n{contract}\n```" in page
    rooms = {room.strip() for line in contract.splitlines() for room in line.split("|")}
    assert {room for room in rooms if f"`dynaforge/{room}" not in page} == set(), "each room has a row"


@pytest.mark.parametrize("path", MARKDOWN, ids=lambda path: str(path.relative_to(ROOT)))
def test_prose_ends_at_120_columns(path: Path) -> None:
    """Tables, code, and what cannot be broken (an address) may go on."""
    prose = FENCE.sub("", path.read_text(encoding="utf-8")).splitlines()
    long = [line for line in prose if len(line) > 120 and not line.startswith("|") and " " in line.strip()]
    assert not long


@pytest.mark.parametrize("path", MARKDOWN, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_that_a_page_names_is_there(path: Path) -> None:
    modules = re.findall(r"(?<![\w./~-])[\w*]+(?:/[\w*]+)+\.(?:py|yml)\b", path.read_text(encoding="utf-8"))
    assert not [said for said in map(fault, sorted(set(modules))) if said]


@pytest.mark.parametrize("path", MARKDOWN, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_link_leads_to_a_file_and_a_headline(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", path.read_text(encoding="utf-8"))):
        if re.match(r"https?:", target):
            continue
        file, _, anchor = target.partition("#")
        page = path.parent / file if file else path
        if not (ROOT / "results").exists() and "results/" in file:  # a source distribution leaves them out
            continue
        assert page.exists(), target
        if anchor:
            headlines = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
            assert anchor in [re.sub(r"[^\w -]", "", line.lower()).replace(" ", "-") for line in headlines], target
