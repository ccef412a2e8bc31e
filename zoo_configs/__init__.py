"""Hyperparameters per env id, in rl_zoo3's format. Installs as `dynaforge.zoo_configs`."""
