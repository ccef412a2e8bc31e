"""Build the API reference from the docstrings of the public names: `make docs` writes it to build/docs.

A warning is an error: a type that does not resolve, a public name that is not there, one without a docstring.
"""

from __future__ import annotations

import sys
import warnings
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import get_type_hints

import pdoc
import pdoc.render

MODULES = ("dynaforge", "dynaforge.tasks.targets", "dynaforge.tasks.predicates", "dynaforge.evaluation")


def build(out: Path) -> None:
    """Write one page for each public module and an index.

    Raises:
        ValueError: A public name has no docstring.
        UserWarning: pdoc cannot resolve a name or a type.
    """
    warnings.simplefilter("error", UserWarning)
    for module in map(import_module, MODULES):
        for name in module.__all__:
            public = getattr(module, name)  # which also makes a lazy name visible to pdoc
            if not public.__doc__:
                raise ValueError(f"{module.__name__}.{name} has no docstring.")
            if is_dataclass(public) and isinstance(public, type):
                _resolve_types(public)
    pdoc.render.configure(docformat="google", show_source=False)
    pdoc.pdoc(*MODULES, output_directory=out)


def _resolve_types(public: type) -> None:
    """Give the constructor of a dataclass its types: pdoc looks for inherited ones in the wrong module."""
    hints = get_type_hints(public)
    public.__init__.__annotations__.update({f.name: hints[f.name] for f in fields(public) if f.init})


if __name__ == "__main__":
    build(Path(sys.argv[1]))
