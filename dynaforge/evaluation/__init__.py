"""Success rates and what can be said about them: DGR, paired statistics, the competence frontier."""

from dynaforge.evaluation.dgr import Count, DgrReport, Outcome, Trial, comparison_table, describe_gain, task_table
from dynaforge.evaluation.frontier import FrontierAnalysis, analyse_frontier, trailing_mean
from dynaforge.evaluation.statistics import (
    BinComparison,
    BootstrapDifference,
    Interval,
    PairedDifference,
    bootstrap_over,
    bootstrap_over_tasks,
    mcnemar_exact,
    no_bin_lost,
    paired_difference,
    wilson_bounds,
    wilson_interval,
)

__all__ = [
    "BinComparison",
    "BootstrapDifference",
    "Count",
    "DgrReport",
    "FrontierAnalysis",
    "Interval",
    "Outcome",
    "PairedDifference",
    "Trial",
    "analyse_frontier",
    "bootstrap_over",
    "bootstrap_over_tasks",
    "comparison_table",
    "describe_gain",
    "mcnemar_exact",
    "no_bin_lost",
    "paired_difference",
    "task_table",
    "trailing_mean",
    "wilson_bounds",
    "wilson_interval",
]
