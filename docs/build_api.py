"""Build the API reference from the docstrings of the public names: `make docs` writes it to build/docs.

A warning is an error: a type that does not resolve, a public name that is not there, one without a docstring.
"""

from __future__ import annotations

import sys
import warnings
from importlib import import_module
from pathlib import Path

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
            if not getattr(module, name).__doc__:  # resolving it also makes a lazy name visible to pdoc
                raise ValueError(f"{module.__name__}.{name} has no docstring.")
    pdoc.render.configure(docformat="google", show_source=False)
    pdoc.pdoc(*MODULES, output_directory=out)


if __name__ == "__main__":
    build(Path(sys.argv[1]))
