"""FrontierGRPO, its policies and the mathematics behind it."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynaforge.algos.frontier_grpo import FrontierGRPO
    from dynaforge.training.settings import recommended

__all__ = ["FrontierGRPO", "recommended"]


def __getattr__(name: str) -> Any:
    """Import FrontierGRPO, and torch with it, when first asked for: policy files are read without torch."""
    if name == "FrontierGRPO":
        from dynaforge.algos.frontier_grpo import FrontierGRPO

        return FrontierGRPO
    if name == "recommended":
        from dynaforge.training.settings import recommended

        return recommended
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
