"""The figures of speed, exactness, limits and forces that `dynaforge bench` measures."""
