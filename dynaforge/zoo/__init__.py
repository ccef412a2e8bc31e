"""rl_zoo3's own scripts with FrontierGRPO and the DynaForge envs registered."""
