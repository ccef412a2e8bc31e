"""Success rates and their statistics: DGR, paired comparisons, the competence frontier."""

from dynaforge.evaluation.dgr import DgrReport
from dynaforge.evaluation.dgr_tables import comparison_table, task_table
from dynaforge.evaluation.few_seeds import few_seeds_interval
from dynaforge.evaluation.frontier import FrontierAnalysis, analyse_frontier
from dynaforge.evaluation.statistics import (
    BootstrapDifference,
    Interval,
    PairedDifference,
    bootstrap_over_tasks,
    mcnemar_exact,
    paired_difference,
    wilson_interval,
)

__all__ = [
    "BootstrapDifference",
    "DgrReport",
    "FrontierAnalysis",
    "Interval",
    "PairedDifference",
    "analyse_frontier",
    "bootstrap_over_tasks",
    "comparison_table",
    "few_seeds_interval",
    "mcnemar_exact",
    "paired_difference",
    "task_table",
    "wilson_interval",
]
