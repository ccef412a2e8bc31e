"""The connection to an existing Ray cluster."""

from __future__ import annotations

import os
import signal
import threading
from typing import Any


def cluster_cores() -> int:
    """Return the number of cores of the cluster, at least one.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
    """
    return max(1, int(connect_to_ray().cluster_resources().get("CPU", 1)))


def connect_to_ray() -> Any:
    """Connect to a running Ray cluster and return the module ray.

    Raises:
        ImportError: Ray, of the `[ray]` extra, is missing.
        ConnectionError: No cluster is running.
    """
    try:
        import ray
    except ImportError as error:
        raise ImportError("Engine ray needs Ray: pip install 'dynaforge[ray]'.") from error
    if not ray.is_initialized():
        on_sigterm = signal.getsignal(signal.SIGTERM)
        try:
            ray.init(address=os.environ.get("RAY_ADDRESS", "auto"), log_to_driver=False)
        except ConnectionError as error:
            raise ConnectionError(
                "No Ray cluster is running here: `ray start --head` begins one, RAY_ADDRESS names another; or leave "
                "out --engine ray to use the cores of this machine."
            ) from error
        finally:
            if threading.current_thread() is threading.main_thread():
                signal.signal(signal.SIGTERM, on_sigterm)  # Ray sets its own, which would not let commands clean up
    return ray
