"""Training runs: settings, model and env, history and folder, comparison of runs."""
