"""The versions of the packages that a result depends on."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version

PACKAGES = ("dynaforge", "stable-baselines3", "torch", "numpy", "pybullet", "pin", "toppra", "ruckig")


def package_versions(packages: Sequence[str] = PACKAGES) -> dict[str, str]:
    """Return the installed versions of packages, by default of all that a result depends on."""
    return {name: version(name) for name in packages}
