"""rl_zoo3's own scripts with FrontierGRPO and the DynaForge envs registered.

rl_zoo3 reads flags, logs and saves as ever. What is arranged for it, and where:

- `scripts`: a command line from its flags to the script of rl_zoo3 that it runs.
- `flags`: the flags of its scripts, read from their source.
- `checks` and `refusals`: what ends a command in one line before anything is made.
- `envs`: tasks by name and file, and the hyperparameters that `forge` and `compare` take.
- `algorithm`: FrontierGRPO for training, loading and hyperparameter search.
- `process`: what is replaced in rl_zoo3 and Stable-Baselines3 while a script runs, and put back afterwards.
"""
