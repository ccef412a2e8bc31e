"""Where a command works: on the cores of this machine or on a Ray cluster."""

from __future__ import annotations

import argparse

from dynaforge.sampling.ray_cluster import connect_to_ray


def on_ray(options: argparse.Namespace) -> bool:
    """Return whether a command is to work on a Ray cluster; then it is connected to it, before it makes a file.

    Args:
        options: The options of the command, with those of `add_engine`.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
    """
    if options.engine == "ray":
        connect_to_ray()
    return bool(options.engine == "ray")
