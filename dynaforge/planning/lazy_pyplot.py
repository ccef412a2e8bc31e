"""Imports toppra without matplotlib, which it needs only for its plots."""

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
"""Modules that import pyplot when they are imported."""


@contextlib.contextmanager
def lazy_pyplot() -> Iterator[None]:
    """Make the modules of `PLOTTING`, if they are imported within this context, import pyplot when they first plot.

    Importing matplotlib takes a third of a worker's start-up time, and fails if MPLBACKEND names a backend of another
    environment, as it can in processes that a notebook starts. Only these modules see the change, each in its own
    namespace: other threads are not affected, and `import matplotlib` anywhere else imports the real one.
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
    """Executes a module with its own `__import__`."""

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
    """Stands for matplotlib.pyplot, and imports it when an attribute is first read."""

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module("matplotlib.pyplot"), name)
