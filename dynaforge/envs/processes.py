"""How worker processes are started: never forked from here, single-threaded, imports paid once."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from collections.abc import Iterator
from typing import Any

SINGLE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def worker_context() -> Any:
    """Return the multiprocessing context of all workers.

    Never fork: locks held by the parent's threads (torch, BLAS) would stay locked in the child. The fork server imports
    the envs once and every worker starts from there.
    """
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    if "forkserver" in methods:
        context.set_forkserver_preload(["dynaforge.envs.residual_env", "dynaforge.envs.vector_worker"])
    return context


@contextlib.contextmanager
def single_threaded() -> Iterator[None]:
    """Let processes started meanwhile inherit one thread for every numerical library."""
    before = {name: os.environ.get(name) for name in SINGLE_THREAD}
    os.environ.update(SINGLE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
