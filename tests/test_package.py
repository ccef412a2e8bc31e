from __future__ import annotations

import configparser
import platform
import re
import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
CONFIG = configparser.ConfigParser()
CONFIG.read(ROOT / "setup.cfg")
RESOURCES = {"assets": "dynaforge/assets", "zoo_configs": "dynaforge/zoo_configs"}


def sources(folder: str) -> list[Path]:
    """List what a folder of the repository holds, relative to it, without what Python leaves there."""
    found = (path.relative_to(ROOT / folder) for path in (ROOT / folder).rglob("*") if path.is_file())
    return [path for path in found if "__pycache__" not in path.parts]


@pytest.mark.parametrize("folder", RESOURCES)
def test_resources_are_found_inside_the_package(folder: str) -> None:
    package = files(f"dynaforge.{folder}")
    names = sources(folder)
    assert len(names) > 1
    for name in names:
        assert package.joinpath(*name.parts).is_file()


def test_every_hyperparameter_file_is_a_mapping_of_env_ids() -> None:
    for name in sources("zoo_configs"):
        if name.suffix == ".yml":
            listed = yaml.safe_load(files("dynaforge.zoo_configs").joinpath(str(name)).read_text())
            assert listed
            if name.name == "compare.yml":  # arms, each of one of the other files
                assert all((ROOT / "zoo_configs" / f"{arm['config']}.yml").is_file() for arm in listed.values())
            else:
                assert all(env == "default" or env.startswith("DynaForge/") for env in listed)


def test_every_package_is_listed_for_installation() -> None:
    listed = set(CONFIG["options"]["packages"].split())
    present = {
        "dynaforge" + "".join(f".{part}" for part in path.parent.parts)
        for path in sources("dynaforge")
        if path.name == "__init__.py"
    }
    assert listed == present | {name.replace("/", ".") for name in RESOURCES.values()}


def test_every_dependency_is_pinned_by_the_constraints_within_its_range() -> None:
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    pins = {canonicalize_name(name): version for name, _, version in (line.partition("==") for line in lines)}
    assert all(version and "+" not in version for version in pins.values())
    asked = [CONFIG["options"]["install_requires"], *CONFIG["options.extras_require"].values()]
    for line in "\n".join(asked).split("\n"):
        if line.strip():
            requirement = Requirement(line)
            assert pins[canonicalize_name(requirement.name)] in requirement.specifier


READY_MADE = (sys.version_info[:2], platform.system(), platform.machine()) == ((3, 11), "Linux", "x86_64")


@pytest.mark.skipif(not READY_MADE, reason="PyBullet has a wheel for Python 3.11 on Linux x86-64 only")
def test_no_pinned_package_was_compiled_here() -> None:
    """Installing needs no compiler: what pip compiles itself carries a tag without the `many` of a published wheel."""
    compiled = []
    for line in (ROOT / "constraints.txt").read_text().splitlines():
        try:
            wheel = distribution(line.partition("==")[0]).read_text("WHEEL") or ""
        except (PackageNotFoundError, ValueError):  # of an extra that is not installed, or the comment
            continue
        tags = re.findall(r"^Tag: \S+-(\S+)$", wheel, re.MULTILINE)
        compiled += [line] * any(tag.startswith("linux") for tag in tags)
    assert compiled == []


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(not READY_MADE, reason="PyBullet has a wheel for Python 3.11 on Linux x86-64 only")
def test_every_requirement_of_the_default_install_comes_as_a_wheel() -> None:
    """Asks the package index; robomimic, pure Python, is the one source distribution beside them."""
    (extras,) = re.findall(r"-e \"\.\[(.*)\]\"", (ROOT / "Makefile").read_text())
    pip = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--only-binary=:all:"]
    if subprocess.run([*pip, "six"], capture_output=True, check=False, timeout=100).returncode:
        pytest.skip("no package index answers")
    asked = [*pip, "-c", "constraints.txt", f".[{extras}]", "termcolor"]
    done = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False, timeout=500)
    assert done.returncode == 0, done.stderr


def test_the_wheel_contains_all_code_and_all_resources(tmp_path: Path) -> None:
    """Built from a copy: a build leaves folders behind that a later build would pack."""
    source = tmp_path / "source"
    for folder in ("dynaforge", *RESOURCES):
        shutil.copytree(ROOT / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("setup.cfg", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source / name)
    build = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        "--no-build-isolation",
        "--no-index",
        "-w",
        tmp_path,
        source,
    ]
    done = subprocess.run(build, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("dynaforge-*.whl")
    packed = set(zipfile.ZipFile(wheel).namelist())
    for folder, place in {"dynaforge": "dynaforge", **RESOURCES}.items():
        assert {f"{place}/{name.as_posix()}" for name in sources(folder)} <= packed
