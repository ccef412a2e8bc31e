"""FrontierGRPO, its policies and the mathematics behind it."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynaforge.algos.frontier_grpo import FrontierGRPO

__all__ = ["FrontierGRPO"]


def __getattr__(name: str) -> Any:
    """Import FrontierGRPO, and torch with it, when first asked for: policy files are read without torch."""
    if name == "FrontierGRPO":
        from dynaforge.algos.frontier_grpo import FrontierGRPO

        return FrontierGRPO
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
