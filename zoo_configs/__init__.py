"""rl-zoo style hyperparameters per env id. Installs as `dynaforge.zoo_configs`."""
