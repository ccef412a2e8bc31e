"""The files around the package say what is so: what is public, how to cite, what a source distribution holds."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
CONFIG = configparser.ConfigParser()
CONFIG.read(ROOT / "setup.cfg")
NOT_IN_THE_SDIST = (".ci/", "results/")


def test_the_page_for_contributors_names_files_and_targets_that_exist() -> None:
    page = (ROOT / "CONTRIBUTING.md").read_text()
    named = {name for name in re.findall(r"`([\w./]+)`", page) if "/" in name or name.endswith((".md", ".txt"))}
    named |= set(re.findall(r"\]\(([^)]+)\)", page))
    places = {name.replace("NAME", "can") for name in named} - {"build/docs"}
    assert len(places) > 10
    assert [name for name in places if not (ROOT / name).exists()] == []
    targets = set(re.findall(r"make (\w[\w-]*)", page))
    assert targets <= set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


def test_the_citation_is_of_this_version() -> None:
    """Keys that version 1.2 of the citation file format requires, and what it says of type and references."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["cff-version"] == "1.2.0"
    assert (citation["type"], citation["license"]) == ("software", CONFIG["metadata"]["license"])
    assert str(citation["version"]) == CONFIG["metadata"]["version"]
    paper = re.search(r"\*(DynaForge: [^*]+)\*", (ROOT / "README.md").read_text())
    assert paper
    (reference,) = citation["references"]
    assert reference["title"] == " ".join(paper[1].split())
    assert {"type", "title", "authors"} <= set(reference)
    assert all(author["name"] for author in citation["authors"] + reference["authors"])


def test_pre_commit_runs_the_ruff_of_make_check() -> None:
    (repository,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    hooks = repository["hooks"]
    checks = re.findall(r"\$\(BIN\)/(ruff \w+)", (ROOT / "Makefile").read_text())
    assert [hook["entry"].removeprefix(".venv/bin/").removesuffix(" --force-exclude") for hook in hooks] == checks
    assert {hook["language"] for hook in hooks} == {"system"}


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="asks git which files there are")
def test_the_source_distribution_holds_every_file_but_results(tmp_path: Path) -> None:
    """Built from a copy of what git would keep, so that nothing else is packed by chance."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    names = {n for n in listed.split("\0") if (ROOT / n).is_file() and not n.startswith(NOT_IN_THE_SDIST)}
    for name in names:
        (tmp_path / "source" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / "source" / name)
    code = f"from setuptools.build_meta import build_sdist; build_sdist({str(tmp_path)!r})"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path / "source", capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr
    (archive,) = tmp_path.glob("dynaforge-*.tar.gz")
    with tarfile.open(archive) as held:
        packed = {member.name.partition("/")[2] for member in held if member.isfile()}
    assert names <= packed
    made = {name for name in packed - names if not name.startswith("dynaforge.egg-info/")}
    assert made <= {"PKG-INFO", "setup.cfg"}
