"""Lets toppra be imported without matplotlib, which it needs only for its plots."""

from __future__ import annotations

import builtins
import contextlib
import importlib
import sys
from collections.abc import Iterator, Sequence
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType, SimpleNamespace
from typing import Any

PLOTTING = ("toppra.algorithm.algorithm", "toppra.parametrizer")
"""Modules that import pyplot at their top."""


@contextlib.contextmanager
def plots_later() -> Iterator[None]:
    """Import the modules of `PLOTTING` so that they import pyplot when they first plot.

    Matplotlib takes a third of a worker's start, and refuses to be imported where MPLBACKEND names a backend that
    another environment has, as the processes below a notebook see it. Only these modules see the change, in their own
    namespace: no other thread meets it, and an `import matplotlib` anywhere else is the real one.
    """
    finder = _Finder()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


class _Finder(MetaPathFinder):
    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path, target) if name in PLOTTING else None
        if spec is not None and spec.loader is not None:
            spec.loader = _Loader(spec.loader)
        return spec


class _Loader(Loader):
    """Runs a module with an `import` of its own."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        module.__dict__["__builtins__"] = {**vars(builtins), "__import__": _import}
        self._loader.exec_module(module)


def _import(name: str, *args: Any) -> Any:
    return SimpleNamespace(pyplot=_Pyplot()) if name == "matplotlib.pyplot" else builtins.__import__(name, *args)


class _Pyplot:
    """Is imported when something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module("matplotlib.pyplot"), name)
