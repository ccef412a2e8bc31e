"""`python -m dynaforge.zoo train|enjoy|record_video ...`: rl_zoo3's scripts with our algorithm and envs."""

from dynaforge.zoo.scripts import main

if __name__ == "__main__":
    raise SystemExit(main())
