"""The versions a result depends on."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

PACKAGES = ("dynaforge", "stable-baselines3", "torch", "numpy", "pybullet", "pin", "toppra", "ruckig")


def package_versions(packages: Sequence[str] = PACKAGES) -> dict[str, str]:
    """Return the installed version of every package a result depends on."""
    return {name: version(name) for name in packages}
