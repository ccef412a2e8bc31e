from __future__ import annotations

import os
import subprocess
import sys

CODE = """
import sys
import dynaforge.envs.residual_env, dynaforge.envs.task_env, dynaforge.sampling.vector_worker
assert "matplotlib" not in sys.modules
from toppra.algorithm import algorithm
from dynaforge.reports.plots import learning_curve
assert b"<svg" in learning_curve({"a": [0.1, 0.2]})
import matplotlib.pyplot
assert algorithm.plt.plot is matplotlib.pyplot.plot
"""


def test_a_notebooks_backend_breaks_no_import_and_no_env_imports_matplotlib() -> None:
    """Jupyter and Colab hand MPLBACKEND down; another environment's matplotlib refuses to be imported with it."""
    notebook = os.environ | {"MPLBACKEND": "module://matplotlib_inline_of_another_environment"}
    subprocess.run([sys.executable, "-c", CODE], env=notebook, check=True, timeout=60)
