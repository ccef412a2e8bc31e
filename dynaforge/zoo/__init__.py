"""rl_zoo3's own scripts with our algorithms and the DynaForge envs registered.

rl_zoo3 parses flags, logs and saves as usual. The modules:

- `scripts`: runs a script of rl_zoo3 for a command line.
- `flags`: the flags of its scripts, read from their source.
- `checks` and `refusals`: end a command in one line before anything is created.
- `envs`: tasks by name and file, and the hyperparameters that `forge` and `compare` use.
- `algorithm`: our algorithms for training, loading and hyperparameter search.
- `process`: what is replaced in rl_zoo3 and Stable-Baselines3 while a script runs, and put back afterwards.
"""
