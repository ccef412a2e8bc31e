"""FrontierGRPO, its policies and the mathematics behind it."""

from dynaforge.algos.frontier_grpo import FrontierGRPO

__all__ = ["FrontierGRPO"]
