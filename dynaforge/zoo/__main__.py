"""Leads `python -m dynaforge.zoo train|enjoy|record_video` to `dynaforge.zoo.scripts`: rl_zoo3, our algorithm and envs."""

from dynaforge.zoo.scripts import main

if __name__ == "__main__":
    raise SystemExit(main())
