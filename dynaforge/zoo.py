"""Leads `python -m dynaforge.zoo train|enjoy|record_video` to `dynaforge.cli.zoo`: rl_zoo3, our algorithm and envs."""

from dynaforge.cli.zoo import main

if __name__ == "__main__":
    raise SystemExit(main())
